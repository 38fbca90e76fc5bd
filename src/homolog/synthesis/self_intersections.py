"""Self-intersections of triangle meshes."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from homolog.geometry.surface import Surface
from homolog.shapes import face_vectors

_Pairs = Int[np.ndarray, "p 2"]


def self_intersection_share(surface: Surface, *, by_area: bool = False) -> float:
    """The share of a mesh's triangles that intersect another one, from 0 to 1, by number or by area."""
    weights = np.linalg.norm(surface.face_vectors, axis=1) if by_area else np.ones(len(surface.faces))
    return float(weights[self_intersecting_faces(surface)].sum() / weights.sum())


def self_intersecting_faces(surface: Surface) -> Bool[np.ndarray, " m"]:
    """Which triangles intersect another triangle of the mesh; contacts and coplanar overlaps do not count.

    The signs of tetrahedra's volumes tell whether an edge passes through a triangle.
    """
    triangles = surface.vertices[surface.faces]
    found = np.zeros(len(triangles), dtype=bool)
    pairs = _overlapping(triangles)
    common = (surface.faces[pairs[:, 0], :, None] == surface.faces[pairs[:, 1], None, :]).sum(axis=(1, 2))
    pairs = pairs[common < 2]  # neighbours along an edge cannot cross
    pairs = pairs[_straddles(triangles, pairs[:, 0], pairs[:, 1])]
    pairs = pairs[_straddles(triangles, pairs[:, 1], pairs[:, 0])]
    for s, t in (pairs.T, pairs.T[::-1]):
        hit = _edge_hits(surface, s, t)
        found[s[hit]] = found[t[hit]] = True
    return found


def _overlapping(triangles: Float[np.ndarray, "m 3 3"]) -> _Pairs:
    """Pairs of triangles whose bounding boxes overlap, searched among triangles of similar size."""
    middles = triangles.mean(axis=1)
    radii = np.linalg.norm(triangles - middles[:, None], axis=2).max(axis=1)
    sizes = np.floor(np.log2(radii.clip(1e-9)))
    classes = [np.flatnonzero(sizes == size) for size in np.unique(sizes)]
    found = [_close(middles, radii, smaller, larger) for i, smaller in enumerate(classes) for larger in classes[i:]]
    pairs = np.concatenate(found)
    low, high = triangles.min(axis=1), triangles.max(axis=1)
    s, t = pairs.T
    return np.asarray(pairs[((low[s] < high[t]) & (low[t] < high[s])).all(axis=1)])


def _close(
    middles: Float[np.ndarray, "m 3"],
    radii: Float[np.ndarray, " m"],
    smaller: Int[np.ndarray, " s"],
    larger: Int[np.ndarray, " l"],
) -> _Pairs:
    """Pairs of triangles of two size classes whose bounding spheres may intersect, each pair once."""
    reach = radii[smaller].max() + radii[larger].max()
    tree = cKDTree(middles[larger])
    if smaller is larger:
        return np.asarray(larger[tree.query_pairs(reach, output_type="ndarray")].reshape(-1, 2))
    near = cKDTree(middles[smaller]).sparse_distance_matrix(tree, reach, output_type="ndarray")
    return np.stack([smaller[near["i"]], larger[near["j"]]], axis=1)


def _straddles(
    triangles: Float[np.ndarray, "m 3 3"], s: Int[np.ndarray, " p"], t: Int[np.ndarray, " p"]
) -> Bool[np.ndarray, " p"]:
    """Which triangles t have corners on both sides of the plane of triangle s."""
    heights = np.einsum("pck,pk->pc", triangles[t] - triangles[s, :1], face_vectors(triangles[s]))
    return np.asarray((heights.min(axis=1) < 0) & (heights.max(axis=1) > 0))


def _edge_hits(surface: Surface, s: Int[np.ndarray, " p"], t: Int[np.ndarray, " p"]) -> Bool[np.ndarray, " p"]:
    """Which triangles s an edge of t passes through; edges that end in a corner of s are left out."""
    corners = np.moveaxis(surface.vertices[surface.faces[s]], 1, 0)
    hit = np.zeros(len(s), dtype=bool)
    for i in range(3):
        ends = surface.faces[t][:, [i, (i + 1) % 3]]
        apart = (ends[:, :, None] != surface.faces[s][:, None, :]).all(axis=(1, 2))
        hit |= apart & _segment_meets(*corners, *np.moveaxis(surface.vertices[ends], 1, 0))
    return hit


def _segment_meets(p: np.ndarray, q: np.ndarray, r: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Whether the segment from a to b passes through triangle p, q, r, by the signs of five volumes."""
    ends_apart = _volume(p, q, r, a) * _volume(p, q, r, b) < 0
    sides = np.sign([_volume(a, b, p, q), _volume(a, b, q, r), _volume(a, b, r, p)])
    return np.asarray(ends_apart & (np.abs(sides.sum(axis=0)) == 3))


def _volume(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Six times the signed volume of a tetrahedron."""
    return np.asarray(np.einsum("pk,pk->p", np.cross(b - a, c - a), d - a))
