"""Triangle surfaces: normals, and the places on a surface where points of another mesh lie."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from homolog.core.memory import row_tiles
from homolog.geometry.grouping import FacesAround
from homolog.shapes import face_vectors

# A point's place is looked for among so many vertices nearest to it, on the side that faces its way.
_NEAR = 16
_SAME_SIDE = 0.3
# What looking for a place takes of memory, for each triangle that is looked at.
_BYTES_PER_TRIANGLE = 1000
_PLACE_PARTS = ("triangles", "weights")


@dataclass(frozen=True)
class Surface:
    """A triangle mesh.

    Args:
        vertices: positions.
        faces: three vertices a triangle, counter-clockwise from outside.
    """

    vertices: Float[np.ndarray, "n 3"]
    faces: Int[np.ndarray, "m 3"]

    @cached_property
    def face_vectors(self) -> Float[np.ndarray, "m 3"]:
        """The normal of each triangle, as long as twice its area."""
        return face_vectors(self.vertices[self.faces])

    @cached_property
    def face_normals(self) -> Float[np.ndarray, "m 3"]:
        """The unit normal of each triangle; zero where it has no area."""
        return unit(self.face_vectors)

    @cached_property
    def vertex_normals(self) -> Float[np.ndarray, "n 3"]:
        """The unit normal at each vertex: its triangles' normals, weighted by area."""
        corners, count = self.faces.ravel(), len(self.vertices)
        vectors = np.repeat(self.face_vectors, 3, axis=0)
        return unit(np.stack([np.bincount(corners, column, count) for column in vectors.T], axis=1))


@dataclass(frozen=True)
class Places:
    """Where points lie on a surface.

    Args:
        triangles: the triangle that each point lies on.
        weights: its barycentric weights there, which sum to one.
    """

    triangles: Int[np.ndarray, " p"]
    weights: Float[np.ndarray, "p 3"]

    def on(self, surface: Surface) -> Float[np.ndarray, "p 3"]:
        """Positions of the places on a surface with the same triangles."""
        corners = surface.vertices[surface.faces[self.triangles]]
        return np.asarray(np.einsum("pck,pc->pk", corners, self.weights))


def unit(vectors: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "n k"]:
    """Vectors scaled to length one; zero stays zero."""
    scales = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.asarray(vectors / np.where(scales > 0, scales, 1.0))


def subdivided(surface: Surface) -> tuple[Surface, Int[np.ndarray, "v 2"]]:
    """Split each triangle in four.

    Returns:
        The finer surface, whose triangles 4i to 4i + 3 are those of triangle i, and for each of its vertices the two of
        the coarser one that it lies amid: one twice, if it is that one.
    """
    half_edges = surface.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    edges, edge_of = np.unique(np.sort(half_edges, axis=1), axis=0, return_inverse=True)
    count = len(surface.vertices)
    parents = np.concatenate([np.arange(count)[:, None].repeat(2, axis=1), edges])
    p, q, r = surface.faces.T
    pq, qr, rp = count + edge_of.reshape(-1, 3).T
    faces = np.stack([p, pq, rp, q, qr, pq, r, rp, qr, pq, qr, rp], axis=1).reshape(-1, 3)
    return Surface(surface.vertices[parents].mean(axis=1), faces), parents


@dataclass(frozen=True)
class Pieces:
    """A surface with its long triangles split, which need not meet at corners any more.

    Args:
        surface: the triangles that are left whole, and the pieces of the others.
        of: the triangle that each is a piece of.
        corners: the barycentric weights of its corners in that triangle, a row a corner.
    """

    surface: Surface
    of: Int[np.ndarray, " k"]
    corners: Float[np.ndarray, "k 3 3"]

    def whole(self, places: Places) -> Places:
        """Places on the pieces, as places on the surface that was split."""
        weights = np.einsum("pc,pcw->pw", places.weights, self.corners[places.triangles])
        return Places(self.of[places.triangles], weights)


