"""Surface reconstruction from point clouds without normals, by a morphological closing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.ndimage import distance_transform_edt, gaussian_filter, label, map_coordinates

from homolog.core.arguments import check_count
from homolog.core.errors import ShapeError
from homolog.shapes import Shape, repair
from homolog.volumes.surface import check_points, isosurface

# The ball's radius grows from _SMALLEST voxels by the factor _GROWTH until it cannot enter the solid any more, at most
# to the share _LARGEST of the cloud's longest side.
_SMALLEST, _GROWTH, _LARGEST = 1.5, 1.15, 0.15
# The least share of the points that must be adjacent to the solid's interior: thin sheets and tips are not.
_ADJACENT = 0.9
# Margin around the cloud, in voxels beyond the largest ball.
_MARGIN = 3


@dataclass(frozen=True, eq=False)
class _Grid:
    """A voxel grid around a cloud.

    Args:
        origin: the centre of voxel (0, 0, 0).
        side: of a voxel.
        voxels: voxel coordinates of the cloud's points (n, 3).
        distance: of each voxel's centre to the cloud, in voxels (Euclidean distance transform).
    """

    origin: Float[np.ndarray, " 3"]
    side: float
    voxels: Float[np.ndarray, "n 3"]
    distance: Float[np.ndarray, "i j k"]

    @classmethod
    def around(cls, points: Float[np.ndarray, "n 3"], resolution: int) -> _Grid:
        low, extent = points.min(axis=0), np.ptp(points, axis=0)
        side = float(extent.max()) / resolution
        margin = int(np.ceil(_LARGEST * resolution)) + _MARGIN
        origin = low - margin * side
        voxels = (points - origin) / side
        occupied = np.zeros(np.ceil(extent / side).astype(int) + 1 + 2 * margin, dtype=bool)
        occupied[tuple(np.rint(voxels).astype(int).T)] = True
        return cls(origin, side, voxels, distance_transform_edt(~occupied))

    def at_points(self, field: Float[np.ndarray, "i j k"]) -> Float[np.ndarray, " n"]:
        """Interpolate a field at the cloud's points, trilinearly."""
        found: np.ndarray = map_coordinates(field, self.voxels.T, order=1)
        return found

    def positions(self, voxels: Float[np.ndarray, "p 3"]) -> Float[np.ndarray, "p 3"]:
        """Convert voxel coordinates to positions."""
        found: np.ndarray = self.origin + self.side * voxels
        return found


def reconstruct_surface(cloud: Shape, *, points: int | None = 5000, resolution: int = 128) -> Shape:
    """Reconstruct the closed surface of a solid from a point cloud on all of its surface, without normals.

    A ball rolls around the cloud; what it cannot reach is the interior (a morphological closing, as in alpha shapes:
    H. Edelsbrunner and E. P. Mücke, "Three-dimensional alpha shapes", ACM Transactions on Graphics 13, 1994). Its
    radius is the smallest that does not enter through the widest gap between points, so that narrower concavities, such
    as the gaps between fingers, are filled. The isosurface passes through the points on average. The choice of radius
    and isovalue is new here.

    Args:
        cloud: points on all of the solid's surface; faces are ignored.
        points: approximate number of points after simplification; None for no simplification.
        resolution: number of voxels along the cloud's longest side.

    Returns:
        A closed mesh, oriented outwards, in the cloud's coordinates.

    Raises:
        ArgumentError: if a number is out of range.
        ShapeError: if the cloud cannot be repaired, or has gaps wider than about a seventh of its longest side.
        MissingExtraError: if scikit-image or fast-simplification is not installed.

    Examples:
        >>> directions = np.random.default_rng(0).normal(size=(2000, 3))
        >>> ball = Shape(directions / np.linalg.norm(directions, axis=1, keepdims=True))
        >>> surface = reconstruct_surface(ball, points=300, resolution=32)
        >>> bool(abs(np.linalg.norm(surface.points, axis=1).mean() - 1) < 0.05)
        True
    """
    check_points(points)
    check_count("resolution", resolution, least=16)
    grid = _Grid.around(repair(cloud.as_cloud()).shape.points, resolution)
    depth = gaussian_filter(_depth(grid, cloud.name).astype(np.float32), 1.0)
    isovalue = float(np.median(grid.at_points(depth)))
    return isosurface(depth, isovalue, grid.positions, points=points, name=cloud.name)


def _depth(grid: _Grid, name: str) -> Float[np.ndarray, "i j k"]:
    """Distance to the region that the smallest ball reaches which cannot enter the solid."""
    radius, largest = _SMALLEST, _LARGEST * float(np.ptp(grid.voxels, axis=0).max())
    while radius <= largest:
        free = grid.distance > radius
        regions, _ = label(free)
        reached = regions == regions[0, 0, 0]  # from the corner of the grid
        if (free & ~reached).any():
            depth: np.ndarray = distance_transform_edt(~reached)
            inside = depth > radius + 1.0
            # The share of the points with some of the interior next to them.
            if inside.any() and ((grid.at_points(distance_transform_edt(~inside)) <= radius + 1.0).mean() >= _ADJACENT):
                return depth
        radius *= _GROWTH
    raise ShapeError(
        f"{name} has gaps too wide to tell its inside from its outside; give a cloud of all of a closed surface"
    )
