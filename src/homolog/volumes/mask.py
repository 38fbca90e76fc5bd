"""What a segmentation mask is."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from homolog.core.errors import ShapeError


@dataclass(frozen=True, eq=False)
class Mask:
    """Which voxels of a volume belong to an object, and where they are.

    Args:
        inside: per voxel (i, j, k).
        origin: where the centre of voxel (0, 0, 0) is, in millimetres.
        axes: in its columns the steps from a voxel to the next along i, j and k, in millimetres.
        name: of the file, for messages.

    Raises:
        ShapeError: if no voxel is inside, or the steps do not span space.
    """

    inside: Bool[np.ndarray, "i j k"]
    origin: Float[np.ndarray, " 3"]
    axes: Float[np.ndarray, "3 3"]
    name: str = "mask"

    def __post_init__(self) -> None:
        if self.inside.ndim != 3 or not self.inside.any():
            raise ShapeError(f"{self.name} marks no voxel of a volume; give another mask, or another label")
        volume = np.linalg.det(self.axes)
        if not np.isfinite(volume) or volume == 0:
            raise ShapeError(f"{self.name} has voxels without a volume (axes {self.axes.tolist()}); correct its header")

    def cropped(self, margin: int) -> Mask:
        """The box around what is inside, and so many voxels more on each side, which may lie beyond the volume."""
        spans = [np.flatnonzero(self.inside.any(axis=others))[[0, -1]] for others in ((1, 2), (0, 2), (0, 1))]
        box = self.inside[tuple(slice(first, last + 1) for first, last in spans)]
        corner = np.array([first - margin for first, _ in spans])
        return replace(self, inside=np.pad(box, margin), origin=self.positions(corner[None])[0])

    def positions(self, places: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Positions of places given in voxels, in millimetres."""
        found: np.ndarray = self.origin + places @ self.axes.T
        return found
