"""What of a shape is worth operators: not the small loose pieces beside it, and nothing that is not a number."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int

from homolog.core.arguments import check_kind
from homolog.core.errors import ShapeError
from homolog.geometry.tangent import nearest_neighbours
from homolog.shapes import FEWEST_POINTS, Shape, components, face_areas

# Pieces with less than this share of the largest one's size are debris.
_SMALLEST_PIECE = 0.01

# A piece of a cloud is this many times farther from the rest than a typical point's neighbours reach: some six
# spacings. Density varies less over one surface.
_NEIGHBOURS = 30
_GAP = 2.0
# Where more of a cloud seems loose, its density varies so much that the gaps mean nothing.
_MOST_DEBRIS = 1 / 3


def require_usable(shape: Shape, *, fewest: int = FEWEST_POINTS) -> None:
    """Refuse what no operator can be computed of, by checks that cost next to nothing.

    Raises:
        ArgumentError: if it is no ``Shape``.
        ShapeError: if points are too few, NaN or infinite, or there is no face, or one beyond the points.
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
    """Which points of a usable shape are not debris, that is, on a piece far smaller than the largest.

    The pieces of a mesh are what its faces connect, and their size is their area. Those of a cloud are what lies beyond
    a wide gap, and their size is their number of points, of which no less than a point's neighbours will do.

    Args:
        shape: a mesh or a cloud.
        neighbours: of the cloud's points, where they are known already; nearest first.
    """
    if shape.faces is None:
        if neighbours is None:
            neighbours = nearest_neighbours(shape.points, _NEIGHBOURS)
        return _main_points_of_cloud(shape.points, neighbours)
    piece = components(shape.faces[:, 0], shape.faces[:, 1], shape.n_points, shape.faces[:, 2])
    areas = np.bincount(piece[shape.faces[:, 0]], face_areas(shape.points, shape.faces), minlength=piece.max() + 1)
    return _of_large_pieces(piece, areas)


def main_part(shape: Shape, main: Bool[np.ndarray, " n"]) -> Shape:
    """The shape without its debris; the very same if there is none."""
    if main.all():
        return shape
    if shape.faces is None:
        return Shape(shape.points[main], name=shape.name)
    place = np.cumsum(main) - 1
    return Shape(shape.points[main], place[shape.faces[main[shape.faces[:, 0]]]], name=shape.name)


def _main_points_of_cloud(
    points: Float[np.ndarray, "n 3"], neighbours: Int[np.ndarray, "n j"]
) -> Bool[np.ndarray, " n"]:
    distances = np.linalg.norm(points[neighbours] - points[:, None], axis=2)
    near = distances <= _GAP * np.median(distances[:, -1])
    count = neighbours.shape[1] + 1
    piece = components(np.nonzero(near)[0], neighbours[near], len(points))
    counts = np.bincount(piece)
    # The neighbours of a smaller piece's points lie across the gap.
    main = _of_large_pieces(piece, np.where(counts < min(count, counts.max()), 0, counts))
    return main if main.mean() >= 1 - _MOST_DEBRIS else np.ones(len(points), dtype=bool)


def _of_large_pieces(piece: Int[np.ndarray, " n"], sizes: Float[np.ndarray, " p"]) -> Bool[np.ndarray, " n"]:
    main: np.ndarray = (sizes >= _SMALLEST_PIECE * sizes.max())[piece]
    return main if main.sum() >= FEWEST_POINTS else np.ones(len(piece), dtype=bool)
