"""What a shape is: points, and faces if it is a mesh."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, Literal, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from homolog.core.errors import ShapeError, bad_value
from homolog.shapes.finding import Finding

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
        notes: what its reader left out of the file or decided; ``check`` reports it.
        space: the anatomical axes that its file names, such as ``"RAS"``; None if it names none.
        allow_broken: whether faces may refer to points that do not exist, as in damaged files. ``repair`` drops them,
            and ``check`` counts them.

    Raises:
        ShapeError: if an array has another number of dimensions or columns, points are no real numbers, or faces no
            whole ones or no indices of the points.

    Examples:
        >>> import homolog
        >>> points = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
        >>> homolog.Shape(points, [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]], name="tetrahedron")
        Shape('tetrahedron': mesh, 4 points, 4 faces)
        >>> homolog.Shape(points).modality
        'cloud'
    """

    points: Float[np.ndarray, "n 3"]
    faces: Int[np.ndarray, "m 3"] | None = None
    name: str = field(default="shape", kw_only=True)
    notes: tuple[Finding, ...] = field(default=(), kw_only=True)
    space: Literal["RAS", "LPS"] | None = field(default=None, kw_only=True)
    allow_broken: bool = field(default=False, kw_only=True)

    def __post_init__(self) -> None:
        if not isinstance(self.name, str):
            raise bad_value("name", self.name, "a text")
        points = _columns(self.points, f"{self.name}: points").astype(np.float64, copy=False)
        object.__setattr__(self, "points", _locked(points))
        if self.faces is not None:
            object.__setattr__(self, "faces", _locked(_whole(self.faces, f"{self.name}: faces")))
            if not self.allow_broken:
                check_indices(self.faces, len(points), self.name)

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


class Owned(NamedTuple):
    """An array that nobody else holds, which a shape may keep instead of a copy."""

    array: np.ndarray


def counts_from_one(faces: Int[np.ndarray, "m 3"], n_points: int) -> bool:
    """Whether indices of points run from 1 to the number of points, as MATLAB and OBJ count."""
    return bool(faces.size and faces.min() == 1 and faces.max() == n_points)


def check_indices(faces: Int[np.ndarray, ...], n_points: int, name: str) -> None:
    """Refuse faces that refer to points that a shape does not have.

    Raises:
        ShapeError: if they do, with its own words where they count from 1.
    """
    if not faces.size or 0 <= (low := int(faces.min())) <= (high := int(faces.max())) < n_points:
        return
    if counts_from_one(faces, n_points):
        raise ShapeError(f"{name}: faces seem to count from 1, as they hold 1 to {n_points} but not 0; give faces - 1")
    raise ShapeError(
        f"{name}: faces hold the index {low if low < 0 else high}, but must hold indices of points from 0 to "
        f"{n_points - 1}; drop such faces, or give allow_broken=True and let repair drop them"
    )


def _whole(values: object, what: str) -> Int[np.ndarray, "m 3"]:
    """Indices; integers that came to be floats on their way pass."""
    array = _columns(values, what)
    if array.dtype.kind == "f":
        indices = (array == np.round(array)) & (np.abs(array) < 2**63)
        if not np.all(indices):
            raise ShapeError(f"{what} hold {array[~indices][0]:g}, but must be whole numbers, indices of points from 0")
    return array.astype(np.int64, copy=False)


def _columns(values: Any, what: str) -> np.ndarray:
    """A copy, checked to be real numbers in three columns; an ``Owned`` array itself."""
    try:
        # A tensor may be part of a computation, or lie on a GPU.
        is_tensor = hasattr(values, "detach") and hasattr(values, "cpu")
        values = values.detach().cpu().numpy() if is_tensor else values
        array = values.array if isinstance(values, Owned) else np.array(values)
        array = array.astype(np.float64) if array.dtype.kind == "O" else array
    except (TypeError, ValueError, OverflowError):
        raise ShapeError(f"{what} must be an array of numbers with shape (n, 3)") from None
    if array.dtype.kind not in "biuf":
        raise ShapeError(f"{what} are of type {array.dtype}, but must be real numbers with shape (n, 3)")
    if array.ndim != 2 or array.shape[1] != 3:
        raise ShapeError(f"{what} have shape {array.shape}, but must have shape (n, 3)")
    return array


def _locked(array: np.ndarray) -> np.ndarray:
    array = np.ascontiguousarray(array)
    array.flags.writeable = False
    return array
