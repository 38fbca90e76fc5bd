"""Normals, tangent frames, and gradient operators in these frames."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sparse
from jaxtyping import Float, Int
from scipy.spatial import KDTree

# Keeps the least-squares gradient bounded where a point's neighbours lie on a line; in squared units of the shape,
# which has unit area. The published weights were trained with this value.
_GRADIENT_REGULARISATION = 1e-5


def mesh_normals(points: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"]) -> Float[np.ndarray, "n 3"]:
    """Unit normal per point: the mean of its faces' unit normals."""
    corners = points[faces]
    face_normals = _unit(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
    summed = [np.bincount(faces.ravel(), np.repeat(face_normals[:, axis], 3), len(points)) for axis in range(3)]
    normals = np.stack(summed, axis=1)
    # The normals of a fold can cancel; any direction will do there, as the frame is free anyway.
    normals[np.linalg.norm(normals, axis=1) < 1e-6] = (0.0, 0.0, 1.0)
    return _unit(normals)


def scatter_of(points: Float[np.ndarray, "n 3"], neighbours: Int[np.ndarray, "n j"]) -> Float[np.ndarray, "n 3 3"]:
    """How each point's neighbours spread around it: the sum of the outer products of the edges to them."""
    edges = points.take(neighbours, axis=0) - points[:, None]
    scatter: np.ndarray = edges.transpose(0, 2, 1) @ edges
    return scatter


def normals_of(scatter: Float[np.ndarray, "n 3 3"]) -> Float[np.ndarray, "n 3"]:
    """Unit normal per point of a cloud: the direction in which its neighbours spread least around it.

    Either sign would do; it is the one that LAPACK gives.
    """
    _, directions = np.linalg.eigh(scatter)
    return directions[:, :, 0]


def turned_scatter(
    scatter: Float[np.ndarray, "n 3 3"], rotation: Float[np.ndarray, "3 3"]
) -> tuple[Float[np.ndarray, "n 3 3"], Float[np.ndarray, " n"]]:
    """The scatter of a cloud in another pose, and which of its normals are then of the other sign.

    A cloud does not tell out from in, so that the sign of a normal follows from its direction. Networks learn what it
    is on upright shapes: on a shape that is turned upright, it has to be what it would be there.

    Returns:
        The scatter (n, 3, 3), and for each point -1 if its normal is turned round, or 1 (n,).
    """
    if np.array_equal(rotation, np.eye(3)):  # as most shapes stand
        return scatter, np.ones(len(scatter))
    there = rotation @ scatter @ rotation.T
    agreement = np.einsum("nj,nj->n", normals_of(scatter) @ rotation.T, normals_of(there))
    return there, np.where(agreement < 0, -1.0, 1.0)


def nearest_neighbours(points: Float[np.ndarray, "n 3"], n_neighbours: int) -> Int[np.ndarray, "n j"]:
    """Indices of each point's nearest other points, nearest first."""
    n_neighbours = min(n_neighbours, len(points) - 1)
    _, indices = KDTree(points).query(points, k=n_neighbours + 1, workers=-1)
    # Where points coincide, the point itself need not come first.
    rows = np.arange(len(points))[:, None]
    order = np.argsort(indices != rows, axis=1, kind="stable")
    return np.take_along_axis(indices, order, axis=1)[:, 1:]


def tangent_frames(normals: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3 3"]:
    """Right-handed orthonormal frames; rows are the two tangent directions, then the normal."""
    helper = np.eye(3)[np.argmin(np.abs(normals), axis=1)]
    first = _unit(np.cross(normals, helper))
    return np.stack([first, np.cross(normals, first), normals], axis=1)


def mesh_edges(faces: Int[np.ndarray, "m 3"]) -> tuple[Int[np.ndarray, " e"], Int[np.ndarray, " e"]]:
    """Start and end of every edge of the mesh, in both directions, each once, sorted by start, then end."""
    one, other = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    return _unique_pairs(np.concatenate([one, other]), np.concatenate([other, one]))


def gradient_matrices(
    points: Float[np.ndarray, "n 3"],
    frames: Float[np.ndarray, "n 3 3"],
    starts: Int[np.ndarray, " e"],
    ends: Int[np.ndarray, " e"],
) -> tuple[sparse.csr_matrix, sparse.csr_matrix]:
    """Matrices (n, n) that take a function to its gradient's two components in the tangent frames.

    Per point, the least-squares fit of the differences along its edges (Sharp et al., "DiffusionNet", 2022, section
    3.3), solved in closed form for all points together. Both matrices have the same sparsity pattern.
    """
    n = len(points)
    # An edge from each point to itself, which adds nothing to the fit, makes room for the diagonal.
    own = np.arange(n)
    starts, ends = _unique_pairs(np.concatenate([starts, own]), np.concatenate([ends, own]))
    edges = points.take(ends, axis=0) - points.take(starts, axis=0)
    x = np.einsum("ej,ej->e", edges, frames[:, 0].take(starts, axis=0))
    y = np.einsum("ej,ej->e", edges, frames[:, 1].take(starts, axis=0))
    xx = np.bincount(starts, x * x, n) + _GRADIENT_REGULARISATION
    yy = np.bincount(starts, y * y, n) + _GRADIENT_REGULARISATION
    xy = np.bincount(starts, x * y, n)
    inverse = np.stack([yy, -xy, xx]) / (xx * yy - xy * xy)
    to_xx, to_xy, to_yy = inverse.take(starts, axis=1)
    return _differences(to_xx * x + to_xy * y, starts, ends, n), _differences(to_xy * x + to_yy * y, starts, ends, n)


def _differences(
    weights: Float[np.ndarray, " e"], starts: Int[np.ndarray, " e"], ends: Int[np.ndarray, " e"], n: int
) -> sparse.csr_matrix:
    """The matrix of f -> sum over a point's edges of weight * (f[end] - f[start]); edges as ``_unique_pairs`` has them.

    One of each point's edges leads to itself.
    """
    values = weights.copy()
    values[starts == ends] -= np.bincount(starts, weights, n)
    return sparse.csr_matrix((values, ends, np.searchsorted(starts, np.arange(n + 1))), shape=(n, n))


def _unique_pairs(
    starts: Int[np.ndarray, " p"], ends: Int[np.ndarray, " p"]
) -> tuple[Int[np.ndarray, " e"], Int[np.ndarray, " e"]]:
    """Each pair of indices once, sorted."""
    # A pair is one number meanwhile, and sorted by np.sort: np.unique takes twenty times as long, and more for rows.
    base = int(ends.max(initial=0)) + 1
    pairs = np.sort(starts.astype(np.int64) * base + ends)
    first, second = np.divmod(pairs[np.diff(pairs, prepend=-1) > 0], base)
    return first, second


def _unit(vectors: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    scales = np.linalg.norm(vectors, axis=1, keepdims=True)
    return vectors / np.where(scales > 0, scales, 1.0)
