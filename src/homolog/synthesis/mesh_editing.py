"""Edge splits, collapses and flips of closed meshes, many edges at once.

The operations are those of M. Botsch and L. Kobbelt, "A remeshing approach to multiresolution modeling" (SGP 2004).
Edges that are changed together are independent: their neighbourhoods do not overlap. Sweeps repeat until few are left.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import csr_matrix

from homolog.geometry.grouping import FacesAround
from homolog.shapes import face_vectors

# Edges longer or shorter than this, relative to the target length, are split or collapsed.
LONG, SHORT = 4.0 / 3.0, 4.0 / 5.0
# How far a triangle's normal may rotate, as a cosine, when an edge is collapsed or flipped.
_COLLAPSE_COSINE = 0.4
_FLIP_COSINE = 0.6
# Sweeps end when fewer edges than this, relative to the vertices, are left to change; the next round takes them.
_FEW = 0.002
_SWEEPS = 40


@dataclass(frozen=True)
class WorkingMesh:
    """A closed manifold mesh while it is remeshed.

    Args:
        points: the vertices' positions.
        space: positions in which lengths and angles are measured; compressed in one direction for stretched triangles.
        lengths: the target edge length at each vertex.
        faces: three vertices a triangle.
    """

    points: Float[np.ndarray, "n 3"]
    space: Float[np.ndarray, "n k"]
    lengths: Float[np.ndarray, " n"]
    faces: Int[np.ndarray, "m 3"]

    def relative_lengths(self, a: Int[np.ndarray, " e"], b: Int[np.ndarray, " e"]) -> Float[np.ndarray, " e"]:
        """The distance of pairs of vertices, relative to the target length there."""
        apart = np.linalg.norm(self.space[a] - self.space[b], axis=1)
        return np.asarray(2.0 * apart / (self.lengths[a] + self.lengths[b]))


@dataclass(frozen=True)
class Edges:
    """The undirected edges of a closed manifold mesh, each once.

    Args:
        a: its first end; the edge runs from a to b in the first of its two triangles.
        b: its second end.
        c: the opposite vertex in the first triangle, (a, b, c).
        d: the opposite vertex in the second triangle, (b, a, d).
        first: the first triangle.
        second: the second triangle.
        key: a unique number of each edge, in ascending order.
    """

    a: Int[np.ndarray, " e"]
    b: Int[np.ndarray, " e"]
    c: Int[np.ndarray, " e"]
    d: Int[np.ndarray, " e"]
    first: Int[np.ndarray, " e"]
    second: Int[np.ndarray, " e"]
    key: Int[np.ndarray, " e"]


def edge_key(a: Int[np.ndarray, " e"], b: Int[np.ndarray, " e"], n_vertices: int) -> Int[np.ndarray, " e"]:
    """A unique number for each unordered pair of vertices."""
    return np.asarray(np.minimum(a, b) * n_vertices + np.maximum(a, b))


def edges_of(faces: Int[np.ndarray, "m 3"], n_vertices: int) -> Edges:
    """The edges of a closed manifold mesh."""
    start, end, across = faces.ravel(), faces[:, [1, 2, 0]].ravel(), faces[:, [2, 0, 1]].ravel()
    key = edge_key(start, end, n_vertices)
    first, second = np.argsort(key, kind="stable").reshape(-1, 2).T
    return Edges(start[first], end[first], across[first], across[second], first // 3, second // 3, key[first])


def split_long(mesh: WorkingMesh) -> WorkingMesh:
    """Split every edge that is too long at its midpoint; its triangles become two, three or four."""
    edges = edges_of(mesh.faces, len(mesh.points))
    long = np.flatnonzero(mesh.relative_lengths(edges.a, edges.b) > LONG)
    middle = _middles(mesh.faces, edges, long, len(mesh.points))
    a, b = edges.a[long], edges.b[long]
    return WorkingMesh(
        np.concatenate([mesh.points, (mesh.points[a] + mesh.points[b]) / 2]),
        np.concatenate([mesh.space, (mesh.space[a] + mesh.space[b]) / 2]),
        np.concatenate([mesh.lengths, (mesh.lengths[a] + mesh.lengths[b]) / 2]),
        _split_faces(mesh.faces, middle),
    )


def _middles(
    faces: Int[np.ndarray, "m 3"], edges: Edges, split: Int[np.ndarray, " s"], n_vertices: int
) -> Int[np.ndarray, "m 3"]:
    """The new vertex on each side of each triangle, side i from corner i to the next; -1 where it is not split."""
    new = np.full(len(edges.key), -1)
    new[split] = n_vertices + np.arange(len(split))
    sides = edge_key(faces, faces[:, [1, 2, 0]], n_vertices)
    return np.asarray(new[np.searchsorted(edges.key, sides)])


def _split_faces(faces: Int[np.ndarray, "m 3"], middle: Int[np.ndarray, "m 3"]) -> Int[np.ndarray, "s 3"]:
    count = (middle >= 0).sum(axis=1)
    # Corners are rotated so that a single split side comes first, and a single unsplit side last.
    first = np.where(count == 1, (middle >= 0).argmax(axis=1), ((middle < 0).argmax(axis=1) + 1) % 3)
    columns = (first[:, None] + np.arange(3)) % 3
    corner, middle = np.take_along_axis(faces, columns, 1), np.take_along_axis(middle, columns, 1)
    (p, q, r), (x, y, z) = corner.T, middle.T
    patterns = (
        (count == 0, ((p, q, r),)),
        (count == 1, ((p, x, r), (x, q, r))),
        (count == 2, ((p, x, r), (x, y, r), (x, q, y))),
        (count == 3, ((p, x, z), (x, q, y), (z, y, r), (x, y, z))),
    )
    return np.concatenate([np.stack(triangle, axis=1)[which] for which, new in patterns for triangle in new])


def collapse_short(mesh: WorkingMesh) -> WorkingMesh:
    """Collapse every edge that is too short to its midpoint, where this folds nothing and makes no long edge."""
    refused = np.zeros(0, dtype=np.int64)
    for _ in range(_SWEEPS):
        edges = edges_of(mesh.faces, len(mesh.points))
        relative = mesh.relative_lengths(edges.a, edges.b)
        short = np.flatnonzero(relative < SHORT)
        short = short[~np.isin(edges.key[short], refused)]
        short = short[np.argsort(relative[short], kind="stable")]
        chosen = _independent(mesh.faces, edges, short, len(mesh.points))
        sound = _collapsible(mesh, edges, chosen)
        refused = np.concatenate([refused, edges.key[chosen[~sound]]])
        mesh = _collapsed(mesh, edges.a[chosen[sound]], edges.b[chosen[sound]])
        if len(chosen) < _FEW * len(mesh.points):
            break
    used, faces = np.unique(mesh.faces, return_inverse=True)
    return WorkingMesh(mesh.points[used], mesh.space[used], mesh.lengths[used], faces.reshape(-1, 3))


def _independent(
    faces: Int[np.ndarray, "m 3"], edges: Edges, short: Int[np.ndarray, " e"], n_vertices: int
) -> Int[np.ndarray, " s"]:
    """Independent edges, earlier ones first: none are joined or share an opposite vertex."""
    joined = np.stack([edges.a[short], edges.b[short]], axis=1)
    short = short[_first_of_all_near(faces, joined, n_vertices, rings=1)]
    across = np.stack([edges.c[short], edges.d[short]], axis=1)
    return np.asarray(short[_first_of_all_near(faces, across, n_vertices, rings=0)])


def _collapsible(mesh: WorkingMesh, edges: Edges, which: Int[np.ndarray, " e"]) -> Bool[np.ndarray, " e"]:
    """Which edges can be collapsed: the link condition holds, and no triangle folds or gets a long side."""
    a, b = edges.a[which], edges.b[which]
    valence = np.bincount(mesh.faces.ravel(), minlength=len(mesh.points))
    sound = np.minimum(valence[edges.c[which]], valence[edges.d[which]]) > 3
    # The link condition: the ends of an edge have just two common neighbours.
    rows, columns = np.concatenate([edges.a, edges.b]), np.concatenate([edges.b, edges.a])
    count = len(mesh.points)
    adjacency = csr_matrix((np.ones(len(rows), dtype=np.int32), (rows, columns)), (count, count))
    sound &= np.asarray(adjacency[a].multiply(adjacency[b]).sum(axis=1)).ravel() == 2
    edge, face, end = _faces_around(mesh.faces, a, b, len(mesh.points))
    corners = mesh.faces[face]
    moves = corners == end[:, None]
    middle = (mesh.points[a] + mesh.points[b])[edge] / 2
    before = mesh.points[corners]
    after = np.where(moves[..., None], middle[:, None], before)
    folded = _cosines(face_vectors(before), face_vectors(after)) < _COLLAPSE_COSINE
    space = (mesh.space[a] + mesh.space[b])[edge] / 2
    length = (mesh.lengths[a] + mesh.lengths[b])[edge] / 2
    reach = np.linalg.norm(mesh.space[corners] - space[:, None], axis=2)
    long = (2.0 * reach > LONG * (length[:, None] + mesh.lengths[corners])) & ~moves
    spoilt = np.bincount(edge, folded | long.any(axis=1), minlength=len(which))
    return np.asarray(sound & (spoilt == 0))


def _faces_around(
    faces: Int[np.ndarray, "m 3"], a: Int[np.ndarray, " e"], b: Int[np.ndarray, " e"], n_vertices: int
) -> tuple[Int[np.ndarray, " q"], Int[np.ndarray, " q"], Int[np.ndarray, " q"]]:
    """Edge, triangle and end, for every triangle that has exactly one end of an edge."""
    ends = np.stack([a, b], axis=1).ravel()
    edge_end, face = FacesAround.of(faces, n_vertices).of_each(ends)
    other = np.stack([b, a], axis=1).ravel()[edge_end]
    alone = (faces[face] != other[:, None]).all(axis=1)
    return edge_end[alone] // 2, face[alone], ends[edge_end[alone]]


def _first_of_all_near(
    faces: Int[np.ndarray, "m 3"], groups: Int[np.ndarray, "e k"], n_vertices: int, *, rings: int
) -> Bool[np.ndarray, " e"]:
    """Which groups of vertices come first in the given order among all groups within that many rings of edges."""
    rank = np.full(n_vertices, len(groups))
    np.minimum.at(rank, groups.ravel(), np.repeat(np.arange(len(groups)), groups.shape[1]))
    for _ in range(rings):
        lowest = np.minimum.reduce([rank[corners] for corners in faces.T])
        np.minimum.at(rank, faces.ravel(), np.repeat(lowest, 3))
    return np.asarray((rank[groups] == np.arange(len(groups))[:, None]).all(axis=1))


def _collapsed(mesh: WorkingMesh, a: Int[np.ndarray, " e"], b: Int[np.ndarray, " e"]) -> WorkingMesh:
    """Each b merged into its a, which moves to the midpoint; the vertices b stay, without triangles."""
    points, space, lengths = mesh.points.copy(), mesh.space.copy(), mesh.lengths.copy()
    for values in (points, space, lengths):
        values[a] = (values[a] + values[b]) / 2
    into = np.arange(len(points))
    into[b] = a
    p, q, r = into[mesh.faces].T
    kept = (p != q) & (q != r) & (r != p)
    return WorkingMesh(points, space, lengths, np.stack([p, q, r], axis=1)[kept])


def flip_to_delaunay(mesh: WorkingMesh) -> WorkingMesh:
    """Flip edges whose opposite angles sum to more than 180 degrees, unless that bends the surface.

    On a flat surface this gives the Delaunay triangulation, whose cotangent Laplacian has no negative weights
    (C. L. Lawson, "Software for C1 surface interpolation", 1977).
    """
    faces = mesh.faces.copy()
    for _ in range(_SWEEPS):
        edges = edges_of(faces, len(mesh.points))
        gain = -_cotangents(mesh.space, edges)
        candidates = np.flatnonzero(gain > 1e-6)
        candidates = candidates[np.argsort(-gain[candidates], kind="stable")]
        candidates = candidates[_flippable(mesh.points, edges, candidates)]
        groups = np.stack([edges.a, edges.b, edges.c, edges.d], axis=1)[candidates]
        chosen = candidates[_first_of_all_near(faces, groups, len(mesh.points), rings=0)]
        a, b, c, d = (ends[chosen] for ends in (edges.a, edges.b, edges.c, edges.d))
        faces[edges.first[chosen]] = np.stack([a, d, c], axis=1)
        faces[edges.second[chosen]] = np.stack([d, b, c], axis=1)
        if len(chosen) < _FEW * len(mesh.points):
            break
    return replace(mesh, faces=faces)


def _cotangents(space: Float[np.ndarray, "n k"], edges: Edges) -> Float[np.ndarray, " e"]:
    """The sum of the cotangents of the two angles opposite each edge."""
    total = np.zeros(len(edges.a))
    for across in (edges.c, edges.d):
        u, v = space[edges.a] - space[across], space[edges.b] - space[across]
        inner = np.einsum("ek,ek->e", u, v)
        square = np.einsum("ek,ek->e", u, u) * np.einsum("ek,ek->e", v, v) - inner**2
        total += inner / np.sqrt(square.clip(1e-30))
    return total


def _flippable(points: Float[np.ndarray, "n 3"], edges: Edges, which: Int[np.ndarray, " e"]) -> Bool[np.ndarray, " e"]:
    """Which edges can be flipped without duplicating another edge or bending the surface."""
    a, b, c, d = (ends[which] for ends in (edges.a, edges.b, edges.c, edges.d))
    key = edge_key(c, d, len(points))
    position = np.searchsorted(edges.key, key).clip(max=len(edges.key) - 1)
    free = edges.key[position] != key
    old = [face_vectors(points[np.stack(corners, axis=1)]) for corners in ((a, b, c), (b, a, d))]
    new = [face_vectors(points[np.stack(corners, axis=1)]) for corners in ((a, d, c), (d, b, c))]
    bend = np.min([_cosines(before, after) for before in old for after in new], axis=0)
    return np.asarray(free & (bend >= _FLIP_COSINE))


def _cosines(u: Float[np.ndarray, "n 3"], v: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
    """The cosine of the angle between vectors; 0 where one is zero."""
    squares = np.einsum("nk,nk->n", u, u) * np.einsum("nk,nk->n", v, v)
    return np.asarray(np.einsum("nk,nk->n", u, v) / np.sqrt(np.where(squares > 0, squares, 1.0)))
