"""Where points lie on a shape, as weights over its points; and finding the place on a shape nearest to a position."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int, Num
from scipy.spatial import cKDTree

from homolog.core.errors import ArgumentError
from homolog.core.memory import row_tiles
from homolog.geometry import Ground, Pieces, Places, Surface, split_long, surface_area, unit
from homolog.shapes import Repaired, Shape, repair
from homolog.shapes.cleaning import clean

# A place on a cloud is a mean of so many of its points.
_CLOUD_CORNERS = 6
# So many vertices of the subdivided surface are looked at, as the nearest one need not be of the nearest triangle.
_AROUND = 3
# Triangles with sides of more than so many point spacings are split for that, to so many times their number at most.
_LONG = 3.0
_MOST_PIECES = 4


@dataclass(frozen=True, eq=False)
class ShapePlaces:
    """Where points lie on a shape.

    Args:
        corners: for each point, the shape's points that it lies amid: on a mesh the corners of its triangle (p, 3),
            on a cloud the nearest points (p, k). Indices of the shape as it was given; 0 for a point without a place.
        weights: how much each counts (p, k); not negative, with the sum one, and NaN for a point without a place.
        faces: on a mesh, the triangle (p,), as an index of the faces that were given; -1 for a point without a place.
    """

    corners: Int[np.ndarray, "p k"]
    weights: Float[np.ndarray, "p k"]
    faces: Int[np.ndarray, " p"] | None = None

    @property
    def exist(self) -> Bool[np.ndarray, " p"]:
        """Which points have a place."""
        return np.asarray(~np.isnan(self.weights).any(axis=1))

    def values(self, values: Num[np.ndarray, "n ..."]) -> Float[np.ndarray, "p ..."]:
        """Values given at the shape's points, interpolated at the places; NaN where there is none.

        Raises:
            ArgumentError: if the shape cannot have so few points.
        """
        self._check(values)
        columns = np.asarray(values, dtype=np.float64).reshape(len(values), -1)
        found = np.zeros((len(self.corners), columns.shape[1]))
        for corner, weight in zip(self.corners.T, self.weights.T, strict=True):
            # A value that is NaN does not count where its weight is zero.
            found += np.where(weight[:, None] == 0, 0.0, weight[:, None] * columns[corner])
        return found.reshape(len(found), *np.shape(values)[1:])

    def labels(self, labels: Int[np.ndarray, " n"]) -> Int[np.ndarray, " p"]:
        """The label with the largest weight at each place, the first corner's among equal ones; -1 where there is none.

        Raises:
            ArgumentError: if the shape cannot have so few points.
        """
        self._check(labels)
        of_corners = np.asarray(labels)[self.corners]
        weights = np.where(self.exist[:, None], self.weights, 0.0)
        support = np.einsum("pij,pj->pi", of_corners[:, :, None] == of_corners[:, None, :], weights)
        largest = of_corners[np.arange(len(support)), support.argmax(axis=1)]
        return np.asarray(np.where(self.exist, largest, -1), dtype=np.int64)

    def only(self, chosen: Bool[np.ndarray, " p"]) -> ShapePlaces:
        """The same for chosen points; the others lose their place."""
        faces = None if self.faces is None else np.where(chosen, self.faces, -1)
        return ShapePlaces(
            np.where(chosen[:, None], self.corners, 0), np.where(chosen[:, None], self.weights, np.nan), faces
        )

    def _check(self, values: np.ndarray) -> None:
        needed = int(self.corners.max(initial=-1)) + 1
        if len(values) < needed:
            raise ArgumentError(f"values has {len(values)} rows, but must have one per point, at least {needed}")


class PlaceFinder:
    """A shape, repaired, to find places on.

    Args:
        shape: a mesh or a point cloud in any state.

    Raises:
        ShapeError: if it cannot be repaired.
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
        """The distance of neighbouring points, about."""
        return self.unit / float(np.sqrt(self.shape.n_points))

    def places(self, points: Float[np.ndarray, "p 3"], normals: Float[np.ndarray, "p 3"] | None = None) -> ShapePlaces:
        """The places nearest to positions; a position that is NaN has none.

        Args:
            points: positions in the shape's coordinates.
            normals: which way the surface faces where they belong, so that none comes to lie on the far side of a thin
                part; any way by default. Clouds have no sides.
        """
        exist = np.isfinite(points).all(axis=1)
        points = np.where(exist[:, None], points, self.shape.points[0])
        found = self._on_cloud(points) if self.surface is None else self._on_mesh(points, normals)
        return found.only(exist)

    def normals(self, places: ShapePlaces) -> Float[np.ndarray, "p 3"] | None:
        """The unit normals at places; None for a cloud."""
        if self.surface is None:
            return None
        return unit(np.nan_to_num(places.values(self.repaired.to_original(self.surface.vertex_normals, fill=0.0))))

    def positions(self, places: ShapePlaces) -> Float[np.ndarray, "p 3"]:
        """Where places lie, in the shape's coordinates; NaN where there is none."""
        return places.values(self.given.points)

    @cached_property
    def _pieces(self) -> Pieces:
        assert self.surface is not None
        most = _MOST_PIECES * (len(self.surface.faces) + 1000)
        return split_long(self.surface, _LONG * self.spacing, most=most)

    @cached_property
    def _ground(self) -> Ground:
        return Ground(self._pieces.surface)

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self.shape.points)

    @cached_property
    def given_faces(self) -> Int[np.ndarray, " m"]:
        """Which of the faces that were given each of the repaired mesh's is."""
        kept = clean(self.given).kept_faces
        assert kept is not None
        return kept

    def _on_mesh(self, points: np.ndarray, normals: np.ndarray | None) -> ShapePlaces:
        found: Places = self._pieces.whole(self._ground.places(points, normals, around=_AROUND))
        faces = self.given_faces[found.triangles]
        assert self.given.faces is not None
        return ShapePlaces(self.given.faces[faces], found.weights, faces)

    def _on_cloud(self, points: np.ndarray) -> ShapePlaces:
        count = min(_CLOUD_CORNERS, self.shape.n_points - 1)
        corners = np.empty((len(points), count), dtype=np.int64)
        weights = np.empty((len(points), count))
        for rows in row_tiles(len(points), 100 * count):
            distances, near = self._tree.query(points[rows], k=count + 1)
            corners[rows], weights[rows] = self.repaired.kept[near[:, :count]], _fading(distances)
        return ShapePlaces(corners, weights)


def _fading(distances: Float[np.ndarray, "p k1"]) -> Float[np.ndarray, "p k"]:
    """Weights that fade to zero at the last of increasing distances, and are all the first's where that is zero.

    Those of Franke and Little's local form of Shepard's interpolation, so that a value changes continuously from point
    to point and is met at each.
    """
    reach = distances[:, -1:]
    near = np.maximum(distances[:, :-1], 1e-9 * reach)
    weights = ((reach - near) / near) ** 2
    # Where all are equally far, each counts the same.
    weights = np.where(weights.sum(axis=1, keepdims=True) > 0, weights, 1.0)
    return np.asarray(weights / weights.sum(axis=1, keepdims=True))
