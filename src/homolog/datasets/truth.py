"""Ground truth of every kind, brought to one form: which point of a source shape a point of a target truly is."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal
from zipfile import BadZipFile

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from homolog.core.errors import DataError
from homolog.core.files import expanded
from homolog.datasets.description import DatasetDescription
from homolog.shapes import Shape

# How far the sum of a point's three weights may be from one, and each weight below zero.
_TOLERANCE = 1e-2
_CLOUD_MAP = "cloud_to_complete"


@dataclass(frozen=True, eq=False)
class Truth:
    """What is known of a pair: the points of the target that are asked for, and where each truly is on the source.

    Args:
        target: points of the target (q,).
        source: for each of them the point of the source (q,); of a place within a triangle, the nearest corner.
    """

    target: Int[np.ndarray, " q"]
    source: Int[np.ndarray, " q"]


@dataclass(frozen=True, eq=False)
class Counterparts:
    """Of which points of a complete shape it is known whether a part has them.

    Args:
        points: of the complete shape (k,).
        present: whether the part has them (k,).
    """

    points: Int[np.ndarray, " k"]
    present: Bool[np.ndarray, " k"]


@dataclass(frozen=True, eq=False)
class _Places:
    """Where each point of a part lies on its complete shape: in a triangle, with three weights."""

    triangles: Int[np.ndarray, " n"]
    weights: Float[np.ndarray, "n 3"]


class GroundTruth:
    """The ground truth of a set's pairs, each file of it read once.

    Args:
        root: the set's folder.
        description: what kind of truth lies where.
        shape_of: gives a shape by its name, as it is matched.
        order_of: by a shape's name and number of points, which row of its file each point is.
    """

    def __init__(
        self,
        root: Path,
        description: DatasetDescription,
        shape_of: Callable[[str], Shape],
        order_of: Callable[[str, int], Int[np.ndarray, " n"]],
    ) -> None:
        self._root, self._description = root, description
        self._shape_of, self._order_of = shape_of, order_of
        self._common: dict[str, Int[np.ndarray, " p"]] = {}
        self._placed: dict[str, _Places] = {}

    def between(self, source: str, target: str) -> Truth:
        """What is known of a pair.

        Raises:
            DataError: if a file is missing or malformed, does not fit its shape, or the set has no ground truth.
        """
        ways: dict[str, Callable[[str, str], Truth]] = {
            "common-points": self._by_common_points,
            "barycentric": self._by_places,
            "same-numbering": self._by_numbering,
            "pair-maps": self._by_map,
        }
        kind = self._description.truth
        if kind not in ways:
            raise DataError(f"{self._root}: this set has no ground truth, so that nothing can be scored; use another")
        return ways[kind](source, target)

    def of_cloud(self, source: str, target: str, cloud: Shape) -> Truth:
        """What is known of a pair whose target is used as a cloud with points of its own.

        Raises:
            DataError: if the file of its truth is missing or malformed, or does not fit the shapes.
        """
        path = self._file(target, self._description.cloud_truth)
        found = _read_cloud_map(path)
        if len(found) != cloud.n_points:
            raise DataError(f"{path}: {len(found)} numbers, but the cloud of {target} has {cloud.n_points} points")
        if found.max() >= self._shape_of(source).n_points:
            raise DataError(f"{path} names point {found.max()}, but {source} has {self._shape_of(source).n_points}")
        there = np.flatnonzero(found >= 0)
        return Truth(there, found[there])

    def counterparts(self, source: str, target: str) -> Counterparts | None:
        """Which points of a complete shape a part has, or None where the truth does not tell.

        Of places in triangles, a point of the complete shape has a counterpart if that of some point of the part
        lies within a mean edge of it.

        Raises:
            DataError: as with ``between``.
        """
        if self._description.truth == "common-points":
            ours, theirs = self._both_common_points(source, target)
            return Counterparts(ours[ours >= 0], theirs[ours >= 0] >= 0)
        if self._description.truth == "barycentric":
            complete = self._shape_of(source)
            near = _near(complete, _positions(complete, self._places(source, target)))
            return Counterparts(np.arange(complete.n_points), near)
        return None

    # ---- common points

    def _by_common_points(self, source: str, target: str) -> Truth:
        return _shared(*self._both_common_points(source, target))

    def _both_common_points(self, source: str, target: str) -> tuple[Int[np.ndarray, " p"], Int[np.ndarray, " p"]]:
        ours, theirs = self._common_points(source), self._common_points(target)
        if len(ours) != len(theirs):
            raise DataError(
                f"{source} has {len(ours)} common points and {target} {len(theirs)}; "
                "every .vts file of a set must have the same number of lines"
            )
        return ours, theirs

    def _common_points(self, name: str) -> Int[np.ndarray, " p"]:
        if name not in self._common:
            path = self._file(name)
            points = read_vertices(path)
            _check_vertices(path, points, self._shape_of(name), "leave that line out of every .vts file")
            self._common[name] = points
        return self._common[name]

    # ---- the same numbering

    def _by_numbering(self, source: str, target: str) -> Truth:
        ours, theirs = self._place_of_rows(source), self._place_of_rows(target)
        if len(ours) != len(theirs):
            raise DataError(
                f"{source} has {len(ours)} points and {target} {len(theirs)}; "
                "row i must be the same point in every file of this set"
            )
        return Truth(theirs, ours)

    def _place_of_rows(self, name: str) -> Int[np.ndarray, " n"]:
        """Which point each row of a file has become."""
        shape = self._shape_of(name)
        if not np.isfinite(shape.points).all():
            raise DataError(f"{shape.name} has points that are NaN or infinite; leave that row out of every file")
        return np.argsort(self._order_of(name, shape.n_points))

    # ---- a map for each pair

    def _by_map(self, source: str, target: str) -> Truth:
        path, shape = self._file(f"{source}_{target}"), self._shape_of(source)
        found = read_vertices(path)
        if len(found) != shape.n_points:
            raise DataError(f"{path} has {len(found)} lines, but {source} has {shape.n_points} points; get it again")
        _check_vertices(path, found, self._shape_of(target), "write -1 there")
        there = np.flatnonzero(found >= 0)
        return Truth(found[there], there)

    # ---- places in triangles

    def _by_places(self, source: str, target: str) -> Truth:
        places = self._places(source, target)
        corners = _corners(self._shape_of(source), places)
        nearest = np.take_along_axis(corners, places.weights.argmax(axis=1)[:, None], axis=1)[:, 0]
        return Truth(np.arange(len(nearest)), nearest)

    def _places(self, source: str, target: str) -> _Places:
        if target not in self._placed:
            self._placed[target] = self._checked_places(self._shape_of(source), target)
        return self._placed[target]

    def _checked_places(self, complete: Shape, target: str) -> _Places:
        path, n_points = self._file(target), self._shape_of(target).n_points
        places = _read_places(path)
        if len(places.triangles) != n_points:
            raise DataError(f"{path} has {len(places.triangles)} lines, but {target} has {n_points} points")
        if places.triangles.max() >= complete.n_faces:
            raise DataError(
                f"{path} names triangle {places.triangles.max() + 1}, but {complete.name} has {complete.n_faces}"
            )
        return places

    def _file(self, name: str, pattern: str = "") -> Path:
        return self._root / (pattern or self._description.truth_files).replace("*", name)


def read_vertices(path: Path) -> Int[np.ndarray, " p"]:
    """Vertices counted from 1 in a file, one a line, as indices from 0; -1 stays, for none.

    Raises:
        DataError: if the file does not hold positive whole numbers, one a line.
    """
    rows = _read_numbers(path, np.int64, "a vertex number a line")
    if rows.ndim != 1 or rows.size == 0 or np.any((rows < 1) & (rows != -1)):
        raise DataError(f"{path} must hold a vertex number a line, counted from 1, or -1 for none")
    return np.where(rows < 0, -1, rows - 1)


def read_truth(files: tuple[Path, Path], shapes: tuple[Shape, Shape]) -> Truth:
    """What two files of common points, as a set has them in ``corres/``, say of a source and a target.

    Args:
        files: of the source and of the target; line i is the vertex of the i-th common point, from 1, or -1.
        shapes: the two.

    Raises:
        DataError: if a file is missing or malformed, does not fit its shape, or they differ in length.
    """
    found = []
    for file, shape in zip(map(expanded, files), shapes, strict=True):
        points = read_vertices(file)
        _check_vertices(file, points, shape, "leave that line out of both files")
        found.append(points)
    if len(found[0]) != len(found[1]):
        raise DataError(
            f"{files[0]} has {len(found[0])} lines and {files[1]} {len(found[1])}; "
            "line i must be the same point in both"
        )
    truth = _shared(*found)
    if not len(truth.source):
        raise DataError(f"{files[0]} and {files[1]} have no point in common; give the files of these two shapes")
    return truth


def _shared(source: Int[np.ndarray, " p"], target: Int[np.ndarray, " p"]) -> Truth:
    """The common points that both shapes have."""
    both = (source >= 0) & (target >= 0)
    return Truth(target[both], source[both])


def _read_cloud_map(path: Path) -> Int[np.ndarray, " n"]:
    try:
        with np.load(path, allow_pickle=False) as arrays:
            found: np.ndarray = arrays[_CLOUD_MAP]
    except KeyError:
        raise DataError(f"{path} has no {_CLOUD_MAP}: its set was made of shapes without common points") from None
    except (OSError, ValueError, BadZipFile) as error:
        raise DataError(f"{path} must hold {_CLOUD_MAP} ({error})") from None
    if found.ndim != 1 or found.dtype.kind != "i" or found.size == 0 or found.min() < -1:
        raise DataError(f"{path}: {_CLOUD_MAP} must hold a point's number for each point of the cloud, or -1")
    return found


def _read_places(path: Path) -> _Places:
    what = "a triangle and three weights a line"
    rows = _read_numbers(path, np.float64, what, dimensions=2)
    if rows.shape[1] != 4 or not np.isfinite(rows).all():
        raise DataError(f"{path} must hold {what}")
    triangles, weights = rows[:, 0].astype(np.int64), rows[:, 1:]
    if np.any(triangles != rows[:, 0]) or triangles.min() < 1:
        raise DataError(f"{path} must hold {what}, the triangles counted from 1")
    if weights.min() < -_TOLERANCE or np.abs(weights.sum(axis=1) - 1).max() > _TOLERANCE:
        raise DataError(f"{path} must hold {what}, the weights not negative and of sum one")
    return _Places(triangles - 1, weights)


def _read_numbers(path: Path, kind: type[Any], what: str, *, dimensions: Literal[1, 2] = 1) -> np.ndarray:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # an empty file, or a number with a fraction
            rows: np.ndarray = np.loadtxt(path, dtype=kind, ndmin=dimensions)
            return rows
    except (OSError, ValueError, OverflowError, Warning) as error:
        raise DataError(f"{path} must hold {what} ({error})") from None


def _check_vertices(path: Path, vertices: Int[np.ndarray, " p"], shape: Shape, way_out: str) -> None:
    if vertices.max() >= shape.n_points:
        raise DataError(f"{path} names vertex {vertices.max() + 1}, but the shape has {shape.n_points}")
    there = vertices[vertices >= 0]
    nowhere = there[~np.isfinite(shape.points[there]).all(axis=1)]
    if len(nowhere):
        raise DataError(
            f"{path} names vertex {nowhere[0] + 1}, which is NaN or infinite; correct the shape, or {way_out}"
        )


def _corners(complete: Shape, places: _Places) -> Int[np.ndarray, "n 3"]:
    assert complete.faces is not None  # there are none only where every triangle is beyond them
    corners: np.ndarray = complete.faces[places.triangles]
    return corners


def _positions(complete: Shape, places: _Places) -> Float[np.ndarray, "n 3"]:
    found: np.ndarray = np.einsum("ij,ijk->ik", places.weights, complete.points[_corners(complete, places)])
    return found


def _near(complete: Shape, positions: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " m"]:
    """Which points have one of these positions within a mean edge."""
    assert complete.faces is not None
    corners = complete.points[complete.faces]
    edge = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).mean()
    distances, _ = KDTree(positions).query(complete.points)
    near: np.ndarray = distances <= edge
    return near
