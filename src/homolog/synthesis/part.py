"""What every way to make a part gives back: a shape, and where its points lie on the complete one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from homolog.core.errors import ShapeError
from homolog.geometry.components import require_usable
from homolog.shapes import FEWEST_POINTS, Shape, components, face_areas


@dataclass(frozen=True, eq=False)
class Part:
    """A part of a complete shape, with the way back to it.

    Args:
        shape: the part, in the complete shape's own place and units.
        complete_index: for each point of the part the point of the complete shape that it is, or, where points were
            sampled anew, the corner of its triangle with the largest weight; -1 for none, shape (n,).
        triangles: for points that were sampled anew, the face of the complete shape that each lies on, -1 for none,
            shape (n,); else None.
        weights: barycentric weights of each point in its triangle, zero where there is none, shape (n, 3); else None.
    """

    shape: Shape
    complete_index: Int[np.ndarray, " n"]
    triangles: Int[np.ndarray, " n"] | None = None
    weights: Float[np.ndarray, "n 3"] | None = None

    def then(self, further: Part) -> Part:
        """Both steps as one: ``further`` was made of this part's shape, and the result leads to the complete shape.

        For parts whose points are those of their shape, and clouds made of them.
        """
        at = further.complete_index
        return Part(
            further.shape,
            _looked_up(self.complete_index, at, -1),
            None if self.triangles is None else _looked_up(self.triangles, at, -1),
            None if self.weights is None else _looked_up(self.weights, at, 0),
        )


def _looked_up(values: np.ndarray, at: Int[np.ndarray, " n"], fill: int) -> np.ndarray:
    """A value for each index; ``fill`` for -1."""
    found: np.ndarray = np.concatenate([values, np.full_like(values[:1], fill)])[at]
    return found


def mesh_faces(shape: Shape) -> Int[np.ndarray, "m 3"]:
    """The faces of a shape that can be made a part of.

    Raises:
        ArgumentError: if it is no ``Shape``.
        ShapeError: if it has no faces, or needs repair.
    """
    require_usable(shape)
    if shape.faces is None:
        raise ShapeError(f"{shape.name} is a point cloud, but only meshes have parts of this kind; give a mesh")
    return shape.faces


def part_of_faces(shape: Shape, kept: Bool[np.ndarray, " m"], *, advice: str) -> Part:
    """The faces that are kept, with the points that they use, in their order.

    Raises:
        ShapeError: if next to nothing is left; it closes with ``advice``.
    """
    faces = mesh_faces(shape)[kept]
    used = np.unique(faces)
    if len(used) < FEWEST_POINTS:
        raise ShapeError(f"{shape.name}: {len(used)} points are left of it, but a part needs {FEWEST_POINTS}; {advice}")
    return Part(Shape(shape.points[used], np.searchsorted(used, faces), name=shape.name), used)


def largest_piece(shape: Shape, kept: Bool[np.ndarray, " m"]) -> Bool[np.ndarray, " m"]:
    """Of the faces that are kept, those of the piece with the largest area; pieces hang together by points."""
    left = mesh_faces(shape)[kept]
    piece = components(left[:, 0], left[:, 1], shape.n_points, left[:, 2])[left[:, 0]]
    largest = kept.copy()
    largest[kept] = piece == np.bincount(piece, face_areas(shape.points, left), minlength=1).argmax()
    return largest
