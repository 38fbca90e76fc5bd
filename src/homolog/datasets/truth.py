"""Ground truth of all kinds in one form: for points of the target the corresponding point of the source."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from homolog.core.array_files import open_npz
from homolog.core.errors import DataError
from homolog.core.files import expanded, opened
from homolog.core.reasons import reason_of
from homolog.datasets.description import DatasetDescription
from homolog.shapes import Shape

# How far the sum of three barycentric coordinates may be from one, and each of them below zero.
_TOLERANCE = 1e-2
_CLOUD_MAP = "cloud_to_full"


@dataclass(frozen=True, eq=False)
class Truth:
    """The ground truth of a pair: points of the target, and the corresponding point of the source for each.

    Args:
        target: points of the target (q,).
        source: for each of them the point of the source (q,); within a triangle, the corner with the largest weight.
    """

    target: Int[np.ndarray, " q"]
    source: Int[np.ndarray, " q"]

    def without(self, entries: Int[np.ndarray, " k"]) -> Truth:
        """The same but for some of its entries, which are counted from 0 (k,)."""
        return Truth(target=np.delete(self.target, entries), source=np.delete(self.source, entries))


@dataclass(frozen=True, eq=False)
class Counterparts:
    """For points of a full shape, whether they have a counterpart on a partial one.

    Args:
        points: of the full shape for which this is known (k,).
        present: whether they have a counterpart (k,).
    """

    points: Int[np.ndarray, " k"]
    present: Bool[np.ndarray, " k"]


@dataclass(frozen=True, eq=False)
class _Barycentric:
    """The points of a partial shape in barycentric coordinates of the full one: triangles and weights."""

    triangles: Int[np.ndarray, " n"]
    weights: Float[np.ndarray, "n 3"]


class GroundTruth:
    """The ground truth of a dataset's pairs; each of its files is read once.

    Args:
        root: the dataset's folder.
        description: of the kind and files of the truth.
        shape_of: gives a shape by its name, as it is matched.
        order_of: gives for each point of a shape its row in the file, by the shape's name and number of points.
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
        self._vertices: dict[str, Int[np.ndarray, " p"]] = {}
        self._barycentric: dict[str, _Barycentric] = {}

    def between(self, source: str, target: str) -> Truth:
        """The ground truth of a pair.

        Raises:
            DataError: if a file is missing or malformed, does not fit its shape, or the dataset has no ground truth.
        """
        ways: dict[str, Callable[[str, str], Truth]] = {
            "template-correspondence": lambda *names: _shared(*self._both_vertices(*names)),
            "barycentric": self._by_triangles,
            "same-numbering": self._by_numbering,
            "pair-maps": self._by_map,
        }
        kind = self._description.truth
        if kind not in ways:
            raise DataError(
                f"{self._root}: this dataset has no ground truth, so that nothing can be scored; use another"
            )
        return ways[kind](source, target)

    def of_cloud(self, source: str, target: str, cloud: Shape) -> Truth:
        """The ground truth of a pair whose target is a cloud with its own points.

        Raises:
            DataError: if the file of its truth is missing or malformed, or does not fit the shapes.
        """
        path = self._file(target, self._description.cloud_truth)
        found = _read_cloud_map(path)
        if len(found) != cloud.n_points:
            raise DataError(f"{path}: {len(found)} numbers, but the cloud of {target} has {cloud.n_points} points")
        if found.max() >= self._shape_of(source).n_points:
            raise DataError(f"{path} names point {found.max()}, but {source} has {self._shape_of(source).n_points}")
        known = np.flatnonzero(found >= 0)
        return Truth(known, found[known])

    def counterparts(self, source: str, target: str) -> Counterparts | None:
        """Which points of a full shape have a counterpart on a partial one; None if the truth does not tell.

        With barycentric truth, a point of the full shape has a counterpart if some point of the partial shape lies
        within one mean edge length of it. New here.

        Raises:
            DataError: as with ``between``.
        """
        if self._description.truth == "template-correspondence":
            ours, theirs = self._both_vertices(source, target)
            return Counterparts(ours[ours >= 0], theirs[ours >= 0] >= 0)
        if self._description.truth == "barycentric":
            full, points = self._shape_of(source), self._triangles(source, target)
            positions = np.einsum("ij,ijk->ik", points.weights, full.points[_corners(full, points)])
            return Counterparts(np.arange(full.n_points), _near(full, positions))
        return None

    # ---- template correspondence

    def _both_vertices(self, source: str, target: str) -> tuple[Int[np.ndarray, " p"], Int[np.ndarray, " p"]]:
        ours, theirs = self.template_vertices(source), self.template_vertices(target)
        if len(ours) != len(theirs):
            raise DataError(
                f"{source} has {len(ours)} template points and {target} {len(theirs)}; "
                "every .vts file of a dataset must have the same number of lines"
            )
        return ours, theirs

    def template_vertices(self, name: str) -> Int[np.ndarray, " p"]:
        """The shape's vertex at each template point, counted from 0; -1 where it lacks the point.

        Raises:
            DataError: if the file is missing or malformed, or does not fit the shape.
        """
        if name not in self._vertices:
            path = self._file(name)
            points = read_vertices(path)
            check_vertices(path, points, self._shape_of(name), "leave that line out of every .vts file")
            self._vertices[name] = points
        return self._vertices[name]

    # ---- the same numbering

    def _by_numbering(self, source: str, target: str) -> Truth:
        ours, theirs = self._points_of_rows(source), self._points_of_rows(target)
        if len(ours) != len(theirs):
            raise DataError(
                f"{source} has {len(ours)} points and {target} {len(theirs)}; "
                "row i must be the same point in every file of this dataset"
            )
        return Truth(theirs, ours)

    def _points_of_rows(self, name: str) -> Int[np.ndarray, " n"]:
        """For each row of a file the point that it has become."""
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
        check_vertices(path, found, self._shape_of(target), "write -1 there")
        known = np.flatnonzero(found >= 0)
        return Truth(found[known], known)

    # ---- barycentric coordinates

    def _by_triangles(self, source: str, target: str) -> Truth:
        points = self._triangles(source, target)
        corners = _corners(self._shape_of(source), points)
        nearest = np.take_along_axis(corners, points.weights.argmax(axis=1)[:, None], axis=1)[:, 0]
        return Truth(np.arange(len(nearest)), nearest)

    def _triangles(self, source: str, target: str) -> _Barycentric:
        if target not in self._barycentric:
            self._barycentric[target] = self._read_triangles(self._shape_of(source), target)
        return self._barycentric[target]

    def _read_triangles(self, full: Shape, target: str) -> _Barycentric:
        path, n_points = self._file(target), self._shape_of(target).n_points
        points = _read_barycentric(path)
        if len(points.triangles) != n_points:
            raise DataError(f"{path} has {len(points.triangles)} lines, but {target} has {n_points} points")
        if points.triangles.max() >= full.n_faces:
            raise DataError(f"{path} names triangle {points.triangles.max() + 1}, but {full.name} has {full.n_faces}")
        return points

    def _file(self, name: str, pattern: str = "") -> Path:
        return self._root / (pattern or self._description.truth_files).replace("*", name)


