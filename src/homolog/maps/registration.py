"""Registration of clouds in one frame by a self-organising map: for organs, which keep neither lengths nor areas."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import scipy.sparse as sparse
import torch
from annotated_types import Ge, Le
from jaxtyping import Float
from scipy.spatial import KDTree
from torch import Tensor

from homolog.core.arguments import given_or_default
from homolog.core.arrays import takes_arrays
from homolog.core.settings import Count, Settings, Share

# A point moves if this share of a mean pull reaches it.
_LEAST = 1e-6

_Points = Float[np.ndarray, "n 3"]


@dataclass(frozen=True, kw_only=True)
class RegistrationSettings(Settings):
    """Schedule of the self-organising map in ``registered_positions``.

    The defaults were chosen on training pairs of lungs: twice or half the first width, 6 or 12 neighbours, and a second
    pass are no better there.

    Args:
        n_neighbours: nearest points that each point is connected to, at least 1; 6 to 20 are sensible.
        start_width: edges over which the first round averages, as a share of the number of points, from 0 to 1; 0.003
            to 0.03 are sensible. Wider averages follow coarser differences, and cost in proportion.
        narrowing: factor of the width from round to round, at least 0 and below 1, until it is below one edge. Larger
            factors make more rounds.

    Examples:
        >>> from homolog.maps import RegistrationSettings
        >>> list(RegistrationSettings().widths(5000))
        [50, 25, 12, 6, 3, 1]
    """

    n_neighbours: Count = 8
    start_width: Annotated[float, Ge(0), Le(1)] = 0.01
    narrowing: Share = 0.5

    def widths(self, n_points: int) -> Iterator[int]:
        """Over how many edges each round averages."""
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
    """Registration of two clouds by a self-organising map, in both directions; positions of each on the other.

    Each round, every point of y pulls the point of x that is nearest to it by then, and each point of x moves to the
    mean of what its surroundings are pulled to. The surroundings are wide first and narrow last. That is a
    self-organising map in batches (Kohonen, "Self-organized formation of topologically correct feature maps", 1982), as
    Ferrarini et al. ("GAMEs: growing and adaptive meshes", Medical Image Analysis 2007) use it for models of organs.
    New here: both directions are computed and averaged, x registered to y and x carried back by y registered to x.

    Every point pulls alike, so regions with many points go to regions with many: sample both clouds alike. Both must be
    in one orientation: they are moved to one centre and scaled to one size (root mean square) first, and never rotated.

    Args:
        points_x: positions of one cloud (n_x, 3).
        points_y: of the other (n_y, 3).
        settings: the schedule of the rounds.

    Returns:
        Where the points of x lie on y (n_x, 3), and those of y on x (n_y, 3).

    Examples:
        >>> import torch, trimesh
        >>> from homolog.maps import registered_positions
        >>> sphere = torch.tensor(trimesh.creation.icosphere(subdivisions=3).vertices)
        >>> ellipsoid = sphere * torch.tensor([1.0, 1.3, 0.8], dtype=torch.float64)
        >>> on_ellipsoid, on_sphere = registered_positions(sphere, ellipsoid)
        >>> bool((on_ellipsoid - ellipsoid).norm(dim=1).mean() < 0.1)
        True

    See Also:
        ``nearest_neighbour`` turns the positions into point maps.
    """
    settings = given_or_default("settings", settings, RegistrationSettings)
    x, y = (points.detach().double().cpu().numpy() for points in (points_x, points_y))
    on_y, on_x = _registered(x, y, settings), _registered(y, x, settings)
    met = (on_y + _carried_back(x, on_x, y)) / 2, (on_x + _carried_back(y, on_y, x)) / 2
    first, second = (torch.from_numpy(positions).to(points_x) for positions in met)
    return first, second


def _centred_and_scaled(points: _Points, goals: Float[np.ndarray, "m 3"]) -> _Points:
    """Points moved and scaled to the mean and the root-mean-square size of the goals."""
    middle = goals.mean(axis=0)
    offsets = points - points.mean(axis=0)
    moved: _Points = middle + offsets * _ratio(points, goals)
    return moved


def _ratio(points: _Points, goals: Float[np.ndarray, "m 3"]) -> float:
    """How many times as large the goals are; 1 where all points coincide."""
    size, aim = (float(np.sqrt(cloud.var(axis=0).sum())) for cloud in (points, goals))
    return aim / size if size else 1.0


def _registered(points: _Points, goals: Float[np.ndarray, "m 3"], settings: RegistrationSettings) -> _Points:
    """One direction of the registration: points pulled by the goals, averaged over their neighbours on the cloud."""
    averages, positions = _averages(points, settings.n_neighbours), _centred_and_scaled(points, goals)
    pulls = np.column_stack([goals, np.ones(len(goals))])
    for width in settings.widths(len(points)):
        pulled = KDTree(positions).query(pulls[:, :3], workers=-1)[1]
        sums = np.stack([np.bincount(pulled, column, minlength=len(points)) for column in pulls.T], axis=1)
        for _ in range(width):
            sums = averages @ sums
        # Points stay where nothing near is pulled.
        moved = sums[:, 3] > _LEAST * sums[:, 3].mean()
        positions = np.where(moved[:, None], sums[:, :3] / np.where(moved, sums[:, 3], 1)[:, None], positions)
    return positions


def _averages(points: _Points, n_neighbours: int) -> sparse.csr_array:
    """The matrix of the mean over each point and its neighbours, which are each other's."""
    n = len(points)
    near = KDTree(points).query(points, k=range(1, min(n_neighbours + 1, n) + 1), workers=-1)[1]
    rows = np.repeat(np.arange(n), near.shape[1])
    joined = sparse.csr_array((np.ones(near.size), (rows, near.ravel())), shape=(n, n))
    joined = ((joined + joined.T + sparse.eye_array(n)) > 0).astype(float)
    return sparse.csr_array(sparse.diags_array(1 / joined.sum(axis=1)) @ joined)


def _carried_back(points: _Points, others_on: Float[np.ndarray, "m 3"], others: Float[np.ndarray, "m 3"]) -> _Points:
    """Positions among others that were registered to the points: by the nearest one, with the offset from it."""
    nearest = KDTree(others_on).query(points, workers=-1)[1]
    back: _Points = others[nearest] + (points - others_on[nearest]) * _ratio(points, others)
    return back
