"""Registration of clouds in one frame by a self-organising map: for organs, which keep neither lengths nor areas."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Annotated

import numpy as np
import scipy.sparse as sparse
import torch
from annotated_types import Ge, Le
from jaxtyping import Float, Int
from scipy.spatial import KDTree
from torch import Tensor

from homolog.core.arguments import given_or_default
from homolog.core.arrays import takes_arrays
from homolog.core.errors import ArgumentError
from homolog.core.reprs import short_repr
from homolog.core.settings import Count, NotNegative, Settings, Share
from homolog.geometry import some_points
from homolog.maps.rigid import Similarity, closest_point_similarity
from homolog.maps.rotations import best_rotation, rotation_angle

# A point moves if this share of a mean pull reaches it.
_LEAST = 1e-6

# Points of each cloud that tell how far it is turned, and how often that is looked at.
_FEW, _TURNS = 1000, 3
# Points of each cloud, drawn by area, that closest points are looked for among.
_DRAWN = 3000

_Points = Float[np.ndarray, "n 3"]


@dataclass(frozen=True, kw_only=True)
class RegistrationSettings(Settings):
    """Schedule of the self-organising map in ``registered_surfaces``.

    The defaults were chosen on training pairs of lungs, those of turns on five vertebrae as well.

    Args:
        n_neighbours: nearest points that each point is connected to, at least 1; 6 to 20 are sensible.
        start_width: edges over which the first round averages, as a share of the number of points, from 0 to 1; 0.003
            to 0.03 are sensible. Wider averages follow coarser differences, and cost in proportion.
        narrowing: factor of the width from round to round, at least 0 and below 1, until it is below one edge. Larger
            factors make more rounds.
        most_left: two shapes have a distinct form if the third turn is less than this share of the first, at least 0
            and below 1; see ``registration_start``.
        most_apart: two surfaces are nearly rigid copies if the median distance between them is less than this share of
            the size of y (root mean square distance from its centre), at least 0. Vertebrae of two people have 0.04 to
            0.08.
        most_bent: surfaces of which a tenth is farther apart than this share of the size of y, at least 0, are bent
            against each other, and no nearly rigid copies. Vertebrae have up to 0.21, two people in other poses 0.25
            and more.
        normal_weight: how far apart points with normals at 60 degrees are, as a share of the size of y, at least 0; 0.1
            to 0.4 are sensible. More tells the sides of thin parts apart, and follows differences in form less.

    Examples:
        >>> from homolog.maps import RegistrationSettings
        >>> list(RegistrationSettings().widths(5000))
        [50, 25, 12, 6, 3, 1]
    """

    n_neighbours: Count = 8
    start_width: Annotated[float, Ge(0), Le(1)] = 0.01
    narrowing: Share = 0.5
    most_left: Share = 0.35
    most_apart: NotNegative = 0.025
    most_bent: NotNegative = 0.24
    normal_weight: NotNegative = 0.2

    def widths(self, n_points: int) -> Iterator[int]:
        """Over how many edges each round averages."""
        width = max(round(self.start_width * n_points), 1)
        while width:
            yield width
            width = int(width * self.narrowing)


@dataclass(frozen=True, eq=False)
class SampledSurface:
    """Points of a surface that is registered, with what is known of it there.

    Args:
        points: positions (n, 3).
        areas: of the surface that each point stands for, such as ``Operators.mass`` (n,); by default all alike.
        normals: unit normals, which count by ``RegistrationSettings.normal_weight`` if both shapes have some (n, 3); by
            default none.
        in_lines: whether the points lie in lines with empty space between them, as the contours of slices do.

    Raises:
        ArgumentError: if there are not as many areas or normals as points.

    Examples:
        >>> import homolog
        >>> from homolog.maps import SampledSurface
        >>> operators = homolog.compute_operators(homolog.demo_shapes()[0])
        >>> body = SampledSurface(operators.points, operators.mass)
    """

    points: Float[Tensor, "n 3"]
    areas: Float[Tensor, " n"] | None = None
    normals: Float[Tensor, "n 3"] | None = None
    in_lines: bool = False

    __repr__ = short_repr

    def __post_init__(self) -> None:
        count = len(self.points)
        for name, shape in (("points", (count, 3)), ("areas", (count,)), ("normals", (count, 3))):
            value = getattr(self, name)
            if value is not None and tuple(value.shape) != shape:
                raise ArgumentError(f"{name} have shape {tuple(value.shape)}, but must have shape {shape}")


@dataclass(frozen=True, eq=False)
class _Cloud:
    """Points with the share of the whole area that each stands for, and unit normals, which are zero where unknown."""

    points: _Points
    shares: Float[np.ndarray, " n"]
    normals: _Points
    normal_length: float = 0.0  # by which normals weigh against distances

    @classmethod
    def of(cls, surface: SampledSurface) -> _Cloud:
        points, areas, normals = surface.points, surface.areas, surface.normals
        weights = _array(torch.ones_like(points[:, 0]) if areas is None else areas)
        unit = _array(torch.zeros_like(points) if normals is None else normals)
        return cls(_array(points), weights / weights.sum(), unit)

    def moved(self, similarity: Similarity) -> _Cloud:
        turned = self.normals @ similarity.rotation.numpy().T
        return replace(self, points=similarity(torch.from_numpy(self.points)).numpy(), normals=turned)

    def few(self, seed: int) -> _Cloud:
        """Some of the points, without normals: turns are too coarse for them."""
        kept = some_points(len(self.points), _FEW, seed=seed).numpy()
        return _Cloud(self.points[kept], self.shares[kept] / self.shares[kept].sum(), self.normals[kept])

    def drawn(self, seed: int) -> _Cloud:
        """Points drawn by their area, which then count alike."""
        drawn = np.random.default_rng(seed).choice(len(self.points), _DRAWN, p=self.shares)
        return _Cloud(self.points[drawn], np.full(_DRAWN, 1 / _DRAWN), self.normals[drawn], self.normal_length)

    @property
    def weighed_normals(self) -> _Points:
        """Normals as long as they weigh."""
        weighed: _Points = self.normal_length * self.normals
        return weighed

    @property
    def has_normals(self) -> bool:
        return bool(self.normals.any())

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

    def away(self, other: _Cloud) -> _Points:
        """From the nearest point of the other to each point."""
        away: _Points = self.points - other.points[self._nearest_on(other)]
        return away

    def apart(self, other: _Cloud) -> float:
        """The median distance of closest points across the surface, which does not depend on how it is sampled.

        By the normals of one of them.
        """
        nearest = self._nearest_on(other)
        across = self.normals if self.has_normals else other.normals[nearest]
        return float(np.median(np.abs(((self.points - other.points[nearest]) * across).sum(axis=1))))

    def _nearest_on(self, other: _Cloud) -> Int[np.ndarray, " n"]:
        return _nearest(self.points, self.weighed_normals, other.points, other.weighed_normals)

    def bent(self, other: _Cloud) -> float:
        """How far the tenth of one that lies farthest from the other is away, at least; of the one that lies within."""
        both = self.away(other), other.away(self)
        return min(float(np.quantile(np.linalg.norm(away, axis=1), 0.9)) for away in both)


@dataclass(frozen=True, eq=False)
class RegistrationStart:
    """Where a registration begins.

    Args:
        similarity: what takes x near y.
        near_rigid: whether x is then nearly where it belongs, as a bone is: points are moved by the mean of how far
            their surroundings are pulled, and not to the mean of where to.

    Examples:
        >>> import torch
        >>> from homolog.maps import RegistrationStart, Similarity
        >>> RegistrationStart(Similarity(torch.eye(3), 2.0, torch.zeros(3))).near_rigid
        False
    """

    similarity: Similarity
    near_rigid: bool = False


@takes_arrays
def registered_positions(
    points_x: Float[Tensor, "n_x 3"],
    points_y: Float[Tensor, "n_y 3"],
    *,
    start: RegistrationStart | None = None,
    settings: RegistrationSettings | None = None,
) -> tuple[Float[Tensor, "n_x 3"], Float[Tensor, "n_y 3"]]:
    """Registration of two clouds by a self-organising map, in both directions; positions of each on the other.

    Every point pulls alike, so regions with many points go to regions with many: sample both clouds alike. See
    ``registered_surfaces``.

    Args:
        points_x: positions of one cloud (n_x, 3).
        points_y: of the other (n_y, 3), in the same orientation.
        start: where x begins; by default with the centre and the size (root mean square) of y, and not turned.
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
    return registered_surfaces(SampledSurface(points_x), SampledSurface(points_y), start=start, settings=settings)


