"""Splitting, collapsing and flipping the edges of closed meshes, many edges at once.

The operations are those of M. Botsch and L. Kobbelt, "A remeshing approach to multiresolution modeling" (SGP 2004).
Edges that are changed together lie so far apart that none notices the others; sweeps repeat until none is left.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import csr_matrix

from homolog.geometry.grouping import FacesAround
from homolog.shapes import face_vectors

# Edges longer or shorter than this, relative to the length wanted, are split or collapsed.
LONG, SHORT = 4.0 / 3.0, 4.0 / 5.0
# How far a triangle may turn, as a cosine, when an edge is collapsed or flipped.
_COLLAPSE_COSINE = 0.4
_FLIP_COSINE = 0.6
# Sweeps end when fewer edges than this, relative to the vertices, are left to change; the next round takes them.
_FEW = 0.002
_SWEEPS = 40


@dataclass(frozen=True)
class Draft:
    """A closed manifold mesh in the making.

    Args:
        points: the vertices' positions.
        space: where lengths and angles are measured: the positions, or, for stretched triangles, squeezed ones.
        lengths: the edge length wanted at each vertex.
        faces: three vertices a triangle.
    """

    points: Float[np.ndarray, "n 3"]
    space: Float[np.ndarray, "n k"]
    lengths: Float[np.ndarray, " n"]
    faces: Int[np.ndarray, "m 3"]

    def relative_lengths(self, a: Int[np.ndarray, " e"], b: Int[np.ndarray, " e"]) -> Float[np.ndarray, " e"]:
        """How far pairs of vertices are apart, as a multiple of what is wanted there."""
        apart = np.linalg.norm(self.space[a] - self.space[b], axis=1)
        return np.asarray(2.0 * apart / (self.lengths[a] + self.lengths[b]))


@dataclass(frozen=True)
class Edges:
    """Every edge of a closed manifold mesh once.

    Args:
        a: its first end; the edge runs from a to b in the first of its two triangles.
        b: its second end.
        c: the vertex across in the first triangle, (a, b, c).
        d: the vertex across in the second triangle, (b, a, d).
        first: the first triangle.
        second: the second triangle.
        key: tells edges apart by their ends, in ascending order.
    """

    a: Int[np.ndarray, " e"]
    b: Int[np.ndarray, " e"]
    c: Int[np.ndarray, " e"]
    d: Int[np.ndarray, " e"]
    first: Int[np.ndarray, " e"]
    second: Int[np.ndarray, " e"]
    key: Int[np.ndarray, " e"]


def edge_key(a: Int[np.ndarray, " e"], b: Int[np.ndarray, " e"], n_vertices: int) -> Int[np.ndarray, " e"]:
    """A number for each unordered pair of vertices."""
    return np.asarray(np.minimum(a, b) * n_vertices + np.maximum(a, b))


def edges_of(faces: Int[np.ndarray, "m 3"], n_vertices: int) -> Edges:
    """The edges of a closed manifold mesh."""
    start, end, across = faces.ravel(), faces[:, [1, 2, 0]].ravel(), faces[:, [2, 0, 1]].ravel()
    key = edge_key(start, end, n_vertices)
    first, second = np.argsort(key, kind="stable").reshape(-1, 2).T
    return Edges(start[first], end[first], across[first], across[second], first // 3, second // 3, key[first])


def split_long(draft: Draft) -> Draft:
    """Put a vertex in the middle of every edge that is too long; its triangles become two, three or four."""
    edges = edges_of(draft.faces, len(draft.points))
    long = np.flatnonzero(draft.relative_lengths(edges.a, edges.b) > LONG)
    middle = _middles(draft.faces, edges, long, len(draft.points))
    a, b = edges.a[long], edges.b[long]
    return Draft(
        np.concatenate([draft.points, (draft.points[a] + draft.points[b]) / 2]),
        np.concatenate([draft.space, (draft.space[a] + draft.space[b]) / 2]),
        np.concatenate([draft.lengths, (draft.lengths[a] + draft.lengths[b]) / 2]),
        _split_faces(draft.faces, middle),
    )


def _middles(
    faces: Int[np.ndarray, "m 3"], edges: Edges, split: Int[np.ndarray, " s"], n_vertices: int
) -> Int[np.ndarray, "m 3"]:
    """The new vertex on each triangle's sides, side i from corner i to the next; -1 where a side is not split."""
    new = np.full(len(edges.key), -1)
    new[split] = n_vertices + np.arange(len(split))
    sides = edge_key(faces, faces[:, [1, 2, 0]], n_vertices)
    return np.asarray(new[np.searchsorted(edges.key, sides)])