def read_vertices(path: Path) -> Int[np.ndarray, " p"]:
    """Read a file of vertices, one a line, counted from 1, as indices from 0; -1 stays, for none.

    Raises:
        DataError: if the file does not hold positive whole numbers, one a line.
    """
    rows = _read_numbers(path, np.int64, "a vertex number a line")
    if rows.ndim != 1 or rows.size == 0 or np.any((rows < 1) & (rows != -1)):
        raise DataError(f"{path} must hold a vertex number a line, counted from 1, or -1 for none")
    return np.where(rows < 0, -1, rows - 1)


def read_truth(files: tuple[Path, Path], shapes: tuple[Shape, Shape]) -> Truth:
    """Read the ground truth of a pair from two ``.vts`` files, the template correspondences of source and target.

    Args:
        files: of the source and of the target; line i is the vertex at template point i, counted from 1, or -1.
        shapes: the two.

    Raises:
        DataError: if a file is missing or malformed, does not fit its shape, or they differ in length.
    """
    found = []
    for file, shape in zip(map(expanded, files), shapes, strict=True):
        points = read_vertices(file)
        check_vertices(file, points, shape, "leave that line out of both files")
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
    """The template points that both shapes have."""
    both = (source >= 0) & (target >= 0)
    return Truth(target[both], source[both])


