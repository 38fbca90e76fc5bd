"""Clouds of one kind that stand alike, drawn onto each other: for organs, which keep neither lengths nor areas."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sparse
import torch
from jaxtyping import Float
from scipy.spatial import KDTree
from torch import Tensor

from homolog.core.arrays import takes_arrays

# Points that each point is connected to.
_NEIGHBOURS = 8
# Averages reach this share of the points first, and half as many with every round, down to the neighbours alone.
_WIDEST = 0.01
# A point is pulled if this share of a mean pull reaches it.
_LEAST = 1e-6

_Points = Float[np.ndarray, "n 3"]


@takes_arrays
def registered_positions(
    points_x: Float[Tensor, "n_x 3"], points_y: Float[Tensor, "n_y 3"]
) -> tuple[Float[Tensor, "n_x 3"], Float[Tensor, "n_y 3"]]:
    """Where the points of x come to lie on y, and those of y on x, if each cloud is an elastic skin.

    One is drawn onto the other in rounds: every point of y pulls the point of x that is nearest to it by then, and each
    point of x goes to the mean of what its surroundings are pulled to, which are wide first and narrow last. That is a
    self-organising map in batches (Kohonen, "Self-organized formation of topologically correct feature maps", 1982),
    as Ferrarini et al. ("GAMEs: growing and adaptive meshes", Medical Image Analysis 2007) take it for models of
    organs. Every point pulls alike: regions with many points go to regions with many, so that clouds must be sampled
    alike. Both ways are taken, and meet in the middle: x drawn onto y, and x as it lies to y once y is drawn onto x.

    For shapes that stand alike: both are laid on one middle and brought to one size (root mean square) first, and
    nothing is turned.

    Args:
        points_x: positions of one cloud.
        points_y: of the other.
    """
    x, y = (points.detach().double().cpu().numpy() for points in (points_x, points_y))
    on_y, on_x = _drawn(x, y), _drawn(y, x)
    met = (on_y + _the_way_back(x, on_x, y)) / 2, (on_x + _the_way_back(y, on_y, x)) / 2
    first, second = (torch.from_numpy(positions).to(points_x) for positions in met)
    return first, second


def _laid(points: _Points, goals: Float[np.ndarray, "m 3"]) -> _Points:
    """Points on the middle of the goals, and as large."""
    middle = goals.mean(axis=0)
    offsets = points - points.mean(axis=0)
    laid: _Points = middle + offsets * _ratio(points, goals)
    return laid


def _ratio(points: _Points, goals: Float[np.ndarray, "m 3"]) -> float:
    """How many times as large the goals are; 1 where the points are at one place."""
    size, aim = (float(np.sqrt(cloud.var(axis=0).sum())) for cloud in (points, goals))
    return aim / size if size else 1.0


def _drawn(points: _Points, goals: Float[np.ndarray, "m 3"]) -> _Points:
    """Where a cloud comes to lie that is pulled by the goals; what is around a point stays so."""
    averages, positions = _averages(points), _laid(points, goals)
    pulls = np.column_stack([goals, np.ones(len(goals))])
    reach = max(round(_WIDEST * len(points)), 1)
    while reach:
        pulled = KDTree(positions).query(pulls[:, :3], workers=-1)[1]
        sums = np.stack([np.bincount(pulled, column, minlength=len(points)) for column in pulls.T], axis=1)
        for _ in range(reach):
            sums = averages @ sums
        # Where nothing near is pulled, points stay.
        moved = sums[:, 3] > _LEAST * sums[:, 3].mean()
        positions = np.where(moved[:, None], sums[:, :3] / np.where(moved, sums[:, 3], 1)[:, None], positions)
        reach //= 2
    return positions


def _averages(points: _Points) -> sparse.csr_array:
    """The mean over each point and its neighbours, which are each other's."""
    n = len(points)
    near = KDTree(points).query(points, k=range(1, min(_NEIGHBOURS + 1, n) + 1), workers=-1)[1]
    rows = np.repeat(np.arange(n), near.shape[1])
    joined = sparse.csr_array((np.ones(near.size), (rows, near.ravel())), shape=(n, n))
    joined = ((joined + joined.T + sparse.eye_array(n)) > 0).astype(float)
    return sparse.csr_array(sparse.diags_array(1 / joined.sum(axis=1)) @ joined)


def _the_way_back(points: _Points, others_on: Float[np.ndarray, "m 3"], others: Float[np.ndarray, "m 3"]) -> _Points:
    """Where points lie among others that were drawn onto them: beside the one that came nearest, and as far away."""
    nearest = KDTree(others_on).query(points, workers=-1)[1]
    back: _Points = others[nearest] + (points - others_on[nearest]) * _ratio(points, others)
    return back