def _split_faces(faces: Int[np.ndarray, "m 3"], middle: Int[np.ndarray, "m 3"]) -> Int[np.ndarray, "s 3"]:
    count = (middle >= 0).sum(axis=1)
    # Turned so that a single split side comes first, and a single whole one last.
    turn = np.where(count == 1, (middle >= 0).argmax(axis=1), ((middle < 0).argmax(axis=1) + 1) % 3)
    columns = (turn[:, None] + np.arange(3)) % 3
    corner, middle = np.take_along_axis(faces, columns, 1), np.take_along_axis(middle, columns, 1)
    (p, q, r), (x, y, z) = corner.T, middle.T
    patterns = (
        (count == 0, ((p, q, r),)),
        (count == 1, ((p, x, r), (x, q, r))),
        (count == 2, ((p, x, r), (x, y, r), (x, q, y))),
        (count == 3, ((p, x, z), (x, q, y), (z, y, r), (x, y, z))),
    )
    return np.concatenate([np.stack(triangle, axis=1)[which] for which, new in patterns for triangle in new])


def collapse_short(draft: Draft) -> Draft:
    """Merge every edge that is too short into its middle, where this folds nothing and makes no long edge."""
    refused = np.zeros(0, dtype=np.int64)
    for _ in range(_SWEEPS):
        edges = edges_of(draft.faces, len(draft.points))
        relative = draft.relative_lengths(edges.a, edges.b)
        short = np.flatnonzero(relative < SHORT)
        short = short[~np.isin(edges.key[short], refused)]
        short = short[np.argsort(relative[short], kind="stable")]
        chosen = _far_apart(draft.faces, edges, short, len(draft.points))
        sound = _collapsible(draft, edges, chosen)
        refused = np.concatenate([refused, edges.key[chosen[~sound]]])
        draft = _collapsed(draft, edges.a[chosen[sound]], edges.b[chosen[sound]])
        if len(chosen) < _FEW * len(draft.points):
            break
    return _compacted(draft)


def _far_apart(
    faces: Int[np.ndarray, "m 3"], edges: Edges, short: Int[np.ndarray, " e"], n_vertices: int
) -> Int[np.ndarray, " s"]:
    """Edges, the first ones given before others, none of which are joined or have a vertex across in common."""
    joined = np.stack([edges.a[short], edges.b[short]], axis=1)
    short = short[_first_of_all_near(faces, joined, n_vertices, rings=1)]
    across = np.stack([edges.c[short], edges.d[short]], axis=1)
    return np.asarray(short[_first_of_all_near(faces, across, n_vertices, rings=0)])


def _collapsible(draft: Draft, edges: Edges, which: Int[np.ndarray, " e"]) -> Bool[np.ndarray, " e"]:
    """Which edges can be merged into their middles."""
    a, b = edges.a[which], edges.b[which]
    valence = np.bincount(draft.faces.ravel(), minlength=len(draft.points))
    sound = np.minimum(valence[edges.c[which]], valence[edges.d[which]]) > 3
    sound &= _common_neighbours(edges, a, b, len(draft.points)) == 2
    edge, face, end = _faces_around(draft.faces, a, b, len(draft.points))
    corners = draft.faces[face]
    moves = corners == end[:, None]
    middle = (draft.points[a] + draft.points[b])[edge] / 2
    before = draft.points[corners]
    after = np.where(moves[..., None], middle[:, None], before)
    turned = _cosines(face_vectors(before), face_vectors(after)) < _COLLAPSE_COSINE
    space = (draft.space[a] + draft.space[b])[edge] / 2
    length = (draft.lengths[a] + draft.lengths[b])[edge] / 2
    reach = np.linalg.norm(draft.space[corners] - space[:, None], axis=2)
    long = (2.0 * reach > LONG * (length[:, None] + draft.lengths[corners])) & ~moves
    spoilt = np.bincount(edge, turned | long.any(axis=1), minlength=len(which))
    return np.asarray(sound & (spoilt == 0))


def _common_neighbours(
    edges: Edges, a: Int[np.ndarray, " e"], b: Int[np.ndarray, " e"], n_vertices: int
) -> Int[np.ndarray, " e"]:
    """How many vertices are joined to both ends of each edge."""
    rows, columns = np.concatenate([edges.a, edges.b]), np.concatenate([edges.b, edges.a])
    joined = csr_matrix((np.ones(len(rows), dtype=np.int32), (rows, columns)), (n_vertices, n_vertices))
    return np.asarray(joined[a].multiply(joined[b]).sum(axis=1)).ravel()


def _faces_around(
    faces: Int[np.ndarray, "m 3"], a: Int[np.ndarray, " e"], b: Int[np.ndarray, " e"], n_vertices: int
) -> tuple[Int[np.ndarray, " q"], Int[np.ndarray, " q"], Int[np.ndarray, " q"]]:
    """Edge, triangle and end for every triangle that has just one end of an edge."""
    ends = np.stack([a, b], axis=1).ravel()
    edge_end, face = FacesAround.of(faces, n_vertices).of_each(ends)
    other = np.stack([b, a], axis=1).ravel()[edge_end]
    alone = (faces[face] != other[:, None]).all(axis=1)
    return edge_end[alone] // 2, face[alone], ends[edge_end[alone]]


