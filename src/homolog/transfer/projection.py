"""Projection onto a shape: the nearest point of its surface, in barycentric coordinates; on clouds, as a local mean."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int, Num
from scipy.spatial import cKDTree

from homolog.core.errors import ArgumentError
from homolog.core.memory import row_tiles
from homolog.geometry import ReferenceSurface, SplitSurface, Surface, split_long, surface_area, unit
from homolog.shapes import Repaired, Shape, repair
from homolog.shapes.cleaning import clean

# A point on a cloud is a weighted mean of this many of the cloud's points.
_CLOUD_CORNERS = 6
# The triangles around this many vertices of the subdivided surface are searched: the nearest vertex need not belong to
# the nearest triangle.
_AROUND = 3
# Triangles with sides longer than _LONG point spacings are split before the search, to at most _MOST_PIECES times the
# number of triangles, since only the surroundings of the nearest vertices are searched.
_LONG = 3.0
_MOST_PIECES = 4


@dataclass(frozen=True, eq=False)
class SurfacePoints:
    """Points on a shape in barycentric coordinates; on a cloud, as weighted means of neighbouring points.

    Args:
        corners: for each point, the shape's points that it is interpolated from: on a mesh the corners of its triangle
            (p, 3), on a cloud the nearest points (p, k). Indices of the shape as it was given; 0 for an invalid point.
        weights: barycentric coordinates (p, k); not negative, with the sum one, and NaN for an invalid point.
        faces: on a mesh, the triangle (p,), as an index of the faces that were given; -1 for an invalid point.

    Examples:
        >>> point = SurfacePoints(np.array([[0, 1, 2]]), np.array([[0.5, 0.25, 0.25]]))
        >>> point.interpolate(np.array([0.0, 4.0, 8.0])).tolist()
        [3.0]
    """

    corners: Int[np.ndarray, "p k"]
    weights: Float[np.ndarray, "p k"]
    faces: Int[np.ndarray, " p"] | None = None

    @property
    def valid(self) -> Bool[np.ndarray, " p"]:
        """Which points lie on the shape; the others have no counterpart."""
        return np.asarray(~np.isnan(self.weights).any(axis=1))

    def interpolate(self, values: Num[np.ndarray, "n ..."]) -> Float[np.ndarray, "p ..."]:
        """Interpolate values of the shape's points by the barycentric coordinates; NaN at invalid points.

        Raises:
            ArgumentError: if there are fewer rows than the largest corner asks for.
        """
        self._check(values)
        found = np.zeros((len(self.corners), int(np.prod(np.shape(values)[1:]))))
        with np.errstate(over="ignore", invalid="ignore"):  # of values that are infinite, or nearly
            columns = np.asarray(values, dtype=np.float64).reshape(len(values), -1)
            for corner, weight in zip(self.corners.T, self.weights.T, strict=True):
                # A value that is NaN does not count where its weight is zero.
                found += np.where(weight[:, None] == 0, 0.0, weight[:, None] * columns[corner])
        return found.reshape(len(found), *np.shape(values)[1:])

    def labels(self, labels: Int[np.ndarray, " n"], *, fill: int = -1) -> Int[np.ndarray, " p"]:
        """The label with the largest total weight at each point, never a mean of several.

        Args:
            labels: of the shape's points. Of labels with equal weight the one of the first corner is taken.
            fill: the label of invalid points.

        Raises:
            ArgumentError: as ``interpolate`` does.
        """
        self._check(labels)
        of_corners = np.asarray(labels)[self.corners]
        weights = np.where(self.valid[:, None], self.weights, 0.0)
        support = np.einsum("pij,pj->pi", of_corners[:, :, None] == of_corners[:, None, :], weights)
        largest = of_corners[np.arange(len(support)), support.argmax(axis=1)]
        return np.asarray(np.where(self.valid, largest, fill), dtype=np.int64)

    def masked(self, keep: Bool[np.ndarray, " p"]) -> SurfacePoints:
        """The same points, of which those outside ``keep`` are made invalid."""
        faces = None if self.faces is None else np.where(keep, self.faces, -1)
        return SurfacePoints(
            np.where(keep[:, None], self.corners, 0), np.where(keep[:, None], self.weights, np.nan), faces
        )

    def _check(self, values: np.ndarray) -> None:
        needed = int(self.corners.max(initial=-1)) + 1
        if len(values) < needed:
            raise ArgumentError(f"values has {len(values)} rows, but must have one per point, at least {needed}")


class SurfaceProjector:
    """Projects points onto a shape, which is repaired first.

    Args:
        shape: a mesh or a point cloud in any state.

    Raises:
        ShapeError: if it cannot be repaired.

    Examples:
        >>> corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
        >>> faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
        >>> projector = SurfaceProjector(Shape(corners, faces))
        >>> projector.positions(projector.project(np.array([[0.25, 0.25, -1.0]]))).tolist()
        [[0.25, 0.25, 0.0]]
    """

    def __init__(self, shape: Shape) -> None:
        self.given = shape
        self.repaired: Repaired = repair(shape)
        self.shape: Shape = self.repaired.shape

    @cached_property
    def surface(self) -> Surface | None:
        """The repaired shape's triangles; None for a cloud."""
        return None if self.shape.faces is None else Surface(self.shape.points, self.shape.faces)

    @cached_property
    def unit(self) -> float:
        """The square root of the area."""
        return float(np.sqrt(surface_area(self.shape)))

    @cached_property
    def spacing(self) -> float:
        """The typical distance between neighbouring points: sqrt(area / n)."""
        return self.unit / float(np.sqrt(self.shape.n_points))

    def project(
        self, points: Float[np.ndarray, "p 3"], normals: Float[np.ndarray, "p 3"] | None = None
    ) -> SurfacePoints:
        """Project positions onto the shape; a position that is NaN gives an invalid point.

        Args:
            points: positions in the shape's coordinates.
            normals: the normal that the surface must agree with, so that no point is projected onto the far side of a
                thin part; by default any. Ignored for clouds, which have no sides.
        """
        finite = np.isfinite(points).all(axis=1)
        points = np.where(finite[:, None], points, self.shape.points[0])
        found = self._onto_cloud(points) if self.surface is None else self._onto_mesh(points, normals)
        return found.masked(finite)

    def normals(self, points: SurfacePoints) -> Float[np.ndarray, "p 3"] | None:
        """The unit normals at points of the shape, interpolated from the vertices; None for a cloud."""
        if self.surface is None:
            return None
        at_vertices = self.repaired.to_original(self.surface.vertex_normals, fill=0.0)
        return unit(np.nan_to_num(points.interpolate(at_vertices)))

    def positions(self, points: SurfacePoints) -> Float[np.ndarray, "p 3"]:
        """The positions of points of the shape, in its coordinates; NaN where they are invalid."""
        return points.interpolate(self.given.points)

    @cached_property
    def given_faces(self) -> Int[np.ndarray, " m"]:
        """Which of the faces that were given each of the repaired mesh's faces is."""
        kept = clean(self.given).kept_faces
        assert kept is not None
        return kept

    @cached_property
    def _split(self) -> SplitSurface:
        assert self.surface is not None
        most = _MOST_PIECES * (len(self.surface.faces) + 1000)
        return split_long(self.surface, _LONG * self.spacing, most=most)

    @cached_property
    def _reference(self) -> ReferenceSurface:
        return ReferenceSurface(self._split.surface)

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self.shape.points)

    def _onto_mesh(self, points: np.ndarray, normals: np.ndarray | None) -> SurfacePoints:
        found = self._split.to_original(self._reference.project(points, normals, around=_AROUND))
        faces = self.given_faces[found.triangles]
        assert self.given.faces is not None
        return SurfacePoints(self.given.faces[faces], found.weights, faces)

    def _onto_cloud(self, points: np.ndarray) -> SurfacePoints:
        count = min(_CLOUD_CORNERS, self.shape.n_points - 1)
        corners = np.empty((len(points), count), dtype=np.int64)
        weights = np.empty((len(points), count))
        for rows in row_tiles(len(points), 100 * count):
            distances, near = self._tree.query(points[rows], k=count + 1)
            corners[rows], weights[rows] = self.repaired.kept[near[:, :count]], _shepard_weights(distances)
        return SurfacePoints(corners, weights)


def _shepard_weights(distances: Float[np.ndarray, "p k1"]) -> Float[np.ndarray, "p k"]:
    """Modified Shepard weights: inverse distances that fade to zero at the last of increasing distances.

    Interpolated values are continuous and equal the data at the data points (R. Franke and G. Nielson, "Smooth
    interpolation of large sets of scattered data", IJNME 15, 1980).
    """
    reach = distances[:, -1:]
    near = np.maximum(distances[:, :-1], 1e-9 * reach)
    weights = ((reach - near) / near) ** 2
    # Where all distances are equal, each counts the same.
    weights = np.where(weights.sum(axis=1, keepdims=True) > 0, weights, 1.0)
    return np.asarray(weights / weights.sum(axis=1, keepdims=True))
