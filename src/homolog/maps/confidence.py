"""How far to trust a point map, and which points have no counterpart, without any ground truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from scipy.sparse import csc_matrix, diags
from scipy.sparse.linalg import splu
from scipy.spatial import KDTree
from torch import Tensor

from homolog.core.arguments import check_count, check_indices, check_number
from homolog.core.arrays import takes_arrays
from homolog.geometry import Operators
from homolog.maps.quality import cycle_error


@dataclass(frozen=True, kw_only=True)
class ConfidenceSettings:
    """Settings of ``confidence`` and ``overlap``.

    Args:
        n_neighbours: nearest points over which the confidence of a point is averaged, at least 1; 10 to 40 are
            sensible.
        scale: distortion in normalised coordinates, of unit area, at which the confidence has fallen to 1/e; above 0,
            0.03 to 0.3 are sensible. It sets the scale of confidence and changes no ranking.
        smoothing: mass that is carried to the full shape is smoothed over about so many point spacings; above 0, 1 to 4
            are sensible. Less leaves gaps between samples open, more blurs the edge of a cut.
        overlap_threshold: a point of the full shape has a counterpart if the density of the carried mass is at least
            this, above 0 and at most 1. The density is 1 within, 0 outside, and 0.5 on the edge of a straight cut.
    """

    n_neighbours: int = 20
    scale: float = 0.1
    smoothing: float = 2.0
    overlap_threshold: float = 0.5

    def __post_init__(self) -> None:
        check_count("n_neighbours", self.n_neighbours)
        for name in ("scale", "smoothing"):
            check_number(name, getattr(self, name), above=0)
        check_number("overlap_threshold", self.overlap_threshold, above=0, most=1)


@takes_arrays
def confidence(
    points_y: Float[Tensor, "n_y 3"],
    points_x: Float[Tensor, "n_x 3"],
    y_to_x: Int[Tensor, " n_y"],
    x_to_y: Int[Tensor, " n_x"],
    *,
    settings: ConfidenceSettings | None = None,
) -> Float[Tensor, " n_y"]:
    """Confidence between 0 and 1 in each entry of ``y_to_x``; the points in inner units.

    Two things betray a wrong match: going there and back does not come home, and neighbours do not keep their
    distances. Both are averaged over a point's nearest neighbours, as errors come in patches.

    Raises:
        ArgumentError: if an index is that of no point, as is -1, where there is no counterpart.
    """
    settings = settings or ConfidenceSettings()
    home = cycle_error(points_y, y_to_x, x_to_y)
    positions = points_y.cpu().numpy()
    _, indices = KDTree(positions).query(positions, k=min(settings.n_neighbours + 1, len(positions)))
    near = torch.from_numpy(indices).to(points_y.device)  # each point itself among them
    stretch = local_stretch(points_y, points_x[y_to_x], near)
    return torch.exp(-(home[near].mean(dim=1) + stretch) / settings.scale)


@takes_arrays
def local_stretch(
    points: Float[Tensor, "n 3"], images: Float[Tensor, "n 3"], near: Int[Tensor, "n j"]
) -> Float[Tensor, " n"]:
    """By how much, on average, a map changes the distances between a point and its neighbours."""
    before = (points[near] - points[:, None]).norm(dim=2)
    after = (images[near] - images[:, None]).norm(dim=2)
    stretch: Tensor = (after - before).abs().mean(dim=1)
    return stretch


def overlap(
    full: Operators,
    partial: Operators,
    partial_to_full: Int[Tensor, " n_p"],
    *,
    settings: ConfidenceSettings | None = None,
) -> Bool[Tensor, " n_f"]:
    """Overlap region of a full and a partial shape: which points of the full one have a counterpart on the partial one.

    The partial shape's mass is pushed forward along the map and smoothed by a heat step on the full shape, see
    ``coverage_density``; both shapes at one scale. New here.
    """
    settings = settings or ConfidenceSettings()
    return coverage_density(full, partial.mass, partial_to_full, settings=settings) >= settings.overlap_threshold


def coverage_density(
    full: Operators,
    mass: Float[Tensor, " n_p"],
    partial_to_full: Int[Tensor, " n_p"],
    *,
    settings: ConfidenceSettings | None = None,
) -> Float[Tensor, " n_f"]:
    """Smoothed density of pushed-forward mass relative to the full shape's own; see ``overlap``.

    Raises:
        ArgumentError: if an index is that of no point of the full shape.
    """
    check_indices("partial_to_full", partial_to_full, len(full.mass))
    own = full.mass.double().cpu().numpy()
    pushed = np.bincount(partial_to_full.cpu().numpy(), weights=mass.double().cpu().numpy(), minlength=len(own))
    width = (settings or ConfidenceSettings()).smoothing * np.sqrt(own.sum() / len(own))
    laplacian = full.laplacian.cpu()
    sparse = csc_matrix(
        (laplacian.values().double().numpy(), laplacian.col_indices().numpy(), laplacian.crow_indices().numpy()),
        shape=laplacian.shape,  # the last point may have no entry
    )
    heat = splu((diags(own) + width**2 * sparse).tocsc(), permc_spec="MMD_AT_PLUS_A")
    return torch.from_numpy(heat.solve(pushed)).to(full.mass)
