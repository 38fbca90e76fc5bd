"""Far-apart points of a shape, on which a step is computed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from homolog.geometry import Basis
from homolog.shapes import farthest_points
from homolog.training.settings import SampleSettings


@dataclass(frozen=True, eq=False)
class Samples:
    """Subsets of a mesh, or of one of its clouds.

    Args:
        indices: of the points of each subset.
        bases: there.
        meshes: the bases of the mesh that belong to them, where they are not those of the mesh's own subsets.
        pairings: the interpolation from those to the cloud's points.
        points: all of them, in the coordinates of the bases (n, 3).
        mesh_indices: of the mesh's points at those bases.
        centre: of the points that the bases are centred at, in the mesh's normalised coordinates (3,).
    """

    indices: tuple[Int[np.ndarray, " s"], ...]
    bases: tuple[Basis, ...]
    meshes: tuple[Basis, ...] = ()
    pairings: tuple[Tensor, ...] = ()
    mesh_indices: tuple[Int[np.ndarray, " s"], ...] = ()
    points: Float[Tensor, "n 3"] = field(default_factory=lambda: torch.zeros(0, 3))
    centre: Float[Tensor, " 3"] = field(default_factory=lambda: torch.zeros(3))

    @property
    def n_bytes(self) -> int:
        """How much memory they take."""
        bases = (*self.bases, *self.meshes)
        parts = (getattr(basis, part.name) for basis in bases for part in fields(basis))
        return self.points.nbytes + sum(part.nbytes for part in parts if isinstance(part, Tensor))


def subsets(basis: Basis, settings: SampleSettings) -> tuple[Int[np.ndarray, " s"], ...]:
    """Indices of the points of each subset; all points, as often, where there are no more than asked for."""
    if not 0 < settings.points < basis.n_points:
        return (np.arange(basis.n_points),) * settings.choices
    points = basis.points.double().cpu().numpy()
    return tuple(farthest_points(points, settings.points, seed=number) for number in range(settings.choices))


def at_points(basis: Basis, indices: Int[np.ndarray, " s"]) -> Basis:
    """A basis at some of its points."""
    if len(indices) == basis.n_points:
        return basis
    return basis.sampled(torch.from_numpy(indices).to(basis.points.device))


def at_subsets(basis: Basis, indices: Sequence[Int[np.ndarray, " s"]], device: torch.device | str) -> tuple[Basis, ...]:
    """A basis at each of several subsets of its points, on a device."""
    return tuple(at_points(basis, subset).to(device) for subset in indices)
