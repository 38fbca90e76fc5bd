"""Far-apart points of a shape, on which a step is computed."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Int

from homolog.geometry import Basis
from homolog.shapes import farthest_points
from homolog.training.recipe import SampleSettings


def subsets(basis: Basis, settings: SampleSettings) -> tuple[Int[np.ndarray, " s"], ...]:
    """Indices of the points of each subset; all points, as often, where there are no more than wanted."""
    if not 0 < settings.points < basis.n_points:
        return (np.arange(basis.n_points),) * settings.choices
    points = basis.points.double().cpu().numpy()
    return tuple(farthest_points(points, settings.points, seed=number) for number in range(settings.choices))


def at_points(basis: Basis, kept: Int[np.ndarray, " s"]) -> Basis:
    """A basis at some of its points."""
    if len(kept) == basis.n_points:
        return basis
    return basis.sampled(torch.from_numpy(kept).to(basis.points.device))
