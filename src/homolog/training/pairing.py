"""Which samples of a cloud and of its mesh belong together, where the cloud's points are not the mesh's."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sparse
import torch
from jaxtyping import Int
from torch import Tensor


def nearest_columns(weights: sparse.csr_array) -> Int[np.ndarray, " s"]:
    """The points of a mesh of which each has the largest weight at some point of a cloud.

    Args:
        weights: barycentric weights of each cloud point at the mesh's points (n_cloud, n_mesh).
    """
    nearest: np.ndarray = np.unique(weights.argmax(axis=1))
    return nearest


def nearest_rows(weights: sparse.csr_array, columns: Int[np.ndarray, " s"]) -> Int[np.ndarray, " r"]:
    """For each of these points of a mesh the point of a partial cloud that lies nearest, if it is nearest to one.

    Args:
        weights: barycentric weights of each cloud point at the mesh's points (n_cloud, n_mesh).
        columns: points of the mesh.
    """
    nearest, largest = weights.argmax(axis=1), weights.max(axis=1).toarray().ravel()
    order = np.lexsort((-largest, nearest))
    _, first = np.unique(nearest[order], return_index=True)
    rows: np.ndarray = np.sort(order[first])
    return rows[np.isin(nearest[rows], columns)]


def interpolation(weights: sparse.csr_array) -> Tensor:
    """Weights of a mesh's points at a cloud's as a sparse tensor, each row of sum one."""
    weights = weights.multiply(1 / weights.sum(axis=1)[:, None]).tocoo()
    indices = torch.from_numpy(np.stack([weights.row, weights.col]).astype(np.int64))
    values = torch.from_numpy(weights.data).float()
    return torch.sparse_coo_tensor(indices, values, weights.shape, check_invariants=False)
