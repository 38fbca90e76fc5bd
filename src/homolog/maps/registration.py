"""Registration of clouds in one frame by a self-organising map: for organs, which keep neither lengths nor areas."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
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
from homolog.geometry import some_points
from homolog.maps.rigid import Similarity
from homolog.maps.rotations import best_rotation, rotation_angle

# A point moves if this share of a mean pull reaches it.
_LEAST = 1e-6

# Points of each cloud that tell how far it is turned, and how often that is looked at.
_FEW, _TURNS = 1000, 3

_Points = Float[np.ndarray, "n 3"]


@dataclass(frozen=True, kw_only=True)
class RegistrationSettings(Settings):
    """Schedule of the self-organising map in ``registered_positions``.

    The defaults were chosen on training pairs of lungs, those of turns on five vertebrae as well.

    Args:
        n_neighbours: nearest points that each point is connected to, at least 1; 6 to 20 are sensible.
        start_width: edges over which the first round averages, as a share of the number of points, from 0 to 1; 0.003
            to 0.03 are sensible. Wider averages follow coarser differences, and cost in proportion.
        narrowing: factor of the width from round to round, at least 0 and below 1, until it is below one edge. Larger
            factors make more rounds.
        most_left: two clouds are turned if the third turn is less than this share of the first, at least 0 and below 1;
            see ``registration_start``.

    Examples:
        >>> from homolog.maps import RegistrationSettings
        >>> list(RegistrationSettings().widths(5000))
        [50, 25, 12, 6, 3, 1]
    """

    n_neighbours: Count = 8
    start_width: Annotated[float, Ge(0), Le(1)] = 0.01
    narrowing: Share = 0.5
    most_left: Share = 0.35

    def widths(self, n_points: int) -> Iterator[int]:
        """Over how many edges each round averages."""
        width = max(round(self.start_width * n_points), 1)
        while width:
            yield width
            width = int(width * self.narrowing)


@dataclass(frozen=True, eq=False)
class _Cloud:
    """Points with the share of the whole area that each stands for."""

    points: _Points
    shares: Float[np.ndarray, " n"]

    @classmethod
    def of(cls, points: Float[Tensor, "n 3"], areas: Float[Tensor, " n"] | None) -> _Cloud:
        given = torch.ones_like(points[:, 0]) if areas is None else areas
        weights = given.detach().double().cpu().numpy()
        return cls(points.detach().double().cpu().numpy(), weights / weights.sum())

    def moved(self, similarity: Similarity) -> _Cloud:
        return _Cloud(similarity(torch.from_numpy(self.points)).numpy(), self.shares)

    @property
    def centre(self) -> Float[np.ndarray, " 3"]:
        centre: Float[np.ndarray, " 3"] = self.shares @ self.points
        return centre

    @property
    def size(self) -> float:
        """Root-mean-square distance from the centre."""
        return float(np.sqrt(self.shares @ np.square(self.points - self.centre).sum(axis=1)))

    def onto(self, other: _Cloud, rotation: Float[Tensor, "3 3"]) -> Similarity:
        """The rotation about the centre, with the centre and the size of the other; at one size if this has none."""
        scale = other.size / self.size if self.size else 1.0
        centre, target = torch.from_numpy(self.centre), torch.from_numpy(other.centre)
        return Similarity(rotation, scale, target - scale * rotation @ centre)


@takes_arrays
def registered_positions(
    points_x: Float[Tensor, "n_x 3"],
    points_y: Float[Tensor, "n_y 3"],
    *,
    areas_x: Float[Tensor, " n_x"] | None = None,
    areas_y: Float[Tensor, " n_y"] | None = None,
    start: Similarity | None = None,
    settings: RegistrationSettings | None = None,
) -> tuple[Float[Tensor, "n_x 3"], Float[Tensor, "n_y 3"]]:
    """Registration of two clouds by a self-organising map, in both directions; positions of each on the other.

    Each round, every point of y pulls the point of x that is nearest to it by then, and each point of x moves to the
    mean of what its surroundings are pulled to. The surroundings are wide first and narrow last. That is a
    self-organising map in batches (Kohonen, "Self-organized formation of topologically correct feature maps", 1982), as
    Ferrarini et al. ("GAMEs: growing and adaptive meshes", Medical Image Analysis 2007) use it for models of organs.
    New here: points pull by their area, and both directions are computed and averaged, x registered to y and x carried
    back by y registered to x.

    Without areas every point pulls alike, so regions with many points go to regions with many: sample both clouds alike
    then. Both must be in one orientation.

    Args:
        points_x: positions of one cloud (n_x, 3).
        points_y: of the other (n_y, 3).
        areas_x: what each point of x stands for, such as ``Operators.mass`` (n_x,); by default all alike.
        areas_y: likewise (n_y,).
        start: where x begins; by default with the centre and the size (root mean square) of y, and not turned. See
            ``registration_start``.
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
    x, y = _Cloud.of(points_x, areas_x), _Cloud.of(points_y, areas_y)
    begun = x.onto(y, torch.eye(3).double()) if start is None else start.to(torch.empty(0).double())
    on_y, at_start = _both_ways(x.moved(begun), y, settings)
    on_x = begun.inverse()(torch.from_numpy(at_start))
    return torch.from_numpy(on_y).to(points_x), on_x.to(points_x)


