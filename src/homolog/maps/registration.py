"""Clouds of one kind that stand alike, drawn onto each other: for organs, which keep neither lengths nor areas."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sparse
import torch
from jaxtyping import Float
from scipy.spatial import KDTree
from torch import Tensor

from homolog.core.arguments import check_count, check_number
from homolog.core.arrays import takes_arrays

# A point is pulled if this share of a mean pull reaches it.
_LEAST = 1e-6

_Points = Float[np.ndarray, "n 3"]


@dataclass(frozen=True, kw_only=True)
class RegistrationSettings:
    """Schedule of the self-organising map in ``registered_positions``.

    The defaults were chosen on training pairs of lungs: twice or half the first width, 6 or 12 neighbours, and a second
    pass are no better there.

    Args:
        n_neighbours: nearest points that each point is connected to, at least 1; 6 to 20 are sensible.
        start_width: averages reach so many edges in the first round, as a share of the number of points, from 0 to 1;
            0.003 to 0.03 are sensible. Wider ones follow coarser differences, and cost in proportion.
        narrowing: factor of the width from round to round, from 0 to 0.99, until averages reach no further than
            a point itself. Larger ones make more rounds.
    """

    n_neighbours: int = 8
    start_width: float = 0.01
    narrowing: float = 0.5

    def __post_init__(self) -> None:
        check_count("n_neighbours", self.n_neighbours)
        check_number("start_width", self.start_width, least=0, most=1)
        check_number("narrowing", self.narrowing, least=0, most=0.99)

    def widths(self, n_points: int) -> Iterator[int]:
        """How many edges averages reach, round by round."""
        width = max(round(self.start_width * n_points), 1)
        while width:
            yield width
            width = int(width * self.narrowing)


@takes_arrays
def registered_positions(
    points_x: Float[Tensor, "n_x 3"],
    points_y: Float[Tensor, "n_y 3"],
    *,
    settings: RegistrationSettings | None = None,
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
        settings: the schedule of the rounds.
    """
    settings = settings or RegistrationSettings()
    x, y = (points.detach().double().cpu().numpy() for points in (points_x, points_y))
    on_y, on_x = _drawn(x, y, settings), _drawn(y, x, settings)
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


def _drawn(points: _Points, goals: Float[np.ndarray, "m 3"], settings: RegistrationSettings) -> _Points:
    """Where a cloud comes to lie that is pulled by the goals; what is around a point stays so."""
    averages, positions = _averages(points, settings.n_neighbours), _laid(points, goals)
    pulls = np.column_stack([goals, np.ones(len(goals))])
    for width in settings.widths(len(points)):
        pulled = KDTree(positions).query(pulls[:, :3], workers=-1)[1]
        sums = np.stack([np.bincount(pulled, column, minlength=len(points)) for column in pulls.T], axis=1)
        for _ in range(width):
            sums = averages @ sums
        # Where nothing near is pulled, points stay.
        moved = sums[:, 3] > _LEAST * sums[:, 3].mean()
        positions = np.where(moved[:, None], sums[:, :3] / np.where(moved, sums[:, 3], 1)[:, None], positions)
    return positions


def _averages(points: _Points, n_neighbours: int) -> sparse.csr_array:
    """The mean over each point and its neighbours, which are each other's."""
    n = len(points)
    near = KDTree(points).query(points, k=range(1, min(n_neighbours + 1, n) + 1), workers=-1)[1]
    rows = np.repeat(np.arange(n), near.shape[1])
    joined = sparse.csr_array((np.ones(near.size), (rows, near.ravel())), shape=(n, n))
    joined = ((joined + joined.T + sparse.eye_array(n)) > 0).astype(float)
    return sparse.csr_array(sparse.diags_array(1 / joined.sum(axis=1)) @ joined)


def _the_way_back(points: _Points, others_on: Float[np.ndarray, "m 3"], others: Float[np.ndarray, "m 3"]) -> _Points:
    """Where points lie among others that were drawn onto them: beside the one that came nearest, and as far away."""
    nearest = KDTree(others_on).query(points, workers=-1)[1]
    back: _Points = others[nearest] + (points - others_on[nearest]) * _ratio(points, others)
    return back
