"""Partial shapes with their ground truth: for each point the point of the full shape that it comes from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from homolog.core.errors import ShapeError
from homolog.geometry.components import require_usable
from homolog.shapes import FEWEST_POINTS, Shape, mesh_components


@dataclass(frozen=True, eq=False)
class PartialShape:
    """A partial shape and its correspondence to the full shape.

    Args:
        shape: the partial shape, in the pose and units of the full one.
        full_index: for each point the same point of the full shape or, for points sampled on its surface, the corner
            of the triangle with the largest barycentric coordinate; -1 for outliers (n,).
        triangles: for points sampled on the surface, the face of the full shape; -1 for outliers (n,). Else None.
        weights: barycentric coordinates in that face; zero for outliers (n, 3). Else None.
    """

    shape: Shape
    full_index: Int[np.ndarray, " n"]
    triangles: Int[np.ndarray, " n"] | None = None
    weights: Float[np.ndarray, "n 3"] | None = None

    def then(self, further: PartialShape) -> PartialShape:
        """Compose two steps: ``further`` was made from this partial shape; the result refers to the full shape.

        Args:
            further: made of ``self.shape``, with points that are points of it, or outliers.

        Examples:
            >>> noisy_cut = cut(shape, seed=0).then(add_outliers(cut(shape, seed=0).shape, seed=1))  # doctest: +SKIP
        """
        at = further.full_index
        return PartialShape(
            further.shape,
            _looked_up(self.full_index, at, -1),
            None if self.triangles is None else _looked_up(self.triangles, at, -1),
            None if self.weights is None else _looked_up(self.weights, at, 0),
        )


def _looked_up(values: np.ndarray, at: Int[np.ndarray, " n"], fill: int) -> np.ndarray:
    """Gather values by index; ``fill`` for -1."""
    found: np.ndarray = np.concatenate([values, np.full_like(values[:1], fill)])[at]
    return found


def mesh_faces(shape: Shape) -> Int[np.ndarray, "m 3"]:
    """The faces of a clean mesh.

    Raises:
        ArgumentError: if it is no ``Shape``.
        ShapeError: if it has no faces, or needs repair.
    """
    require_usable(shape)
    if shape.faces is None:
        raise ShapeError(f"{shape.name} is a point cloud, but this needs faces; give a mesh")
    return shape.faces


def keep_faces(shape: Shape, kept: Bool[np.ndarray, " m"], *, advice: str) -> PartialShape:
    """The submesh of the kept faces and the points that they use, in their order.

    Raises:
        ShapeError: if fewer than ``FEWEST_POINTS`` points are left; the message ends with ``advice``.
    """
    faces = mesh_faces(shape)[kept]
    used = np.unique(faces)
    if len(used) < FEWEST_POINTS:
        raise ShapeError(
            f"{shape.name}: {len(used)} points are left of it, but a partial shape needs {FEWEST_POINTS}; {advice}"
        )
    return PartialShape(Shape(shape.points[used], np.searchsorted(used, faces), name=shape.name), used)


def largest_component(shape: Shape, kept: Bool[np.ndarray, " m"]) -> Bool[np.ndarray, " m"]:
    """Of the kept faces, those of the connected component with the largest area; faces connect by shared points."""
    left = mesh_faces(shape)[kept]
    component, areas = mesh_components(shape.points, left)
    largest = kept.copy()
    largest[kept] = component[left[:, 0]] == areas.argmax()
    return largest
