"""Triangle surfaces: normals, barycentric coordinates and projection onto a surface."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from homolog.core.memory import row_tiles
from homolog.core.reprs import short_repr
from homolog.geometry.grouping import FacesAround
from homolog.shapes import cross_products, face_vectors, half_edges

# Projection tries this many nearest vertices for one whose normal agrees with the point's: a cosine above _SAME_SIDE.
_NEAR = 16
_SAME_SIDE = 0.3
# A surface has an outside if its normals nearly cancel, as those of a closed one do, and the flux of the position
# through it has one sign for the most part.
_NEARLY_CLOSED = 0.1
_ONE_SIDED = 0.2
# Working memory of a projection, per candidate triangle.
_BYTES_PER_TRIANGLE = 1000


@dataclass(frozen=True)
class Surface:
    """A triangle mesh with its normals.

    Args:
        vertices: positions (n, 3).
        faces: three vertices a triangle, counter-clockwise from outside (m, 3).

    Examples:
        >>> import numpy as np
        >>> from homolog.geometry import Surface
        >>> triangle = Surface(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]]))
        >>> triangle
        Surface(vertices=float64 (3, 3), faces=int64 (1, 3))
        >>> triangle.face_normals
        array([[0., 0., 1.]])
    """

    vertices: Float[np.ndarray, "n 3"]
    faces: Int[np.ndarray, "m 3"]

    __repr__ = short_repr

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
class BarycentricPoints:
    """Points on a triangle mesh in barycentric coordinates.

    Args:
        triangles: the triangle that each point lies on (p,).
        weights: its barycentric coordinates there, which sum to one (p, 3).

    Examples:
        >>> import numpy as np
        >>> from homolog.geometry import BarycentricPoints, Surface
        >>> triangle = Surface(np.array([[0.0, 0, 0], [2, 0, 0], [0, 2, 0]]), np.array([[0, 1, 2]]))
        >>> BarycentricPoints(np.array([0]), np.array([[0.0, 0.5, 0.5]])).positions(triangle)
        array([[1., 1., 0.]])
    """

    triangles: Int[np.ndarray, " p"]
    weights: Float[np.ndarray, "p 3"]

    __repr__ = short_repr

    def positions(self, surface: Surface) -> Float[np.ndarray, "p 3"]:
        """Positions of the points on a surface with the same triangles."""
        corners = surface.vertices[surface.faces[self.triangles]]
        return np.asarray(np.einsum("pck,pc->pk", corners, self.weights))


def unit(vectors: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "n k"]:
    """Normalise vectors to length one; zero vectors stay zero.

    Examples:
        >>> import numpy as np
        >>> from homolog.geometry import unit
        >>> unit(np.array([[3.0, 4.0], [0.0, 0.0]]))
        array([[0.6, 0.8],
               [0. , 0. ]])
    """
    scales = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.asarray(vectors / np.where(scales > 0, scales, 1.0))


def subdivided(surface: Surface) -> tuple[Surface, Int[np.ndarray, "v 2"]]:
    """Split each triangle in four at the midpoints of its edges.

    Returns:
        The finer surface, whose triangles 4i to 4i + 3 cover triangle i, and for each of its vertices the two coarse
        vertices that it is the midpoint of: the same one twice if it is a coarse vertex.
    """
    edges, edge_of = np.unique(np.sort(half_edges(surface.faces), axis=1), axis=0, return_inverse=True)
    count = len(surface.vertices)
    parents = np.concatenate([np.arange(count)[:, None].repeat(2, axis=1), edges])
    p, q, r = surface.faces.T
    pq, qr, rp = count + edge_of.reshape(-1, 3).T
    faces = np.stack([p, pq, rp, q, qr, pq, r, rp, qr, pq, qr, rp], axis=1).reshape(-1, 3)
    return Surface(surface.vertices[parents].mean(axis=1), faces), parents


@dataclass(frozen=True)
class SplitSurface:
    """A surface with its long triangles subdivided; it may have T-junctions.

    Args:
        surface: the short triangles, and the pieces of the long ones.
        parents: for each triangle of ``surface`` the original triangle that it is a piece of (k,).
        corners: the barycentric coordinates of its corners in that original triangle, a row a corner (k, 3, 3).

    See Also:
        ``split_long`` makes it.
    """

    surface: Surface
    parents: Int[np.ndarray, " k"]
    corners: Float[np.ndarray, "k 3 3"]

    __repr__ = short_repr

    def to_original(self, points: BarycentricPoints) -> BarycentricPoints:
        """Points on ``surface`` in the barycentric coordinates of the original surface."""
        weights = np.einsum("pc,pcw->pw", points.weights, self.corners[points.triangles])
        return BarycentricPoints(self.parents[points.triangles], weights)


def split_long(surface: Surface, longest: float, *, most: int) -> SplitSurface:
    """Subdivide triangles with a side longer than ``longest``, repeatedly, as long as there are at most ``most``.

    Examples:
        >>> import numpy as np
        >>> from homolog.geometry import Surface, split_long
        >>> triangle = Surface(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]]))
        >>> len(split_long(triangle, 0.8, most=100).surface.faces)
        4
    """
    parents, corners = np.arange(len(surface.faces)), np.tile(np.eye(3), (len(surface.faces), 1, 1))
    vertices, faces = surface.vertices, surface.faces
    while True:
        sides = vertices[faces] - vertices[faces[:, [1, 2, 0]]]
        long = np.linalg.norm(sides, axis=2).max(axis=1) > longest
        if not long.any() or len(faces) + 3 * long.sum() > most:
            return SplitSurface(Surface(vertices, faces), parents, corners)
        finer, ends = subdivided(Surface(vertices, faces[long]))
        vertices = vertices[ends].mean(axis=1)
        middles = (corners[long] + corners[long][:, [1, 2, 0]]) / 2
        (p, q, r), (pq, qr, rp) = np.moveaxis(corners[long], 1, 0), np.moveaxis(middles, 1, 0)
        quarters = np.stack([p, pq, rp, q, qr, pq, r, rp, qr, pq, qr, rp], axis=1).reshape(-1, 3, 3)
        faces = np.concatenate([faces[~long], finer.faces])
        parents = np.concatenate([parents[~long], np.repeat(parents[long], 4)])
        corners = np.concatenate([corners[~long], quarters])


class ReferenceSurface:
    """A surface to project points onto: the nearest point whose normal agrees, never the far side of a thin part.

    Args:
        surface: a mesh whose triangles have sides of similar lengths; see ``split_long``.

    Examples:
        >>> import numpy as np
        >>> from homolog.geometry import ReferenceSurface, Surface
        >>> square = Surface(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]), np.array([[0, 1, 2], [1, 3, 2]]))
        >>> projected = ReferenceSurface(square).project(np.array([[0.25, 0.25, 2.0]]))
        >>> projected.positions(square).tolist()
        [[0.25, 0.25, 0.0]]
    """

    def __repr__(self) -> str:
        """Sizes alone."""
        return f"ReferenceSurface({self.surface!r})"

    def __init__(self, surface: Surface) -> None:
        self.surface = surface
        self._fine, self._parents = subdivided(surface)
        self._tree = cKDTree(self._fine.vertices)
        # The triangles of the surface itself around each vertex of the subdivided one, of which each has four.
        self._around = FacesAround.of(self._fine.faces, len(self._fine.vertices)).joined(4)

    def nearest_vertices(
        self, points: Float[np.ndarray, "p 3"], normals: Float[np.ndarray, "p 3"]
    ) -> Int[np.ndarray, " p"]:
        """For each point the nearest vertex of the subdivided surface whose normal agrees with the given one."""
        return np.asarray(self._nearest_facing(points, normals, 1)[:, 0], dtype=np.int64)

    def _nearest_facing(self, points: np.ndarray, normals: np.ndarray | None, count: int) -> Int[np.ndarray, "p count"]:
        """The nearest vertices whose normals agree, nearest first; the first is repeated where there are fewer."""
        _, near = self._tree.query(points, k=[*range(1, count + 1)])
        if normals is None:
            return np.asarray(near)
        # For most points all of the nearest vertices agree; only the others are queried again.
        (astray,) = np.nonzero(~self._facing(near, normals).all(axis=1))
        _, more = self._tree.query(points[astray], k=[*range(1, min(_NEAR, self._tree.n) + 1)])
        facing = self._facing(more, normals[astray])
        order = np.argsort(~facing, axis=1, kind="stable")[:, :count]
        rows = np.arange(len(astray))[:, None]
        near[astray] = more[rows, np.where(facing[rows, order], order, order[:, :1])]
        return np.asarray(near)

    def _facing(self, near: Int[np.ndarray, "p j"], normals: Float[np.ndarray, "p 3"]) -> Bool[np.ndarray, "p j"]:
        return np.asarray(np.einsum("pjk,pk->pj", self._fine.vertex_normals[near], normals) > _SAME_SIDE)

    def values_at(self, nearest: Int[np.ndarray, " p"], values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " p"]:
        """Interpolate values of the surface's vertices at vertices of the subdivided surface."""
        return np.asarray(values[self._parents[nearest]].mean(axis=1))

    def onto_tangent_planes(
        self, points: Float[np.ndarray, "p 3"], normals: Float[np.ndarray, "p 3"]
    ) -> Float[np.ndarray, "p 3"]:
        """Project points onto the tangent plane at the nearest vertex: a cheap approximation of ``project``."""
        near = self.nearest_vertices(points, normals)
        away = self._fine.vertex_normals[near]
        height = np.einsum("pk,pk->p", points - self._fine.vertices[near], away)
        return np.asarray(points - height[:, None] * away)

    def project(
        self, points: Float[np.ndarray, "p 3"], normals: Float[np.ndarray, "p 3"] | None = None, *, around: int = 1
    ) -> BarycentricPoints:
        """Project points onto the surface, among the triangles around the nearest vertices.

        Args:
            points: positions.
            normals: the normal that the surface must agree with there; by default any.
            around: how many vertices of the subdivided surface are searched around; more where triangles are long.
        """
        found = [
            self._project(points[rows], None if normals is None else normals[rows], around)
            for rows in row_tiles(len(points), float(self._around.degrees.mean()) * around * _BYTES_PER_TRIANGLE)
        ]
        none = BarycentricPoints(np.zeros(0, dtype=np.int64), np.zeros((0, 3)))
        tiles = [none, *found]
        return BarycentricPoints(
            np.concatenate([tile.triangles for tile in tiles]), np.concatenate([tile.weights for tile in tiles])
        )

    def _project(self, points: np.ndarray, normals: np.ndarray | None, around: int) -> BarycentricPoints:
        near = self._nearest_facing(points, normals, around)
        owner, triangles = self._around.of_each(near.ravel())
        point = owner // around
        corners = self.surface.vertices[self.surface.faces[triangles]]
        weights = closest_weights(corners, points[point])
        offset = np.einsum("tck,tc->tk", corners, weights) - points[point]
        best = _first_least(np.einsum("tk,tk->t", offset, offset), point)
        return BarycentricPoints(triangles[best], weights[best])