def registered_surfaces(
    x: SampledSurface,
    y: SampledSurface,
    *,
    start: RegistrationStart | None = None,
    settings: RegistrationSettings | None = None,
) -> tuple[Float[Tensor, "n_x 3"], Float[Tensor, "n_y 3"]]:
    """Registration of the points of two surfaces by a self-organising map, in both directions.

    Each round, every point of y pulls the point of x that is nearest to it by then, and each point of x moves to the
    mean of what its surroundings are pulled to. The surroundings are wide first and narrow last. That is a
    self-organising map in batches (Kohonen, "Self-organized formation of topologically correct feature maps", 1982), as
    Ferrarini et al. ("GAMEs: growing and adaptive meshes", Medical Image Analysis 2007) use it for models of organs.
    New here: points pull by their area, and both directions are computed and averaged, x registered to y and x carried
    back by y registered to x.

    What is nearly a rigid copy (``RegistrationStart.near_rigid``) is better moved by the mean of how far its
    surroundings are pulled: a mean of positions shrinks, and draws a part that the other lacks into it. So is what is
    sampled in lines (``SampledSurface.in_lines``), between which nothing pulls. Nearest points are those of like
    normals, if both have some.

    Args:
        x: one surface.
        y: the other, in the same orientation.
        start: where x begins; by default with the centre and the size (root mean square) of y, and not turned. See
            ``registration_start``.
        settings: the schedule of the rounds.

    Returns:
        Where the points of x lie on y (n_x, 3), and those of y on x (n_y, 3).

    Examples:
        >>> import torch, trimesh
        >>> from homolog.maps import SampledSurface, registered_surfaces
        >>> mesh = trimesh.creation.icosphere(subdivisions=3)
        >>> sphere = SampledSurface(torch.tensor(mesh.vertices), normals=torch.tensor(mesh.vertex_normals))
        >>> larger = SampledSurface(2 * sphere.points, normals=sphere.normals)
        >>> on_larger, on_sphere = registered_surfaces(sphere, larger)
        >>> bool((on_larger - larger.points).norm(dim=1).mean() < 0.1)
        True
    """
    settings = given_or_default("settings", settings, RegistrationSettings)
    one, other = _both(x, y, settings)
    start = start or RegistrationStart(one.onto(other, torch.eye(3).double()))
    begun = start.similarity.to(torch.empty(0).double())
    by_shifts = start.near_rigid or x.in_lines or y.in_lines
    on_y, at_start = _both_ways(one.moved(begun), other, settings, by_shifts=by_shifts)
    on_x = begun.inverse()(torch.from_numpy(at_start))
    return torch.from_numpy(on_y).to(x.points), on_x.to(x.points)