def _first_of_all_near(
    faces: Int[np.ndarray, "m 3"], groups: Int[np.ndarray, "e k"], n_vertices: int, *, rings: int
) -> Bool[np.ndarray, " e"]:
    """Which groups of vertices are first, in the order given, among all groups within so many rings of edges."""
    rank = np.full(n_vertices, len(groups))
    np.minimum.at(rank, groups.ravel(), np.repeat(np.arange(len(groups)), groups.shape[1]))
    for _ in range(rings):
        lowest = np.minimum.reduce([rank[corners] for corners in faces.T])
        np.minimum.at(rank, faces.ravel(), np.repeat(lowest, 3))
    return np.asarray((rank[groups] == np.arange(len(groups))[:, None]).all(axis=1))


def _collapsed(draft: Draft, a: Int[np.ndarray, " e"], b: Int[np.ndarray, " e"]) -> Draft:
    """Each b merged into its a, which moves to the middle; the vertices b stay behind, without triangles."""
    points, space, lengths = draft.points.copy(), draft.space.copy(), draft.lengths.copy()
    for values in (points, space, lengths):
        values[a] = (values[a] + values[b]) / 2
    into = np.arange(len(points))
    into[b] = a
    p, q, r = into[draft.faces].T
    kept = (p != q) & (q != r) & (r != p)
    return Draft(points, space, lengths, np.stack([p, q, r], axis=1)[kept])


def _compacted(draft: Draft) -> Draft:
    """Without the vertices that no triangle has."""
    used, faces = np.unique(draft.faces, return_inverse=True)
    return Draft(draft.points[used], draft.space[used], draft.lengths[used], faces.reshape(-1, 3))


def flip_to_delaunay(draft: Draft) -> Draft:
    """Turn edges within their two triangles where the angles across sum to more than a half turn, if that bends little.

    Without the bends this ends in a Delaunay triangulation, whose cotangent Laplacian has no negative weights.
    """
    faces = draft.faces.copy()
    for _ in range(_SWEEPS):
        edges = edges_of(faces, len(draft.points))
        gain = -_cotangents(draft.space, edges)
        wanted = np.flatnonzero(gain > 1e-6)
        wanted = wanted[np.argsort(-gain[wanted], kind="stable")]
        wanted = wanted[_flippable(draft.points, edges, wanted)]
        groups = np.stack([edges.a, edges.b, edges.c, edges.d], axis=1)[wanted]
        chosen = wanted[_first_of_all_near(faces, groups, len(draft.points), rings=0)]
        a, b, c, d = (ends[chosen] for ends in (edges.a, edges.b, edges.c, edges.d))
        faces[edges.first[chosen]] = np.stack([a, d, c], axis=1)
        faces[edges.second[chosen]] = np.stack([d, b, c], axis=1)
        if len(chosen) < _FEW * len(draft.points):
            break
    return replace(draft, faces=faces)


def _cotangents(space: Float[np.ndarray, "n k"], edges: Edges) -> Float[np.ndarray, " e"]:
    """The sum of the cotangents of the two angles across each edge."""
    total = np.zeros(len(edges.a))
    for across in (edges.c, edges.d):
        u, v = space[edges.a] - space[across], space[edges.b] - space[across]
        inner = np.einsum("ek,ek->e", u, v)
        square = np.einsum("ek,ek->e", u, u) * np.einsum("ek,ek->e", v, v) - inner**2
        total += inner / np.sqrt(square.clip(1e-30))
    return total


def _flippable(points: Float[np.ndarray, "n 3"], edges: Edges, which: Int[np.ndarray, " e"]) -> Bool[np.ndarray, " e"]:
    """Which edges can be turned without doubling another edge or bending the surface."""
    a, b, c, d = (ends[which] for ends in (edges.a, edges.b, edges.c, edges.d))
    key = edge_key(c, d, len(points))
    place = np.searchsorted(edges.key, key).clip(max=len(edges.key) - 1)
    free = edges.key[place] != key
    old = [face_vectors(points[np.stack(corners, axis=1)]) for corners in ((a, b, c), (b, a, d))]
    new = [face_vectors(points[np.stack(corners, axis=1)]) for corners in ((a, d, c), (d, b, c))]
    bend = np.min([_cosines(before, after) for before in old for after in new], axis=0)
    return np.asarray(free & (bend >= _FLIP_COSINE))


def _cosines(u: Float[np.ndarray, "n 3"], v: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
    """The cosine of the angle between directions, 0 where one has no length."""
    squares = np.einsum("nk,nk->n", u, u) * np.einsum("nk,nk->n", v, v)
    return np.asarray(np.einsum("nk,nk->n", u, v) / np.sqrt(np.where(squares > 0, squares, 1.0)))
