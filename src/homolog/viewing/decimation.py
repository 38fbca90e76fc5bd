"""Fewer points of a large shape, for a page: each is a point of the file, so that a click can name it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from homolog.shapes.equal_rows import first_of_equal_rows
from homolog.viewing.scene import typical_spacing

# Cells grow by at least so much; and by this power of how many times too many points there are, between that of
# surfaces (1/2) and that of clouds that fill a volume (1/3), so that a few steps are enough and none goes far too far.
_LEAST_GROWTH, _POWER = 1.03, 0.4
# Along an axis, so that the number of a cell fits into 64 bits whatever lies far off.
_MOST_CELLS = 2_000_000
# For shapes all of whose points are equal.
_LEAST_WIDTH = 1e-300


@dataclass(frozen=True, eq=False)
class Decimated:
    """Some points of a shape.

    Args:
        index: of each in the shape, ascending (k,).
        faces: triangles between them, or None for a cloud.
    """

    index: Int[np.ndarray, " k"]
    faces: Int[np.ndarray, "m 3"] | None


def decimate(
    points: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"] | None, most_points: int, most_faces: int
) -> Decimated:
    """Reduce a shape by vertex clustering (Rossignac and Borrel, 1993): one of its own points stays in each cubic cell.

    Of the points in a cell the one nearest to their mean stays. Triangles between three cells stay, once each. Parts
    that are nearer to each other than a cell grow together. A shape that is small enough is left as it is.

    Args:
        points: in any unit.
        faces: triangles, or None for a cloud.
        most_points: at least 1.
        most_faces: at least 1.
    """
    if len(points) <= most_points and (faces is None or len(faces) <= most_faces):
        return Decimated(np.arange(len(points)), faces)
    relative = points - points.min(axis=0)
    width = max(typical_spacing(points), float(relative.max()) / _MOST_CELLS, _LEAST_WIDTH)
    while True:
        index, cell = _clusters(relative, width)
        kept = None if faces is None else _faces_between(cell[faces])
        excess = max(len(index) / most_points, 0 if kept is None else len(kept) / most_faces)
        if excess <= 1:
            return Decimated(index, kept)
        width *= max(_LEAST_GROWTH, excess**_POWER)


def _clusters(points: Float[np.ndarray, "n 3"], width: float) -> tuple[Int[np.ndarray, " k"], Int[np.ndarray, " n"]]:
    """The point that stays of each occupied cell, and for each point the place of its cell's among them."""
    grid = (points / width).astype(np.int64)
    x, y, z = grid.T
    _, cell = np.unique((x * (y.max() + 1) + y) * (z.max() + 1) + z, return_inverse=True)
    count = np.bincount(cell)
    mean = np.stack([np.bincount(cell, axis) / count for axis in points.T], axis=1)
    distance = np.linalg.norm(points - mean[cell], axis=1)
    nearest = np.lexsort((distance, cell))[np.cumsum(count) - count]
    index = np.sort(nearest)
    return index, np.argsort(np.argsort(nearest))[cell]


def _faces_between(faces: Int[np.ndarray, "m 3"]) -> Int[np.ndarray, "k 3"]:
    """Triangles with three different corners, the first of those with the same ones."""
    a, b, c = faces.T
    faces = faces[(a != b) & (b != c) & (c != a)]
    first = first_of_equal_rows(np.sort(faces, axis=1))
    kept: np.ndarray = faces[first == np.arange(len(first))]
    return kept