def registration_start(
    x: SampledSurface, y: SampledSurface, *, turns: bool = True, settings: RegistrationSettings | None = None
) -> RegistrationStart:
    """The similarity transform from which two surfaces that stand nearly alike are best registered. New here.

    Samples are registered, and turned by the rotation about both centres that comes nearest to where they went, three
    times over. Of shapes with a distinct form, such as bones, the turns soon become small. A smooth shape, such as a
    lobe of a lung, goes on to turn until it lies best within the other: what differs in form is taken for a turn. So
    none is made where turns do not soon become smaller.

    Where normals of one are known, closest points go on from there (``closest_point_similarity``). They tell the turn,
    the size and the place that most of one and of the other agree about; centres and sizes are misled by what one of
    them lacks, and by a sampling that leaves much of a surface empty. That is believed of shapes that then lie nearly
    in one surface, unless a tenth of it lies far away: they are nearly rigid copies. Where both have normals it is also
    believed of shapes with a distinct form; without, closest points slide along surfaces that differ.

    Args:
        x: one surface.
        y: the other.
        turns: whether x may be turned, but for a nearly rigid copy, which closest points turn in any case.
        settings: as of ``registered_surfaces``.

    Examples:
        >>> import torch, trimesh
        >>> from homolog.maps import SampledSurface, registration_start, rotation_angle
        >>> box = trimesh.creation.box([1, 2, 3]).subdivide_loop(4)
        >>> points = torch.tensor(box.vertices)
        >>> start = registration_start(SampledSurface(points), SampledSurface(2 * points))
        >>> round(float(rotation_angle(start.similarity.rotation))), round(start.similarity.scale, 3)
        (0, 2.0)
    """
    settings = given_or_default("settings", settings, RegistrationSettings)
    one, other = _both(x, y, settings)
    rotations = _turned(one, other, settings) if turns else [torch.eye(3).double()]
    angles = [float(rotation_angle(after @ before.T)) for before, after in pairwise(rotations)]
    is_distinct = bool(angles) and angles[-1] < settings.most_left * angles[0]
    plain = one.onto(other, rotations[-1] if is_distinct else rotations[0])
    if one.has_normals or other.has_normals:
        has_both = one.normal_length > 0
        # Normals of both find the way back from turns that are too large.
        begun = one.onto(other, rotations[-1]) if has_both else plain
        drawn, among = one.drawn(0), other.drawn(1)
        closest = _closest(drawn, among, begun)
        at_start = drawn.moved(closest)
        is_near = at_start.apart(among) < settings.most_apart * other.size or (is_distinct and has_both)
        if is_near and at_start.bent(among) < settings.most_bent * other.size:
            return RegistrationStart(closest, near_rigid=True)
    return RegistrationStart(plain)


