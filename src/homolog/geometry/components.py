"""Which points operators are computed of: the main component of a shape, without small ones beside it."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from homolog.core.arguments import check_kind
from homolog.core.errors import ShapeError
from homolog.geometry.tangent import nearest_neighbours
from homolog.shapes import FEWEST_POINTS, Shape, components, mesh_components

# Components with less than this share of the largest one's size are small.
_SMALLEST_COMPONENT = 0.01

# Components of a cloud are this many times farther apart than the median distance to the 30th neighbour: some six
# point spacings. Density varies less over one surface.
_NEIGHBOURS = 30
_GAP = 2.0
# Where more of a cloud seems to be in small components, its density varies so much that gaps mean nothing.
_MOST_IN_SMALL = 1 / 3


def require_usable(shape: Shape, *, fewest: int = FEWEST_POINTS) -> None:
    """Refuse a shape that no operator can be computed of, by checks that cost next to nothing.

    Raises:
        ArgumentError: if it is no ``Shape``.
        ShapeError: if points are too few, NaN or infinite, or there is no face, or one with an index beyond the points.
    """
    check_kind("shape", shape, Shape)
    faces, n_points = shape.faces, shape.n_points
    if n_points < fewest:
        raise ShapeError(f"{shape.name} has {n_points} points, but operators need at least {fewest}")
    if not np.isfinite(shape.points).all():
        count = int((~np.isfinite(shape.points)).any(axis=1).sum())
        raise ShapeError(f"{shape.name} has {count} NaN or infinite points; use homolog.repair first")
    if faces is not None and not len(faces):
        raise ShapeError(f"{shape.name} has no faces; use its points alone, as a cloud")
    if faces is not None and not 0 <= faces.min() <= faces.max() < n_points:
        found = f"faces with point indices from {faces.min()} to {faces.max()}"
        raise ShapeError(f"{shape.name} has {found}, but {n_points} points; use homolog.repair first")


def main_points(shape: Shape, neighbours: Int[np.ndarray, "n j"] | None = None) -> Bool[np.ndarray, " n"]:
    """Main component: which points of a usable shape are not on a component far smaller than the largest. New here.

    A mesh's components are connected by its faces, and their size is their area. Those of a cloud are separated by a
    wide gap, and their size is their number of points; components with fewer points than a neighbourhood are small.

    Args:
        shape: a mesh or a cloud.
        neighbours: of the cloud's points, where they are known already; nearest first (n, j).

    Returns:
        True for each point of the main component (n,).
    """
    if shape.faces is None:
        main = in_large_components(*cloud_components(shape.points, neighbours))
        return main if main.mean() >= 1 - _MOST_IN_SMALL else np.ones(len(main), dtype=bool)
    return in_large_components(*mesh_components(shape.points, shape.faces))


def main_component(shape: Shape, main: Bool[np.ndarray, " n"]) -> Shape:
    """The shape without its small components; the same object if there is none."""
    if main.all():
        return shape
    if shape.faces is None:
        return Shape(shape.points[main], name=shape.name)
    new_index = np.cumsum(main) - 1
    return Shape(shape.points[main], new_index[shape.faces[main[shape.faces[:, 0]]]], name=shape.name)


def cloud_components(
    points: Float[np.ndarray, "n 3"], neighbours: Int[np.ndarray, "n j"] | None = None
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " p"]]:
    """Components of a cloud, which wide gaps separate: a label per point (n,), and the sizes of components (p,).

    Sizes are numbers of points. Those with fewer points than a neighbourhood have neighbours across the gap: their size
    is 0.
    """
    if neighbours is None:
        # Where points that are near lie near in memory, a large cloud takes half as long.
        order, component = KDTree(points).indices, np.empty(len(points), dtype=np.int64)
        ordered = points[order]
        component[order], sizes = cloud_components(ordered, nearest_neighbours(ordered, _NEIGHBOURS))
        return component, sizes
    away = (points[neighbours[:, column]] - points for column in range(neighbours.shape[1]))
    distances = np.stack([np.linalg.norm(each, axis=1) for each in away], axis=1)
    near = distances <= _GAP * np.median(distances[:, -1])
    component = components(np.nonzero(near)[0], neighbours[near], len(points))
    counts = np.bincount(component)
    return component, np.where(counts < min(neighbours.shape[1] + 1, counts.max()), 0, counts)


def in_large_components(component: Int[np.ndarray, " n"], sizes: Float[np.ndarray, " p"]) -> Bool[np.ndarray, " n"]:
    """Which points are on components that are not far smaller than the largest; all, where else too few would be."""
    main: np.ndarray = (sizes >= _SMALLEST_COMPONENT * sizes.max())[component]
    return main if main.sum() >= FEWEST_POINTS else np.ones(len(component), dtype=bool)
