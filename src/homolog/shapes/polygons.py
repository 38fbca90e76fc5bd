"""Triangulating polygons: the one way in which every format's polygons become triangles."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

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
    # Nearly all are quadrilaterals, which the other diagonal splits as well as ears do.
    quads = folded[sizes[folded] == 4]
    split = first_corner[quads][:, None, None] + _OTHER_DIAGONAL
    triangles[first_triangle[quads][:, None] + [0, 1]] = split
    of_quad = np.repeat(np.arange(len(quads)), 2)
    still = quads[_folded(points, corners[split.reshape(-1, 3)], of_quad, sizes[quads])]
    left = np.concatenate([folded[sizes[folded] != 4], still])
    at = _ranges(first_corner[left], sizes[left])
    triangles[_ranges(first_triangle[left], n_triangles[left])] = at[_ears(points, corners[at], sizes[left])]
    return triangles


def _ranges(starts: Int[np.ndarray, " m"], sizes: Int[np.ndarray, " m"]) -> Int[np.ndarray, " c"]:
    """The numbers from each start on, so many each, one range after the other."""
    return np.repeat(starts - (np.cumsum(sizes) - sizes), sizes) + np.arange(sizes.sum())


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


def _ears(
    points: Float[np.ndarray, "n 3"], corners: Int[np.ndarray, " c"], sizes: Int[np.ndarray, " m"]
) -> Int[np.ndarray, "t 3"]:
    """The triangles of polygons by ears, as positions in ``corners``; fans around first corners where ears fail.

    What is not the clipping itself is done for all polygons at once.
    """
    triangles = fans(sizes)
    if not len(sizes):
        return triangles
    rings = points[np.clip(corners, 0, len(points) - 1)]
    starts = np.cumsum(sizes) - sizes
    flat = _in_own_planes(rings, starts, sizes)
    kept, cut_off = _without_spikes(flat, starts, sizes)
    ears = list[Int[np.ndarray, "t 3"]]()
    for ring in kept:
        clipped = mapbox_earcut.triangulate_float64(flat[ring], np.array([len(ring)], dtype=np.uint32))
        ears.append(ring[clipped].reshape(-1, 3))
    lacking = [(found, ring) for found, ring in zip(ears, kept, strict=True) if len(found) < len(ring) - 2]
    found = np.concatenate([*ears, cut_off, *([_flat_triangles(*zip(*lacking, strict=True))] if lacking else [])])
    # In the order of the polygons, of which those have all that have enough.
    of_polygon = np.searchsorted(starts, found[:, 0], side="right") - 1
    order = np.argsort(of_polygon, kind="stable")
    all_found = np.bincount(of_polygon, minlength=len(sizes)) == sizes - 2
    all_found &= np.logical_and.reduceat((corners >= 0) & (corners < len(points)), starts)
    triangles[np.repeat(all_found, sizes - 2)] = found[order[all_found[of_polygon[order]]]]
    return triangles


def _in_own_planes(
    rings: Float[np.ndarray, "c 3"], starts: Int[np.ndarray, " m"], sizes: Int[np.ndarray, " m"]
) -> Float[np.ndarray, "c 2"]:
    """Polygons seen from the side from which they run counterclockwise, about one unit wide."""
    after = np.arange(1, len(rings) + 1)
    after[starts + sizes - 1] = starts
    with np.errstate(all="ignore"):
        rings = rings - np.repeat(rings[starts], sizes, axis=0)
        rings /= np.repeat(np.maximum.reduceat(np.abs(rings).max(axis=1), starts), sizes)[:, None]
        normal = np.add.reduceat(np.cross(rings, rings[after]), starts)
        along = np.cross(normal, np.eye(3)[np.abs(normal).argmin(axis=1)])
        axes = np.stack([along, np.cross(normal, along)], axis=1)
        axes /= np.linalg.norm(axes, axis=2, keepdims=True)
        flat: np.ndarray = np.einsum("cj,caj->ca", rings, np.repeat(axes, sizes, axis=0))
    return flat


def _without_spikes(
    flat: Float[np.ndarray, "c 2"], starts: Int[np.ndarray, " m"], sizes: Int[np.ndarray, " m"]
) -> tuple[list[Int[np.ndarray, " k"]], Int[np.ndarray, "s 3"]]:
    """The corners of each polygon without those at which its outline turns back, and the triangles cut off so.

    Corners that repeat the one before are among them. Ears know nothing of either.
    """
    everything, cut_off = np.arange(len(flat)), list[tuple[int, int, int]]()
    after, before = everything + 1, everything - 1
    after[starts + sizes - 1], before[starts] = starts, starts + sizes - 1
    back = _turns_back(*(flat - flat[before]).T, *(flat[after] - flat).T)
    spiky = np.logical_or.reduceat(back, starts).tolist()
    kept = list[Int[np.ndarray, " k"]]()
    for start, end, is_spiky in zip(starts.tolist(), (starts + sizes).tolist(), spiky, strict=True):
        kept.append(_without_own_spikes(flat, range(start, end), cut_off) if is_spiky else everything[start:end])
    return kept, np.array(cut_off, dtype=np.int64).reshape(-1, 3)


def _without_own_spikes(
    flat: Float[np.ndarray, "c 2"], ring: range, cut_off: list[tuple[int, int, int]]
) -> Int[np.ndarray, " k"]:
    """The corners of one polygon without spikes; what is cut off is appended."""
    places, kept = flat[ring.start : ring.stop].tolist(), list[int]()

    def back(*corners: int) -> bool:
        (u, v), (s, t), (x, y) = (places[corner - ring.start] for corner in corners)
        return bool(_turns_back(s - u, t - v, x - s, y - t))

    for corner in ring:
        while len(kept) > 1 and back(kept[-2], kept[-1], corner):
            cut_off.append((kept[-2], kept.pop(), corner))
        kept.append(corner)
    # The ends of the list are neighbours as well.
    while len(kept) > 3 and back(kept[-2], kept[-1], kept[0]):
        cut_off.append((kept[-2], kept.pop(), kept[0]))
    while len(kept) > 3 and back(kept[-1], kept[0], kept[1]):
        cut_off.append((kept[-1], kept.pop(0), kept[0]))
    return np.array(kept)


def _turns_back(u: Any, v: Any, s: Any, t: Any) -> Any:
    """Whether an outline that runs along (u, v) goes on the other way round, along (s, t); of numbers or arrays."""
    cross, along = u * t - v * s, u * s + v * t
    return (along <= 0) & (cross**2 <= _ROUNDING * (u * u + v * v) * (s * s + t * t))


def _flat_triangles(
    ears: Sequence[Int[np.ndarray, "t 3"]], rings: Sequence[Int[np.ndarray, " k"]]
) -> Int[np.ndarray, "f 3"]:
    """Triangles without area where ears have left out repeated corners, or ones on a line, so that no gap opens.

    The edges that have no partner among the ears and the polygons' outlines run round what is left out.
    """
    triangles, corners, lengths = np.concatenate(ears), np.concatenate(rings), np.array([len(ring) for ring in rings])
    ends = np.roll(corners, -1)
    ends[np.cumsum(lengths) - 1] = corners[np.cumsum(lengths) - lengths]
    # Outlines as they run, triangles the other way round: what lies on both sides cancels.
    reversed_edges = [triangles[:, [(i + 1) % 3, i]] for i in range(3)]
    edges = np.concatenate([np.stack([corners, ends], axis=1), *reversed_edges])
    undirected, of_edge = np.unique(np.sort(edges, axis=1), axis=0, return_inverse=True)
    net = np.bincount(of_edge.reshape(-1), np.where(edges[:, 0] < edges[:, 1], 1, -1), len(undirected))
    after: dict[int, list[int]] = {}
    for start, end in sorted([*undirected[net > 0].tolist(), *undirected[net < 0][:, ::-1].tolist()]):
        after.setdefault(start, []).append(end)
    found = list[tuple[int, int, int]]()
    for first in list(after):
        while after[first]:
            loop = [first]
            while after.get(loop[-1]) and (len(loop) == 1 or loop[-1] != first):
                loop.append(after[loop[-1]].pop())
            found += [(first, b, c) for b, c in pairwise(loop[1:-1])]
    return np.array(found, dtype=np.int64).reshape(-1, 3)