def registration_start(
    points_x: Float[Tensor, "n_x 3"],
    points_y: Float[Tensor, "n_y 3"],
    *,
    areas_x: Float[Tensor, " n_x"] | None = None,
    areas_y: Float[Tensor, " n_y"] | None = None,
    settings: RegistrationSettings | None = None,
) -> Similarity:
    """The similarity transform from which two clouds that stand nearly alike are best registered. New here.

    Samples are registered, and turned by the rotation about both centres that comes nearest to where they went, three
    times over. Of shapes with a distinct form, such as bones, the turns soon become small. A smooth shape, such as a
    lobe of a lung, goes on to turn until it lies best within the other, as it does by iterated closest points: what
    differs in form is taken for a turn. So none is made where turns do not soon become smaller.

    Args:
        points_x: positions of one cloud (n_x, 3).
        points_y: of the other (n_y, 3).
        areas_x: of the surface that each point of x stands for (n_x,); by default all alike.
        areas_y: likewise (n_y,).
        settings: as of ``registered_positions``.

    Examples:
        >>> import torch, trimesh
        >>> from homolog.maps import registration_start, rotation_angle
        >>> box = trimesh.creation.box([1, 2, 3]).subdivide_loop(4)
        >>> points = torch.tensor(box.vertices)
        >>> start = registration_start(points, 2 * points)
        >>> round(float(rotation_angle(start.rotation))), round(start.scale, 3)
        (0, 2.0)
    """
    settings = given_or_default("settings", settings, RegistrationSettings)
    x, y = _Cloud.of(points_x, areas_x), _Cloud.of(points_y, areas_y)
    few_x, few_y = (_few(cloud, seed) for seed, cloud in enumerate((x, y)))
    rotations = [torch.eye(3).double()]
    for _ in range(_TURNS):
        rotations.append(_turn(few_x.moved(few_x.onto(few_y, rotations[-1])), few_y, settings) @ rotations[-1])
    turns = [float(rotation_angle(after @ before.T)) for before, after in pairwise(rotations)]
    return x.onto(y, rotations[-1] if turns[-1] < settings.most_left * turns[0] else rotations[0])


def _few(cloud: _Cloud, seed: int) -> _Cloud:
    kept = some_points(len(cloud.points), _FEW, seed=seed).numpy()
    return _Cloud(cloud.points[kept], cloud.shares[kept] / cloud.shares[kept].sum())


def _turn(x: _Cloud, y: _Cloud, settings: RegistrationSettings) -> Float[Tensor, "3 3"]:
    """The rotation that comes nearest to a registration."""
    on_y, on_x = _both_ways(x, y, settings)
    ends = (np.concatenate(both) for both in ((x.points, on_x), (on_y, y.points), (x.shares, y.shares)))
    points, targets, weights = map(torch.from_numpy, ends)
    rotation: Tensor = best_rotation(points, targets, weights)
    return rotation


def _both_ways(x: _Cloud, y: _Cloud, settings: RegistrationSettings) -> tuple[_Points, Float[np.ndarray, "m 3"]]:
    """Where x lies on y and y on x, from where they are: the mean of one registered and of the other carried back."""
    on_y, on_x = _registered(x, y, settings), _registered(y, x, settings)
    return (on_y + _carried_back(x, on_x, y)) / 2, (on_x + _carried_back(y, on_y, x)) / 2


def _registered(x: _Cloud, y: _Cloud, settings: RegistrationSettings) -> _Points:
    """One direction of the registration: x pulled by y, averaged over neighbours on x."""
    averages, positions = _averages(x.points, settings.n_neighbours), x.points
    pulls = np.column_stack([y.points, np.ones(len(y.points))]) * y.shares[:, None]
    for width in settings.widths(len(positions)):
        pulled = KDTree(positions).query(y.points, workers=-1)[1]
        sums = np.stack([np.bincount(pulled, column, minlength=len(positions)) for column in pulls.T], axis=1)
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


def _carried_back(x: _Cloud, y_on_x: Float[np.ndarray, "m 3"], y: _Cloud) -> _Points:
    """Positions of x among y, which was registered to it: by the nearest point, with the offset from it."""
    nearest = KDTree(y_on_x).query(x.points, workers=-1)[1]
    back: _Points = y.points[nearest] + (x.points - y_on_x[nearest])
    return back
