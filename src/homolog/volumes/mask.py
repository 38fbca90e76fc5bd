"""Segmentation masks."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from homolog.core.errors import ShapeError
from homolog.core.messages import shown

# In millimetres; no mask lies beyond it.
_FARTHEST = 1e100


@dataclass(frozen=True, eq=False)
class Mask:
    """A binary segmentation mask: the voxels of an object, and their position in space.

    Args:
        inside: whether each voxel belongs to the object (i, j, k).
        origin: position of the centre of voxel (0, 0, 0), in millimetres.
        axes: in its columns the steps between neighbouring voxels along i, j and k, in millimetres.
        name: of the file, for messages.

    Raises:
        ShapeError: if no voxel is inside, or the steps are not linearly independent.

    Examples:
        >>> mask = Mask(np.ones((2, 2, 2), dtype=bool), np.zeros(3), np.diag([1.0, 1.0, 2.0]))
        >>> mask.positions(np.array([[1.0, 0.0, 1.0]])).tolist()
        [[1.0, 0.0, 2.0]]
    """

    inside: Bool[np.ndarray, "i j k"]
    origin: Float[np.ndarray, " 3"]
    axes: Float[np.ndarray, "3 3"]
    name: str = "mask"

    def __post_init__(self) -> None:
        if self.inside.ndim != 3 or not self.inside.any():
            raise ShapeError(f"{self.name} marks no voxel of a volume; give another mask, or another label")
        with np.errstate(all="ignore"):
            volume = np.linalg.det(self.axes)
            farthest = np.max(np.abs(self.origin) + np.abs(self.axes) @ self.inside.shape)
        if not 0 < abs(volume) < np.inf or not farthest < _FARTHEST:
            found = f"voxels without a volume, or too far away (axes {shown(self.axes.tolist())})"
            raise ShapeError(f"{self.name} has {found}; correct its header")

    def cropped(self, margin: int) -> Mask:
        """Crop to the bounding box of the object with a margin in voxels, which may extend beyond the volume."""
        spans = [np.flatnonzero(self.inside.any(axis=others))[[0, -1]] for others in ((1, 2), (0, 2), (0, 1))]
        box = self.inside[tuple(slice(first, last + 1) for first, last in spans)]
        corner = np.array([first - margin for first, _ in spans])
        return replace(self, inside=np.pad(box, margin), origin=self.positions(corner[None])[0])

    def positions(self, voxels: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Convert voxel coordinates to positions in millimetres."""
        found: np.ndarray = self.origin + voxels @ self.axes.T
        return found