def _read_cloud_map(path: Path) -> Int[np.ndarray, " n"]:
    try:
        with open_npz(path) as arrays:
            found: np.ndarray = arrays[_CLOUD_MAP]
    except KeyError:
        raise DataError(
            f"{path} has no {_CLOUD_MAP}: its dataset was made of shapes without template correspondence"
        ) from None
    except Exception as error:  # whatever NumPy raises of a damaged file
        raise DataError(f"{path} must hold {_CLOUD_MAP} ({reason_of(error)})") from None
    if found.ndim != 1 or found.dtype.kind != "i" or found.size == 0 or found.min() < -1:
        raise DataError(f"{path}: {_CLOUD_MAP} must hold a point's number for each point of the cloud, or -1")
    return found


def _read_barycentric(path: Path) -> _Barycentric:
    what = "a triangle and three weights a line"
    rows = _read_numbers(path, np.float64, what, dimensions=2)
    if rows.shape[1] != 4 or not np.isfinite(rows).all():
        raise DataError(f"{path} must hold {what}")
    triangles, weights = rows[:, 0].astype(np.int64), rows[:, 1:]
    if np.any(triangles != rows[:, 0]) or triangles.min() < 1:
        raise DataError(f"{path} must hold {what}, the triangles counted from 1")
    if weights.min() < -_TOLERANCE or np.abs(weights.sum(axis=1) - 1).max() > _TOLERANCE:
        raise DataError(f"{path} must hold {what}, the weights not negative and of sum one")
    return _Barycentric(triangles - 1, weights)


def _read_numbers(path: Path, kind: type[Any], what: str, *, dimensions: Literal[1, 2] = 1) -> np.ndarray:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # an empty file, or a number with a fraction
            with opened(path) as file:
                rows: np.ndarray = np.loadtxt(file, dtype=kind, ndmin=dimensions)
            return rows
    except (OSError, ValueError, OverflowError, Warning) as error:
        raise DataError(f"{path} must hold {what} ({reason_of(error)})") from None


def check_vertices(path: Path, vertices: Int[np.ndarray, " p"], shape: Shape, way_out: str) -> None:
    """Refuse a file's vertices, counted from 0, that its shape does not have, or has not in a finite place.

    Raises:
        DataError: naming the file and the vertex.
    """
    if vertices.max() >= shape.n_points:
        raise DataError(f"{path} names vertex {vertices.max() + 1}, but the shape has {shape.n_points}")
    known = vertices[vertices >= 0]
    undefined = known[~np.isfinite(shape.points[known]).all(axis=1)]
    if len(undefined):
        raise DataError(
            f"{path} names vertex {undefined[0] + 1}, which is NaN or infinite; correct the shape, or {way_out}"
        )


def _corners(full: Shape, points: _Barycentric) -> Int[np.ndarray, "n 3"]:
    assert full.faces is not None  # a shape without faces has no triangle that could be named
    corners: np.ndarray = full.faces[points.triangles]
    return corners


def _near(full: Shape, positions: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " m"]:
    """Which points have one of these positions within one mean edge length."""
    assert full.faces is not None
    corners = full.points[full.faces]
    edge = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).mean()
    distances, _ = KDTree(positions).query(full.points)
    near: np.ndarray = distances <= edge
    return near