def _first_least(values: Float[np.ndarray, " t"], run: Int[np.ndarray, " t"]) -> Int[np.ndarray, " p"]:
    """The index of the smallest value of each run, the first of equal ones; run numbers ascend from 0."""
    starts = np.flatnonzero(np.diff(run, prepend=-1))
    (least,) = np.nonzero(values == np.minimum.reduceat(values, starts)[run])
    return np.asarray(least[np.flatnonzero(np.diff(run[least], prepend=-1))])


def closest_weights(
    triangles: Float[np.ndarray, "p 3 3"], points: Float[np.ndarray, "p 3"]
) -> Float[np.ndarray, "p 3"]:
    """Barycentric coordinates of the closest point on a triangle, for one point per triangle.

    The point is projected onto the triangle's plane; where that falls outside, onto the closest of the three sides.

    Args:
        triangles: corners of each triangle (p, 3, 3).
        points: one point for each triangle (p, 3).

    Examples:
        >>> import numpy as np
        >>> from homolog.geometry import closest_weights
        >>> triangle = np.array([[[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]])
        >>> closest_weights(triangle, np.array([[0.5, -1.0, 3.0]])).tolist()
        [[0.5, 0.5, 0.0]]
    """
    inside = _plane_weights(triangles, points)
    outside = np.flatnonzero((inside < 0).any(axis=1))
    inside[outside] = _side_weights(triangles[outside], points[outside])
    return inside


