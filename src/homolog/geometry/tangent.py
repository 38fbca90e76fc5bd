"""Normals, tangent frames, and gradients of functions expressed in them."""

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


def cloud_normals(points: Float[np.ndarray, "n 3"], neighbours: Int[np.ndarray, "n j"]) -> Float[np.ndarray, "n 3"]:
    """Unit normal per point, of either sign: the direction in which its neighbours spread least around it."""
    edges = points[neighbours] - points[:, None]
    _, directions = np.linalg.eigh(np.einsum("nji,njk->nik", edges, edges))
    return directions[:, :, 0]


def nearest_neighbours(points: Float[np.ndarray, "n 3"], n_neighbours: int) -> Int[np.ndarray, "n j"]:
    """Indices of each point's nearest other points, nearest first."""
    n_neighbours = min(n_neighbours, len(points) - 1)
    _, indices = KDTree(points).query(points, k=n_neighbours + 1)
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
    """Start and end of every edge of the mesh, in both directions, each once."""
    pairs = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    pairs = np.unique(np.concatenate([pairs, pairs[:, ::-1]]), axis=0)
    return pairs[:, 0], pairs[:, 1]


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
    edges = points[ends] - points[starts]
    x = np.einsum("ej,ej->e", edges, frames[starts, 0])
    y = np.einsum("ej,ej->e", edges, frames[starts, 1])
    xx = np.bincount(starts, x * x, n) + _GRADIENT_REGULARISATION
    yy = np.bincount(starts, y * y, n) + _GRADIENT_REGULARISATION
    xy = np.bincount(starts, x * y, n)
    determinant = (xx * yy - xy * xy)[starts]
    along_x = (yy[starts] * x - xy[starts] * y) / determinant
    along_y = (xx[starts] * y - xy[starts] * x) / determinant
    return _differences(along_x, starts, ends, n), _differences(along_y, starts, ends, n)


def _differences(
    weights: Float[np.ndarray, " e"], starts: Int[np.ndarray, " e"], ends: Int[np.ndarray, " e"], n: int
) -> sparse.csr_matrix:
    """The matrix of f -> sum over a point's edges of weight * (f[end] - f[start])."""
    own = np.arange(n)
    values = np.concatenate([weights, -np.bincount(starts, weights, n)])
    rows, columns = np.concatenate([starts, own]), np.concatenate([ends, own])
    return sparse.csr_matrix((values, (rows, columns)), shape=(n, n))


def _unit(vectors: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    return vectors / np.where(lengths > 0, lengths, 1.0)