def split_long(surface: Surface, longest: float, *, most: int) -> Pieces:
    """Split triangles with sides longer than ``longest`` in four, and again, while there are fewer than ``most``."""
    of, corners = np.arange(len(surface.faces)), np.tile(np.eye(3), (len(surface.faces), 1, 1))
    vertices, faces = surface.vertices, surface.faces
    while True:
        sides = vertices[faces] - vertices[faces[:, [1, 2, 0]]]
        long = np.linalg.norm(sides, axis=2).max(axis=1) > longest
        if not long.any() or len(faces) + 3 * long.sum() > most:
            return Pieces(Surface(vertices, faces), of, corners)
        finer, parents = subdivided(Surface(vertices, faces[long]))
        vertices = vertices[parents].mean(axis=1)
        middles = (corners[long] + corners[long][:, [1, 2, 0]]) / 2
        (p, q, r), (pq, qr, rp) = np.moveaxis(corners[long], 1, 0), np.moveaxis(middles, 1, 0)
        quarters = np.stack([p, pq, rp, q, qr, pq, r, rp, qr, pq, qr, rp], axis=1).reshape(-1, 3, 3)
        faces = np.concatenate([faces[~long], finer.faces])
        of = np.concatenate([of[~long], np.repeat(of[long], 4)])
        corners = np.concatenate([corners[~long], quarters])


class Ground:
    """A surface to put points on: finds the nearest part that faces their way, never the other side of a thin one."""

    def __init__(self, surface: Surface) -> None:
        self.surface = surface
        self._fine, self._parents = subdivided(surface)
        self._tree = cKDTree(self._fine.vertices)
        # The triangles of the surface itself around each vertex of the subdivided one, of which each has four.
        self._around = FacesAround.of(self._fine.faces, len(self._fine.vertices)).joined(4)

    def nearest(self, points: Float[np.ndarray, "p 3"], normals: Float[np.ndarray, "p 3"]) -> Int[np.ndarray, " p"]:
        """For each point the nearest vertex of the subdivided surface whose normal agrees with the one given."""
        return np.asarray(self._nearest_facing(points, normals, 1)[:, 0], dtype=np.int64)

    def _nearest_facing(self, points: np.ndarray, normals: np.ndarray | None, count: int) -> Int[np.ndarray, "p count"]:
        """For each point so many vertices that face its way, nearest first; the first again where there are fewer."""
        _, near = self._tree.query(points, k=[*range(1, count + 1)])
        if normals is None:
            return np.asarray(near)
        # Mostly the nearest ones face the right way, and no others need to be looked for.
        (astray,) = np.nonzero(~self._facing(near, normals).all(axis=1))
        _, more = self._tree.query(points[astray], k=_NEAR)
        facing = self._facing(more, normals[astray])
        order = np.argsort(~facing, axis=1, kind="stable")[:, :count]
        rows = np.arange(len(astray))[:, None]
        near[astray] = more[rows, np.where(facing[rows, order], order, order[:, :1])]
        return np.asarray(near)

    def _facing(self, near: Int[np.ndarray, "p j"], normals: Float[np.ndarray, "p 3"]) -> Bool[np.ndarray, "p j"]:
        return np.asarray(np.einsum("pjk,pk->pj", self._fine.vertex_normals[near], normals) > _SAME_SIDE)

    def values_at(self, nearest: Int[np.ndarray, " p"], values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " p"]:
        """Values given at the surface's vertices, at vertices of the subdivided one."""
        return np.asarray(values[self._parents[nearest]].mean(axis=1))

    def slid(self, points: Float[np.ndarray, "p 3"], normals: Float[np.ndarray, "p 3"]) -> Float[np.ndarray, "p 3"]:
        """Points moved to the tangent plane at the nearest vertex, which is close to the surface."""
        near = self.nearest(points, normals)
        away = self._fine.vertex_normals[near]
        height = np.einsum("pk,pk->p", points - self._fine.vertices[near], away)
        return np.asarray(points - height[:, None] * away)

    def places(
        self, points: Float[np.ndarray, "p 3"], normals: Float[np.ndarray, "p 3"] | None = None, *, around: int = 1
    ) -> Places:
        """The nearest places on the surface itself, among the triangles around the nearest vertices.

        Args:
            points: positions.
            normals: which way the surface is to face there; any way if there are none.
            around: how many of the subdivided surface's vertices count; more where triangles are long.
        """
        found = [
            self._places(points[rows], None if normals is None else normals[rows], around)
            for rows in row_tiles(len(points), float(self._around.degrees.mean()) * around * _BYTES_PER_TRIANGLE)
        ]
        none = Places(np.zeros(0, dtype=np.int64), np.zeros((0, 3)))
        return Places(*(np.concatenate([getattr(part, name) for part in [none, *found]]) for name in _PLACE_PARTS))

    def _places(self, points: np.ndarray, normals: np.ndarray | None, around: int) -> Places:
        near = self._nearest_facing(points, normals, around)
        place, triangles = self._around.of_each(near.ravel())
        point = place // around
        corners = self.surface.vertices[self.surface.faces[triangles]]
        weights = closest_weights(corners, points[point])
        offset = np.einsum("tck,tc->tk", corners, weights) - points[point]
        best = _first_least(np.einsum("tk,tk->t", offset, offset), point)
        return Places(triangles[best], weights[best])