def _plane_weights(triangles: Float[np.ndarray, "p 3 3"], points: Float[np.ndarray, "p 3"]) -> np.ndarray:
    """Barycentric coordinates in the plane; negative outside, and all -1 where the triangle has no area."""
    normals = face_vectors(triangles)
    squares = np.einsum("pk,pk->p", normals, normals)
    spans = triangles - points[:, None]
    weights = np.stack(
        [
            np.einsum("pk,pk->p", cross_products(spans[:, (corner + 1) % 3], spans[:, (corner + 2) % 3]), normals)
            for corner in range(3)
        ],
        axis=1,
    )
    weights /= np.where(squares > 0, squares, 1.0)[:, None]
    return np.asarray(np.where(squares[:, None] > 0, weights, -1.0))


def _side_weights(triangles: Float[np.ndarray, "p 3 3"], points: Float[np.ndarray, "p 3"]) -> np.ndarray:
    """Barycentric coordinates of the closest point on the triangle's sides."""
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


def outward(surface: Surface) -> int:
    """1 if triangles face outward, -1 if inward, 0 if the surface has no clear outside, as an open one has none.

    By the divergence theorem, the flux of the position through a closed surface is three times the volume inside.

    Examples:
        >>> import numpy as np, trimesh
        >>> from homolog.geometry import Surface, outward
        >>> mesh = trimesh.creation.icosphere(subdivisions=1)
        >>> points, faces = np.array(mesh.vertices), np.array(mesh.faces)
        >>> outward(Surface(points, faces)), outward(Surface(points, faces[:, ::-1]))
        (1, -1)
    """
    areas = np.linalg.norm(surface.face_vectors, axis=1)
    middles = surface.vertices[surface.faces].mean(axis=1)
    middles = middles - np.average(middles, axis=0, weights=areas)
    flux = np.einsum("mk,mk->m", middles, surface.face_vectors)
    closed = np.linalg.norm(surface.face_vectors.sum(axis=0)) < _NEARLY_CLOSED * areas.sum()
    clear = abs(flux.sum()) > _ONE_SIDED * np.abs(flux).sum()
    return int(np.sign(flux.sum())) if closed and clear else 0
