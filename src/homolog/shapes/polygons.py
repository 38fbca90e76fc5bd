"""Triangulating polygons: the one way in which every format's polygons become triangles."""

from __future__ import annotations

from itertools import pairwise

import mapbox_earcut
import numpy as np
from jaxtyping import Float, Int

from homolog.shapes.topology import face_vectors

# A triangle looks the other way where its normal opposes the polygon's by more than rounding.
_ROUNDING = 1e-12
# The triangles of a quadrilateral, as positions in it, where the fan around its first corner is none.
_OTHER_DIAGONAL = np.array([[1, 2, 3], [1, 3, 0]])
# Triangles whose normals are held at a time.
_CHUNK = 2**18


def triangulate(
    points: Float[np.ndarray, "n 3"], sizes: Int[np.ndarray, " m"], corners: Int[np.ndarray, " c"]
) -> Int[np.ndarray, "t 3"]:
    """Split polygons into triangles over their own corners, in the order of the polygons.

    A polygon of k corners gives k - 2 triangles: the fan around its first corner where none of these is turned over, as
    in every convex polygon, else the ears that are clipped in the plane of the polygon (mapbox-earcut). Every corner is
    one of a triangle, so that neighbours stay joined.

    Args:
        points: what the corners index.
        sizes: corners of each polygon; those with fewer than three give no triangle.
        corners: the corners of all polygons, one polygon after the other.

    Returns:
        Positions in ``corners``: the triangles are ``corners[triangulate(points, sizes, corners)]``.
    """
    triangles, n_triangles = fans(sizes), np.maximum(sizes - 2, 0)
    first_triangle, first_corner = np.cumsum(n_triangles) - n_triangles, np.cumsum(sizes) - sizes
    polygon = np.repeat(np.arange(len(sizes)), n_triangles)
    folded = _folded(points, corners[triangles], polygon, sizes)
    # Nearly all are quadrilaterals, which the other diagonal splits as well as ears do, many at once.
    quads = folded[sizes[folded] == 4]
    split = first_corner[quads][:, None, None] + _OTHER_DIAGONAL
    triangles[first_triangle[quads][:, None] + [0, 1]] = split
    of_quad = np.repeat(np.arange(len(quads)), 2)
    still = quads[_folded(points, corners[split.reshape(-1, 3)], of_quad, sizes[quads])]
    for one in np.concatenate([folded[sizes[folded] != 4], still]).tolist():
        first, size = first_corner[one], sizes[one]
        ears = _ears(points[corners[first : first + size]])
        triangles[first_triangle[one] : first_triangle[one] + size - 2] = first + ears
    return triangles


def fans(sizes: Int[np.ndarray, " m"]) -> Int[np.ndarray, "t 3"]:
    """The triangles of polygons around their first corners, as positions among all corners."""
    per_polygon = np.maximum(sizes - 2, 0)
    polygon = np.repeat(np.arange(len(sizes)), per_polygon)
    first = (np.cumsum(sizes) - sizes)[polygon]
    step = np.arange(len(polygon)) - (np.cumsum(per_polygon) - per_polygon)[polygon]
    return np.stack([first, first + step + 1, first + step + 2], axis=1)


def strips(sizes: Int[np.ndarray, " m"]) -> Int[np.ndarray, "t 3"]:
    """The triangles of triangle strips, as positions among all corners; every other one is turned round."""
    per_strip = np.maximum(sizes - 2, 0)
    strip = np.repeat(np.arange(len(sizes)), per_strip)
    step = np.arange(len(strip)) - (np.cumsum(per_strip) - per_strip)[strip]
    first, odd = (np.cumsum(sizes) - sizes)[strip] + step, step % 2
    return np.stack([first, first + 1 + odd, first + 2 - odd], axis=1)


def _folded(
    points: Float[np.ndarray, "n 3"],
    triangles: Int[np.ndarray, "t 3"],
    polygon: Int[np.ndarray, " t"],
    sizes: Int[np.ndarray, " m"],
) -> Int[np.ndarray, " w"]:
    """The polygons with a triangle that looks the other way than the polygon as a whole."""
    # Triangles that do not fit the points, or lie at NaN, stay as they are: repair drops them.
    looked_at = (sizes[polygon] > 3) & ((triangles >= 0) & (triangles < len(points))).all(axis=1)
    if not looked_at.any():
        return np.zeros(0, dtype=np.int64)
    polygon = polygon[looked_at]
    with np.errstate(all="ignore"):
        triangles, whole = triangles[looked_at], np.zeros((len(sizes), 3))
        chunks = [slice(start, start + _CHUNK) for start in range(0, len(triangles), _CHUNK)]
        for chunk in chunks:
            normals = face_vectors(points[triangles[chunk]])
            first, last = polygon[chunk][[0, -1]]
            for axis in range(3):
                whole[first : last + 1, axis] += np.bincount(polygon[chunk] - first, normals[:, axis])
        folded, length = list[np.ndarray](), np.einsum("ij,ij->i", whole, whole)
        for chunk in chunks:
            against = -np.einsum("ij,ij->i", face_vectors(points[triangles[chunk]]), whole[polygon[chunk]])
            folded.append(polygon[chunk][against > _ROUNDING * length[polygon[chunk]]])
    return np.unique(np.concatenate(folded))


