"""Faces: their areas, and how they hang together: components, boundaries, and where they are not a surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

# Where a node has many links, components are found of so many of them at first.
_LINKS_AT_FIRST = 4


@dataclass(frozen=True)
class Topology:
    """Counts that describe how a mesh hangs together.

    Args:
        n_components: pieces that share no point.
        n_boundary_loops: closed runs of edges with one face: holes, or the rim of an open surface.
        n_nonmanifold_edges: edges with more than two faces.
        n_nonmanifold_points: points at which several fans of faces touch, without those on such edges.
    """

    n_components: int
    n_boundary_loops: int
    n_nonmanifold_edges: int
    n_nonmanifold_points: int


def topology(faces: Int[np.ndarray, "m 3"], n_points: int) -> Topology:
    """Describe a mesh without repeated corners, in which every point has a face."""
    corner = np.arange(faces.size).reshape(faces.shape)
    # Edge e of a face runs from corner e to the next one; both ends, sorted by the index of the point.
    start, end = corner.ravel(), np.roll(corner, -1, axis=1).ravel()
    point = faces.ravel()
    swap = point[start] > point[end]
    low, high = np.where(swap, end, start), np.where(swap, start, end)
    key = point[low] * n_points + point[high]
    order = np.argsort(key, kind="stable")
    low, high, key = low[order], high[order], key[order]
    edge = np.cumsum(np.diff(key, prepend=key[:1]) > 0)
    faces_of_edge = np.bincount(edge)

    fan = _fans(low, high, edge, faces.size)
    boundary = faces_of_edge[edge] == 1
    rims = components(fan[low[boundary]], fan[high[boundary]], faces.size)
    crowded = faces_of_edge[edge] > 2
    on_crowded = point[np.concatenate([low[crowded], high[crowded]])]
    a_corner = np.empty(fan.max() + 1, dtype=np.int64)
    a_corner[fan] = corner.ravel()
    n_fans = np.bincount(point[a_corner], minlength=n_points)
    n_fans[on_crowded] = 0
    return Topology(
        n_components=len(np.unique(components(faces[:, 0], faces[:, 1], n_points, faces[:, 2]))),
        n_boundary_loops=len(np.unique(rims[fan[low[boundary]]])),
        n_nonmanifold_edges=int(np.sum(faces_of_edge > 2)),
        n_nonmanifold_points=int(np.sum(n_fans > 1)),
    )


def _fans(
    low: Int[np.ndarray, " e"], high: Int[np.ndarray, " e"], edge: Int[np.ndarray, " e"], n_corners: int
) -> Int[np.ndarray, " c"]:
    """For each corner, the fan it belongs to: faces around one point, each sharing an edge with the next."""
    (same,) = np.nonzero(edge[1:] == edge[:-1])
    return components(
        np.concatenate([low[same], high[same]]), np.concatenate([low[same + 1], high[same + 1]]), n_corners
    )


def components(
    a: Int[np.ndarray, " k"], b: Int[np.ndarray, " k"], n: int, c: Int[np.ndarray, " k"] | None = None
) -> Int[np.ndarray, " n"]:
    """A label for each of ``n`` nodes, equal where links a-b (and b-c) lead from one to the other.

    Labels ascend by the first of their nodes.
    """
    rows, columns = (a, b) if c is None else (np.concatenate([a, b]), np.concatenate([b, c]))
    step = len(rows) // (_LINKS_AT_FIRST * max(n, 1))
    if step < 2:
        links = coo_array((np.ones(len(rows)), (rows, columns)), shape=(n, n))
        labels: np.ndarray = connected_components(links.tocsr(), directed=False)[1]
        return labels
    # A part of the links joins nearly all of what all of them join: few are left between what it made.
    first = components(rows[::step], columns[::step], n)
    rows, columns = first[rows], first[columns]
    left = rows != columns
    joined: np.ndarray = components(rows[left], columns[left], int(first.max()) + 1)[first]
    return joined


def mesh_components(
    points: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"]
) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, " p"]]:
    """Components of a mesh, whose faces share points: a label per point (n,), and the areas of components (p,).

    A point that no face uses is a component without area.

    Examples:
        >>> corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [9, 9, 9]])
        >>> component, areas = mesh_components(corners, np.array([[0, 1, 2]]))
        >>> component.tolist(), areas.tolist()
        ([0, 0, 0, 1], [0.5, 0.0])
    """
    component = components(faces[:, 0], faces[:, 1], len(points), faces[:, 2])
    areas = np.bincount(component[faces[:, 0]], face_areas(points, faces), minlength=component.max() + 1)
    return component, areas


def half_edges(faces: Int[np.ndarray, "m 3"]) -> Int[np.ndarray, "h 2"]:
    """The sides of faces, each from its start to its end: those of face i are 3i to 3i + 2.

    Examples:
        >>> half_edges(np.array([[4, 7, 2]])).tolist()
        [[4, 7], [7, 2], [2, 4]]
    """
    return faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)


def face_vectors(triangles: Float[np.ndarray, "m 3 3"]) -> Float[np.ndarray, "m 3"]:
    """The normals of triangles given by their corners, as long as twice their areas."""
    p, q, r = np.moveaxis(triangles, 1, 0)
    return cross_products(q - p, r - p)


def cross_products(one: Float[np.ndarray, "n 3"], other: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Of each row of one with that of the other; the numbers of ``np.cross`` in a tenth of its time.

    Examples:
        >>> cross_products(np.array([[1.0, 0, 0]]), np.array([[0.0, 1, 0]])).tolist()
        [[0.0, 0.0, 1.0]]
    """
    (ax, ay, az), (bx, by, bz) = one.T, other.T
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=1)


def face_areas(points: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"]) -> Float[np.ndarray, " m"]:
    """Area of each face."""
    areas: np.ndarray = np.linalg.norm(face_vectors(points[faces]), axis=1) / 2
    return areas
