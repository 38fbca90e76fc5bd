"""How far to trust a point map, and which points have no counterpart, without any ground truth."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from scipy.sparse import csc_matrix, diags
from scipy.sparse.linalg import splu
from scipy.spatial import KDTree
from torch import Tensor

from homolog.core.arguments import check_indices
from homolog.core.arrays import takes_arrays
from homolog.geometry import Operators
from homolog.maps.quality import cycle_error

# Neighbours of a point that its match is judged with.
_NEIGHBOURS = 20
# Distortion, in inner units, at which the confidence has fallen to 1/e.
_SCALE = 0.1
# The pushed-forward mass is smoothed over about this many point spacings; less leaves gaps between samples open.
_COVERAGE_SPACINGS = 2.0
_COVERED = 0.5


@takes_arrays
def confidence(
    points_y: Float[Tensor, "n_y 3"],
    points_x: Float[Tensor, "n_x 3"],
    y_to_x: Int[Tensor, " n_y"],
    x_to_y: Int[Tensor, " n_x"],
) -> Float[Tensor, " n_y"]:
    """Confidence between 0 and 1 in each entry of ``y_to_x``; the points in inner units.

    Two things betray a wrong match: going there and back does not come home, and neighbours do not keep their
    distances. Both are averaged over a point's nearest neighbours, as errors come in patches.

    Raises:
        ArgumentError: if an index is that of no point, as is -1, where there is no counterpart.
    """
    home = cycle_error(points_y, y_to_x, x_to_y)
    near = _neighbourhoods(points_y)
    stretch = local_stretch(points_y, points_x[y_to_x], near)
    return torch.exp(-(home[near].mean(dim=1) + stretch) / _SCALE)


@takes_arrays
def local_stretch(
    points: Float[Tensor, "n 3"], images: Float[Tensor, "n 3"], near: Int[Tensor, "n j"]
) -> Float[Tensor, " n"]:
    """By how much, on average, a map changes the distances between a point and its neighbours."""
    before = (points[near] - points[:, None]).norm(dim=2)
    after = (images[near] - images[:, None]).norm(dim=2)
    stretch: Tensor = (after - before).abs().mean(dim=1)
    return stretch


def _neighbourhoods(points: Float[Tensor, "n 3"]) -> Int[Tensor, "n j"]:
    """Indices of each point's nearest points, itself among them."""
    positions = points.cpu().numpy()
    _, near = KDTree(positions).query(positions, k=min(_NEIGHBOURS + 1, len(positions)))
    return torch.from_numpy(near).to(points.device)


def overlap(complete: Operators, partial: Operators, partial_to_complete: Int[Tensor, " n_p"]) -> Bool[Tensor, " n_c"]:
    """Which points of a complete shape have a counterpart on a partial one, both at one scale.

    The partial shape's mass is pushed forward along the map and smoothed by a heat step on the complete shape. Where
    the shape is covered the result is near one, elsewhere near zero, and a half on the edge of the cut.
    """
    density = coverage_density(complete, partial.mass, partial_to_complete)
    return density >= _COVERED


def coverage_density(
    complete: Operators, mass: Float[Tensor, " n_p"], partial_to_complete: Int[Tensor, " n_p"]
) -> Float[Tensor, " n_c"]:
    """Smoothed density of pushed-forward mass relative to the complete shape's own; see ``covered``.

    Raises:
        ArgumentError: if an index is that of no point of the complete shape.
    """
    check_indices("partial_to_complete", partial_to_complete, len(complete.mass))
    own = complete.mass.double().cpu().numpy()
    pushed = np.bincount(partial_to_complete.cpu().numpy(), weights=mass.double().cpu().numpy(), minlength=len(own))
    spacing = np.sqrt(own.sum() / len(own))
    laplacian = complete.laplacian.cpu()
    sparse = csc_matrix(
        (laplacian.values().double().numpy(), laplacian.col_indices().numpy(), laplacian.crow_indices().numpy()),
        shape=laplacian.shape,  # the last point may have no entry
    )
    heat = splu((diags(own) + (_COVERAGE_SPACINGS * spacing) ** 2 * sparse).tocsc(), permc_spec="MMD_AT_PLUS_A")
    return torch.from_numpy(heat.solve(pushed)).to(complete.mass)
