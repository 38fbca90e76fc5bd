"""The surface of a solid that a point cloud covers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import distance_transform_edt, gaussian_filter, label, map_coordinates

from homolog.core.arguments import check_count
from homolog.core.errors import ShapeError
from homolog.shapes import Shape, repair
from homolog.volumes.surface import check_points, level_surface

# Balls grow from so many voxels by this factor until they leave no way in; none is larger than this share of the
# cloud's longest side.
_SMALLEST, _GROWTH, _LARGEST = 1.5, 1.15, 0.15
# So many of the points must have the solid's inside next to them: thin sheets and tips have none.
_COVERED = 0.9
# Around the cloud, in voxels beyond the largest ball.
_MARGIN = 3


@dataclass(frozen=True, eq=False)
class _Grid:
    """Voxels around a cloud.

    Args:
        origin: the centre of voxel (0, 0, 0).
        side: of a voxel.
        places: of the cloud's points, in voxels (n, 3).
        distance: of each voxel's centre to the cloud, in voxels.
    """

    origin: Float[np.ndarray, " 3"]
    side: float
    places: Float[np.ndarray, "n 3"]
    distance: Float[np.ndarray, "i j k"]

    @classmethod
    def around(cls, points: Float[np.ndarray, "n 3"], resolution: int) -> _Grid:
        low, extent = points.min(axis=0), np.ptp(points, axis=0)
        side = float(extent.max()) / resolution
        margin = int(np.ceil(_LARGEST * resolution)) + _MARGIN
        origin = low - margin * side
        places = (points - origin) / side
        taken = np.zeros(np.ceil(extent / side).astype(int) + 1 + 2 * margin, dtype=bool)
        taken[tuple(np.rint(places).astype(int).T)] = True
        return cls(origin, side, places, distance_transform_edt(~taken))

    def at_points(self, field: Float[np.ndarray, "i j k"]) -> Float[np.ndarray, " n"]:
        found: np.ndarray = map_coordinates(field, self.places.T, order=1)
        return found

    def positions(self, places: Float[np.ndarray, "p 3"]) -> Float[np.ndarray, "p 3"]:
        found: np.ndarray = self.origin + self.side * places
        return found


def reconstruct_surface(cloud: Shape, *, points: int | None = 5000, resolution: int = 128) -> Shape:
    """The closed surface of a solid that a cloud covers all around.

    A ball that is just too large to get in anywhere rolls around the cloud: what it cannot reach is inside (a
    morphological closing; H. Edelsbrunner and E. P. Mücke, "Three-dimensional alpha shapes", ACM Transactions on
    Graphics 1994, roll the same ball). The surface is drawn where it passes through the points on average. Needs no
    normals. Gaps narrower than the ball, between fingers say, are filled; the size of the ball follows from the cloud's
    widest hole.

    Args:
        cloud: points all around a solid; faces are not looked at.
        points: about how many points the surface is to have; fewer if it has fewer; None for all.
        resolution: voxels along the cloud's longest side.

    Returns:
        A closed mesh with its faces turned outwards, in the cloud's coordinates.

    Raises:
        ArgumentError: if a number is out of range.
        ShapeError: if the cloud cannot be repaired, or leaves holes that only a ball larger than a seventh of
            it would not fall through.
        MissingExtraError: if scikit-image or fast-simplification is not installed.
    """
    check_points(points)
    check_count("resolution", resolution, least=16)
    grid = _Grid.around(repair(cloud.as_cloud()).shape.points, resolution)
    depth = gaussian_filter(_depth(grid, cloud.name).astype(np.float32), 1.0)
    level = float(np.median(grid.at_points(depth)))
    return level_surface(depth, level, grid.positions, points=points, name=cloud.name)


def _depth(grid: _Grid, name: str) -> Float[np.ndarray, "i j k"]:
    """Distance to what the smallest ball reaches that does not get in."""
    radius, largest = _SMALLEST, _LARGEST * float(np.ptp(grid.places, axis=0).max())
    while radius <= largest:
        free = grid.distance > radius
        reached = _reached(free)
        if (free & ~reached).any():
            depth: np.ndarray = distance_transform_edt(~reached)
            if _covered(grid, depth > radius + 1.0, radius) >= _COVERED:
                return depth
        radius *= _GROWTH
    raise ShapeError(
        f"{name} has holes too wide to tell its inside from its outside; give a cloud of a whole closed surface"
    )


def _reached(free: Bool[np.ndarray, "i j k"]) -> Bool[np.ndarray, "i j k"]:
    """Where a ball's centre gets from the corner of the grid."""
    regions, _ = label(free)
    reached: np.ndarray = regions == regions[0, 0, 0]
    return reached


def _covered(grid: _Grid, inside: Bool[np.ndarray, "i j k"], radius: float) -> float:
    """The share of the points that have some of the inside next to them."""
    if not inside.any():
        return 0.0
    return float((grid.at_points(distance_transform_edt(~inside)) <= radius + 1.0).mean())
