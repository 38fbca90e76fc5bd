"""Degradation of point clouds as by scanners: outliers, and non-uniform density."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import ArrayLike
from scipy.spatial import KDTree

from homolog.core.choices import OutlierKind
from homolog.core.errors import ShapeError
from homolog.geometry import Surface, surface_area
from homolog.geometry.components import require_usable
from homolog.shapes import FEWEST_POINTS, Shape, farthest_points
from homolog.synthesis.partial_shape import PartialShape
from homolog.synthesis.sampling import Range, check_number, check_range, checked_direction, sample, sample_direction

# Points of a cluster of outliers.
_CLUSTER = 25
# Pieces of a body, how far they overlap, and how far one stands off another, in units of sqrt(area).
_PIECES, _OVERLAP, _MOST_OFF = 6, 0.06, 0.004
# The coat reaches up to a height below the top of the head and so far to the sides, down to another height, and stands
# off; hair covers what is less than a height below the top, and stands off more or less, strip by strip.
_COAT_FROM, _COAT_TO, _COAT_WIDE, _COAT_AWAY = 0.2, 0.8, 0.28, 0.02
_HAIR, _HAIR_WIDE, _HAIR_AWAY, _STRIPS = 0.11, 0.15, (0.01, 0.03), 12


def add_outliers(shape: Shape, *, share: Range = 0.02, distance: float = 0.1, seed: int) -> PartialShape:
    """Append outliers, which lie far from all points of a shape; their ``full_index`` is -1.

    They are uniform in the bounding box, enlarged by twice ``distance``, outside the neighbourhood of the points.

    Args:
        shape: a clean mesh, of which only the points are taken, or a cloud; not changed.
        share: number of outliers relative to the number of points, or the range from which it is sampled.
        distance: least distance from every point, in units of sqrt(area).
        seed: of all random choices.

    Returns:
        A cloud.

    Raises:
        ArgumentError: if ``share`` or ``distance`` is negative.
        ShapeError: if the shape needs repair.
    """
    check_range("share", share, lambda number: number >= 0, "a number of at least 0")
    check_number("distance", distance, 0)
    require_usable(shape)
    random = np.random.default_rng(seed)
    count = round(sample(share, random) * shape.n_points)
    far = _far_points(shape.points, count, distance * float(np.sqrt(surface_area(shape))), random)
    index = np.concatenate([np.arange(shape.n_points), np.full(count, -1)])
    return PartialShape(Shape(np.concatenate([shape.points, far]), name=shape.name), index)


def add_strays(shape: Shape, share: float, *, kind: OutlierKind = "box", unit: float, seed: int) -> Shape:
    """Append outliers of one kind to the points of a shape; some may lie on its surface by chance.

    Args:
        shape: a mesh, of which only the points are taken, or a cloud; not changed.
        share: number of outliers relative to the number of points.
        kind: ``"box"``: uniform in the bounding box. ``"clusters"``: in clusters of 25 and 0.02 units, whose
            centres are. ``"near"``: up to 0.1 units away from points of the shape, in any direction.
        unit: sqrt(area) of the shape.
        seed: of all random choices.

    Returns:
        A cloud: the shape's points in their order, then the outliers.

    Raises:
        ArgumentError: if ``share`` is negative.
    """
    check_number("share", share, 0)
    random = np.random.default_rng(seed)
    count, points = round(share * shape.n_points), shape.points
    low, high = points.min(axis=0), points.max(axis=0)
    if kind == "box":
        strays = random.uniform(low, high, (count, 3))
    elif kind == "clusters":
        centres = random.uniform(low, high, (-(-count // _CLUSTER), 3))
        strays = np.repeat(centres, _CLUSTER, axis=0)[:count] + random.normal(scale=0.02 * unit, size=(count, 3))
    else:
        directions = random.normal(size=(count, 3))
        away = directions / np.linalg.norm(directions, axis=1, keepdims=True) * random.uniform(0, 0.1, (count, 1))
        strays = points[random.integers(len(points), size=count)] + unit * away
    return Shape(np.concatenate([points, strays]), name=shape.name)


def add_floor(shape: Shape, count: int, *, seed: int) -> Shape:
    """Append a floor to a cloud: points uniform in a square at its lowest height, twice as wide as the cloud.

    Args:
        shape: a cloud, +y up; not changed.
        count: how many points.
        seed: of the points.

    Returns:
        A cloud: the shape's points in their order, then those of the floor.
    """
    low, high = shape.points.min(axis=0), shape.points.max(axis=0)
    half = float((high - low)[[0, 2]].max())
    floor = (low + high) / 2 + half * np.random.default_rng(seed).uniform(-1, 1, (count, 3))
    floor[:, 1] = low[1]
    return Shape(np.concatenate([shape.points, floor]), name=shape.name)


def subsample(
    shape: Shape, *, least: Range = (0.1, 0.5), direction: ArrayLike | None = None, seed: int
) -> PartialShape:
    """Subsample a shape with a density that varies smoothly along a direction; see ``keep_probability``.

    Args:
        shape: a clean mesh, of which only the points are taken, or a cloud; not changed.
        least: the probability to keep a point at the sparse end, or the range from which it is sampled.
        direction: from the sparse end to the dense one, of any length; random by default.
        seed: of all random choices.

    Returns:
        A cloud; its points keep their order.

    Raises:
        ArgumentError: if ``least`` is not from 0 to 1, or ``direction`` no direction.
        ShapeError: if the shape needs repair, or next to nothing is left.

    Examples:
        >>> sparse = subsample(shape, least=0.2, seed=0)  # doctest: +SKIP
    """
    check_range("least", least, lambda share: 0 <= share <= 1, "a number from 0 to 1")
    require_usable(shape)
    random = np.random.default_rng(seed)
    towards = sample_direction(random) if direction is None else checked_direction("direction", direction)
    probability = keep_probability(shape.points, towards, sample(least, random))
    (kept,) = np.nonzero(random.random(shape.n_points) < probability)
    if len(kept) < FEWEST_POINTS:
        raise ShapeError(
            f"{shape.name}: {len(kept)} points are left of it, but a cloud needs {FEWEST_POINTS}; raise `least`"
        )
    return PartialShape(Shape(shape.points[kept], name=shape.name), kept)


def keep_probability(
    points: Float[np.ndarray, "n 3"], direction: Float[np.ndarray, " 3"], least: float
) -> Float[np.ndarray, " n"]:
    """The probability to keep each point: half a cosine wave, from ``least`` to 1 along a direction. New here."""
    heights = points @ direction
    position = (heights - heights.min()) / max(np.ptp(heights), np.finfo(float).tiny)
    share: np.ndarray = least + (1 - least) * (1 - np.cos(np.pi * position)) / 2
    return share


def _far_points(
    points: Float[np.ndarray, "n 3"], count: int, distance: float, random: np.random.Generator
) -> Float[np.ndarray, "count 3"]:
    """Rejection sampling: uniform in the enlarged bounding box, at least ``distance`` from all points."""
    tree = KDTree(points)
    low, high = points.min(axis=0) - 2 * distance, points.max(axis=0) + 2 * distance
    far = np.empty((0, 3))
    while len(far) < count:
        tried = random.uniform(low, high, size=(2 * count, 3))
        far = np.concatenate([far, tried[tree.query(tried)[0] >= distance]])
    return far[:count]


def add_shells(shape: Shape, *, seed: int) -> PartialShape:
    """A body as characters of games are: in six overlapping pieces, with a coat and hair, none joined to another.

    The coat is an open shell around the trunk, the hair a cap of loose strips. Pieces stand off by a little, so that no
    two points are equal.

    Args:
        shape: a clean, closed mesh of a body, +y up; not changed.
        seed: of all random choices.

    Returns:
        A mesh; ``full_index`` is -1 for points of the coat and the hair.

    Raises:
        ShapeError: if it is no mesh.
    """
    require_usable(shape)
    if shape.faces is None:
        raise ShapeError(f"{shape.name} has no faces, but clothes are made of them; give a mesh")
    random, unit = np.random.default_rng(seed), float(np.sqrt(surface_area(shape)))
    normals = Surface(shape.points, shape.faces).vertex_normals
    middles = (shape.points[shape.faces].mean(axis=1) - np.median(shape.points, axis=0)) / unit
    beside = np.hypot(middles[:, 0], middles[:, 2])
    below = middles[beside < _HAIR_WIDE, 1].max() - middles[:, 1]
    hair = (below < _HAIR) & (beside < _HAIR_WIDE)
    shells = [
        *((faces, random.uniform(0, _MOST_OFF)) for faces in _overlapping(middles, seed)),
        ((below > _COAT_FROM) & (below < _COAT_TO) & (beside < _COAT_WIDE), _COAT_AWAY),
        *((faces, random.uniform(*_HAIR_AWAY)) for faces in _strips(middles, hair)),
    ]
    return _apart(shape, normals * unit, shells)


def _apart(
    shape: Shape, steps: Float[np.ndarray, "n 3"], shells: Sequence[tuple[Bool[np.ndarray, " m"], float]]
) -> PartialShape:
    """Shells of some of the faces each, so many steps off the shape; the first of them are pieces of the body."""
    assert shape.faces is not None
    count, points, faces, index = 0, [], [], []
    for number, (chosen, away) in enumerate(shells):
        used, corners = np.unique(shape.faces[chosen], return_inverse=True)
        faces.append(corners.reshape(-1, 3) + count)
        points.append(shape.points[used] + away * steps[used])
        index.append(used if number < _PIECES else np.full(len(used), -1))
        count += len(used)
    return PartialShape(Shape(np.concatenate(points), np.concatenate(faces), name=shape.name), np.concatenate(index))


def _overlapping(middles: Float[np.ndarray, "m 3"], seed: int) -> Iterator[Bool[np.ndarray, " m"]]:
    """The faces of each piece: those around one of a few places, and some of the next pieces'."""
    away = np.linalg.norm(middles[:, None] - middles[farthest_points(middles, _PIECES, seed=seed)], axis=2)
    yield from (away <= away.min(axis=1, keepdims=True) + _OVERLAP).T


def _strips(middles: Float[np.ndarray, "m 3"], hair: Bool[np.ndarray, " m"]) -> Iterator[Bool[np.ndarray, " m"]]:
    """The faces of each strip of hair: every other one of the sectors around the head's axis."""
    away = middles - middles[hair].mean(axis=0)
    sector = ((np.arctan2(away[:, 0], away[:, 2]) / (2 * np.pi) + 0.5) * 2 * _STRIPS).astype(int)
    yield from (hair & (sector == 2 * number) for number in range(_STRIPS))