def _both(x: SampledSurface, y: SampledSurface, settings: RegistrationSettings) -> tuple[_Cloud, _Cloud]:
    """Both, with the weight of normals in y's units; none where those of one are unknown."""
    one, other = _Cloud.of(x), _Cloud.of(y)
    length = settings.normal_weight * other.size if one.has_normals and other.has_normals else 0.0
    return replace(one, normal_length=length), replace(other, normal_length=length)


def _closest(x: _Cloud, y: _Cloud, start: Similarity) -> Similarity:
    """Closest points of x and y, which are drawn by area, from a start."""
    arrays = map(torch.from_numpy, (x.points, y.points, x.weighed_normals, y.weighed_normals))
    points_x, points_y, normals_x, normals_y = arrays
    return closest_point_similarity(points_x, points_y, normals_x=normals_x, normals_y=normals_y, start=start)


def _array(tensor: Tensor) -> np.ndarray:
    return tensor.detach().double().cpu().numpy()


def _turned(x: _Cloud, y: _Cloud, settings: RegistrationSettings) -> list[Float[Tensor, "3 3"]]:
    """No rotation, and those after one registration of some samples and more."""
    few_x, few_y = x.few(0), y.few(1)
    rotations = [torch.eye(3).double()]
    for _ in range(_TURNS):
        rotations.append(_turn(few_x.moved(few_x.onto(few_y, rotations[-1])), few_y, settings) @ rotations[-1])
    return rotations


def _turn(x: _Cloud, y: _Cloud, settings: RegistrationSettings) -> Float[Tensor, "3 3"]:
    """The rotation that comes nearest to a registration."""
    on_y, on_x = _both_ways(x, y, settings)
    ends = (np.concatenate(both) for both in ((x.points, on_x), (on_y, y.points), (x.shares, y.shares)))
    points, targets, weights = map(torch.from_numpy, ends)
    rotation: Tensor = best_rotation(points, targets, weights)
    return rotation


def _both_ways(
    x: _Cloud, y: _Cloud, settings: RegistrationSettings, *, by_shifts: bool = False
) -> tuple[_Points, Float[np.ndarray, "m 3"]]:
    """Where x lies on y and y on x, from where they are: the mean of one registered and of the other carried back."""
    on_y, on_x = (_registered(*both, settings, by_shifts=by_shifts) for both in ((x, y), (y, x)))
    return (on_y + _carried_back(x, on_x, y)) / 2, (on_x + _carried_back(y, on_y, x)) / 2


def _registered(x: _Cloud, y: _Cloud, settings: RegistrationSettings, *, by_shifts: bool) -> _Points:
    """One direction of the registration: x pulled by y, averaged over neighbours on x."""
    averages, positions = _averages(x.points, settings.n_neighbours), x.points
    for width in settings.widths(len(positions)):
        pulled = _nearest(y.points, y.weighed_normals, positions, x.weighed_normals)
        # What is averaged is how far points are pulled, or where to.
        origins = positions if by_shifts else np.zeros_like(positions)
        pulls = np.column_stack([y.points - origins[pulled], np.ones(len(y.points))]) * y.shares[:, None]
        sums = np.stack([np.bincount(pulled, column, minlength=len(positions)) for column in pulls.T], axis=1)
        for _ in range(width):
            sums = averages @ sums
        # Points stay where nothing near is pulled.
        moved = sums[:, 3] > _LEAST * sums[:, 3].mean()
        means = sums[:, :3] / np.where(moved, sums[:, 3], 1)[:, None]
        positions = np.where(moved[:, None], origins + means, positions)
    return positions


def _nearest(points: _Points, normals: _Points, among: _Points, normals_among: _Points) -> Int[np.ndarray, " n"]:
    found: np.ndarray = KDTree(np.hstack([among, normals_among])).query(np.hstack([points, normals]), workers=-1)[1]
    return found


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
    nearest = _nearest(x.points, x.weighed_normals, y_on_x, y.weighed_normals)
    back: _Points = y.points[nearest] + (x.points - y_on_x[nearest])
    return back