def _first_least(values: Float[np.ndarray, " t"], run: Int[np.ndarray, " t"]) -> Int[np.ndarray, " p"]:
    """Where the least value of each run is, the first of equal ones; the runs count up from 0."""
    starts = np.flatnonzero(np.diff(run, prepend=-1))
    (least,) = np.nonzero(values == np.minimum.reduceat(values, starts)[run])
    return np.asarray(least[np.flatnonzero(np.diff(run[least], prepend=-1))])


def closest_weights(
    triangles: Float[np.ndarray, "p 3 3"], points: Float[np.ndarray, "p 3"]
) -> Float[np.ndarray, "p 3"]:
    """Barycentric weights of the point of each triangle that is closest to a point, one point a triangle.

    Where the foot of the perpendicular lies outside, the closest of the three sides is taken.
    """
    inside = _plane_weights(triangles, points)
    outside = np.flatnonzero((inside < 0).any(axis=1))
    inside[outside] = _side_weights(triangles[outside], points[outside])
    return inside


def _plane_weights(triangles: Float[np.ndarray, "p 3 3"], points: Float[np.ndarray, "p 3"]) -> np.ndarray:
    """Weights of the foot of the perpendicular; negative outside, and all -1 where the triangle has no area."""
    normals = face_vectors(triangles)
    squares = np.einsum("pk,pk->p", normals, normals)
    spans = triangles - points[:, None]
    areas = np.cross(spans[:, [1, 2, 0]], spans[:, [2, 0, 1]])
    weights = np.einsum("pck,pk->pc", areas, normals) / np.where(squares > 0, squares, 1.0)[:, None]
    return np.asarray(np.where(squares[:, None] > 0, weights, -1.0))


def _side_weights(triangles: Float[np.ndarray, "p 3 3"], points: Float[np.ndarray, "p 3"]) -> np.ndarray:
    """Weights of the closest point on the triangle's sides."""
    starts, sides = triangles, triangles[:, [1, 2, 0]] - triangles
    squares = np.einsum("pck,pck->pc", sides, sides)
    along = np.einsum("pck,pck->pc", points[:, None] - starts, sides) / np.where(squares > 0, squares, 1.0)
    along = along.clip(0.0, 1.0)
    offset = starts + along[..., None] * sides - points[:, None]
    best = np.einsum("pck,pck->pc", offset, offset).argmin(axis=1)
    rows = np.arange(len(points))
    weights = np.zeros((len(points), 3))
    weights[rows, best] = 1.0 - along[rows, best]
    weights[rows, (best + 1) % 3] = along[rows, best]
    return weights
