"""What a shape is: points, and faces if it is a mesh."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from jaxtyping import Float, Int

from homolog.core.errors import ShapeError

Modality = Literal["mesh", "cloud"]
"""With faces, or without."""

FEWEST_POINTS = 4
"""A shape needs as many different points."""


@dataclass(frozen=True, eq=False)
class Shape:
    """A triangle mesh or a raw point cloud.

    Args:
        points: positions, shape (n, 3), in the file's own units. Copied and made read-only.
        faces: triangles as 0-based point indices, shape (m, 3), or None for a point cloud. Copied and made
            read-only.
        name: how messages call the shape, usually its file name.

    Raises:
        ShapeError: if an array has another number of dimensions or columns, points are no real numbers, or faces no
            whole ones.
    """

    points: Float[np.ndarray, "n 3"]
    faces: Int[np.ndarray, "m 3"] | None = None
    name: str = field(default="shape", kw_only=True)

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", _locked(_real(self.points, f"{self.name}: points")))
        if self.faces is not None:
            object.__setattr__(self, "faces", _locked(_whole(self.faces, f"{self.name}: faces")))

    @property
    def modality(self) -> Modality:
        """``"mesh"`` if the shape has faces, else ``"cloud"``."""
        return "cloud" if self.faces is None else "mesh"

    @property
    def n_points(self) -> int:
        """Number of points."""
        return len(self.points)

    @property
    def n_faces(self) -> int:
        """Number of faces; 0 for a point cloud."""
        return 0 if self.faces is None else len(self.faces)

    def as_cloud(self) -> Shape:
        """The same points without faces."""
        return replace(self, faces=None)

    def __repr__(self) -> str:
        faces = "" if self.faces is None else f", {self.n_faces} faces"
        return f"Shape({self.name!r}: {self.modality}, {self.n_points} points{faces})"


def _real(values: object, what: str) -> Float[np.ndarray, "n 3"]:
    return _columns(values, what).astype(np.float64, copy=False)


def _whole(values: object, what: str) -> Int[np.ndarray, "m 3"]:
    """Indices; integers that came to be floats on their way pass."""
    array = _columns(values, what)
    if array.dtype.kind == "f":
        indices = (array == np.round(array)) & (np.abs(array) < 2**63)
        if not np.all(indices):
            raise ShapeError(f"{what} hold {array[~indices][0]:g}, but must be whole numbers, indices of points from 0")
    return array.astype(np.int64, copy=False)


def _columns(values: object, what: str) -> np.ndarray:
    """A copy, checked to be real numbers in three columns."""
    try:
        array = np.array(_detached(values))
        array = array.astype(np.float64) if array.dtype.kind == "O" else array
    except (TypeError, ValueError, OverflowError):
        raise ShapeError(f"{what} must be an array of numbers with shape (n, 3)") from None
    if array.dtype.kind not in "biuf":
        raise ShapeError(f"{what} are of type {array.dtype}, but must be real numbers with shape (n, 3)")
    if array.ndim != 2 or array.shape[1] != 3:
        raise ShapeError(f"{what} have shape {array.shape}, but must have shape (n, 3)")
    return array


def _detached(values: object) -> object:
    """A tensor that is part of a computation, or lies on a GPU, as one that numpy can read."""
    return values.detach().cpu().numpy() if hasattr(values, "detach") and hasattr(values, "cpu") else values


def _locked(array: np.ndarray) -> np.ndarray:
    array = np.ascontiguousarray(array)
    array.flags.writeable = False
    return array
