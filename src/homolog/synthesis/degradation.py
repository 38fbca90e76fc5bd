"""What scanners do to clouds beside noise: points that lie nowhere near, and a density that varies."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike
from scipy.spatial import KDTree

from homolog.core.errors import ShapeError
from homolog.geometry import surface_area
from homolog.geometry.components import require_usable
from homolog.shapes import FEWEST_POINTS, Shape
from homolog.synthesis.drawing import Range, check_number, check_range, drawn, drawn_direction, given_direction
from homolog.synthesis.part import Part


def add_outliers(shape: Shape, *, share: Range = 0.02, distance: float = 0.1, seed: int) -> Part:
    """Add points that lie far from all points of a shape, at its end; their index back is -1.

    They are evenly spread over the box around the shape, enlarged by twice the distance, without what is too near.

    Args:
        shape: a clean mesh, of which only the points are taken, or a cloud; not changed.
        share: how many points are added for each point of the shape, or the range from which this is drawn.
        distance: how far at least they lie from every point, in units of the square root of the surface area.
        seed: of all that is drawn.

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
    count = round(drawn(share, random) * shape.n_points)
    far = _far_points(shape.points, count, distance * float(np.sqrt(surface_area(shape))), random)
    index = np.concatenate([np.arange(shape.n_points), np.full(count, -1)])
    return Part(Shape(np.concatenate([shape.points, far]), name=shape.name), index)


def subsample(shape: Shape, *, least: Range = (0.1, 0.5), direction: ArrayLike | None = None, seed: int) -> Part:
    """Keep each point of a shape at random, with a probability that falls smoothly from one end of it to the other.

    See ``share_kept``.

    Args:
        shape: a clean mesh, of which only the points are taken, or a cloud; not changed.
        least: the probability at the sparse end, or the range from which it is drawn.
        direction: from the sparse end to the dense one, of any length; drawn by default.
        seed: of all that is drawn.

    Returns:
        A cloud; its points keep their order.

    Raises:
        ArgumentError: if ``least`` is not from 0 to 1, or ``direction`` no direction.
        ShapeError: if the shape needs repair, or next to nothing is left.
    """
    check_range("least", least, lambda share: 0 <= share <= 1, "a number from 0 to 1")
    require_usable(shape)
    random = np.random.default_rng(seed)
    towards = drawn_direction(random) if direction is None else given_direction("direction", direction)
    share = share_kept(shape.points, towards, drawn(least, random))
    (kept,) = np.nonzero(random.random(shape.n_points) < share)
    if len(kept) < FEWEST_POINTS:
        raise ShapeError(
            f"{shape.name}: {len(kept)} points are left of it, but a cloud needs {FEWEST_POINTS}; thin it less"
        )
    return Part(Shape(shape.points[kept], name=shape.name), kept)


def share_kept(
    points: Float[np.ndarray, "n 3"], direction: Float[np.ndarray, " 3"], least: float
) -> Float[np.ndarray, " n"]:
    """The probability of each point to be kept: half a period of a cosine, from ``least`` to 1 along a direction."""
    heights = points @ direction
    place = (heights - heights.min()) / max(np.ptp(heights), np.finfo(float).tiny)
    share: np.ndarray = least + (1 - least) * (1 - np.cos(np.pi * place)) / 2
    return share


def _far_points(
    points: Float[np.ndarray, "n 3"], count: int, distance: float, random: np.random.Generator
) -> Float[np.ndarray, "count 3"]:
    """So many points of the box around the points, enlarged, that are at least ``distance`` from all of them."""
    tree = KDTree(points)
    low, high = points.min(axis=0) - 2 * distance, points.max(axis=0) + 2 * distance
    far = np.empty((0, 3))
    while len(far) < count:
        tried = random.uniform(low, high, size=(2 * count, 3))
        far = np.concatenate([far, tried[tree.query(tried)[0] >= distance]])
    return far[:count]