def _ears(ring: Float[np.ndarray, "k 3"]) -> Int[np.ndarray, "k-2 3"]:
    """The triangles of one polygon, as positions in it; the fan around its first corner where ears fail."""
    flat = _in_own_plane(ring)
    corners, cut_off = _without_spikes(flat)
    found = mapbox_earcut.triangulate_float64(flat[corners], np.array([len(corners)], dtype=np.uint32))
    triangles = np.asarray(found, dtype=np.int64).reshape(-1, 3)
    triangles = corners[np.concatenate([triangles, _flat_triangles(triangles, len(corners))])]
    triangles = np.concatenate([triangles, cut_off])
    return triangles if len(triangles) == len(ring) - 2 else fans(np.array([len(ring)]))


def _without_spikes(ring: Float[np.ndarray, "k 2"]) -> tuple[Int[np.ndarray, " c"], Int[np.ndarray, "s 3"]]:
    """The corners without those at which the outline turns back on itself, and the triangles without area cut off so.

    Corners that repeat the one before are among them. Ears know nothing of either.
    """
    kept, cut_off = list[int](), list[tuple[int, int, int]]()
    for corner in range(len(ring)):
        while len(kept) > 1 and _turns_back(ring, kept[-2], kept[-1], corner):
            cut_off.append((kept[-2], kept.pop(), corner))
        kept.append(corner)
    # The ends of the list are neighbours as well.
    while len(kept) > 3 and _turns_back(ring, kept[-2], kept[-1], kept[0]):
        cut_off.append((kept[-2], kept.pop(), kept[0]))
    while len(kept) > 3 and _turns_back(ring, kept[-1], kept[0], kept[1]):
        cut_off.append((kept[-1], kept.pop(0), kept[0]))
    return np.array(kept), np.array(cut_off, dtype=np.int64).reshape(-1, 3)


def _turns_back(ring: Float[np.ndarray, "k 2"], a: int, b: int, c: int) -> bool:
    (u, v), (s, t) = (ring[b] - ring[a]).tolist(), (ring[c] - ring[b]).tolist()
    cross, along = u * t - v * s, u * s + v * t
    return bool(along <= 0 and cross**2 <= _ROUNDING * (u * u + v * v) * (s * s + t * t))


def _in_own_plane(ring: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, "k 2"]:
    """A polygon seen from the side from which it runs counterclockwise, about one unit wide."""
    ring = (ring - ring[0]) / np.abs(ring - ring[0]).max()
    normal = np.cross(ring, np.roll(ring, -1, axis=0)).sum(axis=0)
    along = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    axes = np.stack([along, np.cross(normal, along)], axis=1)
    return np.ascontiguousarray(ring @ (axes / np.linalg.norm(axes, axis=0)))


def _flat_triangles(triangles: Int[np.ndarray, "t 3"], n_corners: int) -> Int[np.ndarray, "f 3"]:
    """Triangles without area where ears have left out repeated corners, or ones on a line, so that no gap opens.

    The edges that have no partner among the ears and the polygon's outline run round what is left out.
    """
    edges = {(i, (i + 1) % n_corners) for i in range(n_corners)}
    for a, b, c in triangles.tolist():
        for start, end in ((a, b), (b, c), (c, a)):
            if (start, end) in edges:
                edges.remove((start, end))
            else:
                edges.add((end, start))
    after: dict[int, list[int]] = {}
    for start, end in sorted(edges):
        after.setdefault(start, []).append(end)
    found = list[tuple[int, int, int]]()
    while after:
        loop = [next(iter(after))]
        while loop[-1] in after and (len(loop) == 1 or loop[-1] != loop[0]):
            ends = after[loop[-1]]
            loop.append(ends.pop())
            if not ends:
                del after[loop[-2]]
        found += [(loop[0], b, c) for b, c in pairwise(loop[1:-1])]
    return np.array(found, dtype=np.int64).reshape(-1, 3)
