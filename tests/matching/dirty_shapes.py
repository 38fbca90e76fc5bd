"""Damaged copies of clean shapes."""

from dataclasses import dataclass

import numpy as np

from homolog.shapes import Shape


@dataclass(frozen=True)
class Dirty:
    """A damaged copy of a clean shape; per point the clean point it stands for, or -1."""

    shape: Shape
    clean_index: np.ndarray


def dirtied(shape: Shape) -> Dirty:
    """NaN, infinite and, on a mesh, unused points before, amid and after the clean ones; copies of some at the end."""
    middle = 200
    nothing, endless, unused = [np.nan, 0, 0], [0, -np.inf, 0], [90.0, 91, 92]
    extra = [unused] if shape.faces is not None else []
    copied = np.array([3, 250, 3])
    before, after = shape.points[:middle], shape.points[middle:]
    points = np.concatenate([[nothing, *extra], before, [endless], after, extra or [nothing], shape.points[copied]])
    n, front = shape.n_points, 1 + len(extra)
    clean_index = np.concatenate(
        [np.full(front, -1), np.arange(middle), [-1], np.arange(middle, n), [-1], copied],
    )
    if shape.faces is None:
        return Dirty(Shape(points, name="dirty"), clean_index)
    place = np.append(np.arange(middle) + front, np.arange(middle, n) + front + 1)
    faces = place[shape.faces]
    # Some faces use the copy; one uses a point that is gone, one a point twice.
    around = np.flatnonzero((shape.faces == 250).any(axis=1))[:2]
    faces[around] = np.where(shape.faces[around] == 250, len(points) - 2, faces[around])
    faces = np.concatenate([faces, [[0, front, front + 1], [front, front, front + 1]]])
    return Dirty(Shape(points, faces, name="dirty"), clean_index)
