"""Nearest neighbours between rows, tile by tile."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from homolog.arrays import takes_arrays
from homolog.memory import row_tiles


@dataclass(frozen=True)
class Nearest:
    """For each query its nearest candidate, and how near.

    Args:
        index: candidate indices (n,), int64.
        value: squared distances, or inner products (n,).
    """

    index: Int[Tensor, " n"]
    value: Float[Tensor, " n"]


@takes_arrays
def nearest_neighbour(queries: Float[Tensor, "n d"], candidates: Float[Tensor, "m d"]) -> Nearest:
    """The candidate at the least Euclidean distance from each query, with the squared distance.

    Costs 2 n m d operations as matrix products; temporary memory stays within ``homolog.set_working_memory``.
    """
    # Around a common centre the squared norms are small, and less is lost in |q|^2 - 2 q c + |c|^2.
    centre = candidates.mean(dim=0)
    queries, candidates = queries - centre, candidates - centre
    nearest = _largest_product(queries, candidates, -0.5 * candidates.square().sum(dim=1))
    squared = queries.square().sum(dim=1) - 2 * nearest.value
    return Nearest(nearest.index, squared.clamp(min=0))


@takes_arrays
def most_similar(queries: Float[Tensor, "n d"], candidates: Float[Tensor, "m d"]) -> Nearest:
    """The candidate with the greatest inner product with each query, with that product."""
    return _largest_product(queries, candidates, candidates.new_zeros(len(candidates)))


def _largest_product(
    queries: Float[Tensor, "n d"], candidates: Float[Tensor, "m d"], offsets: Float[Tensor, " m"]
) -> Nearest:
    index = torch.empty(len(queries), dtype=torch.int64, device=queries.device)
    value = queries.new_empty(len(queries))
    transposed = candidates.T
    for rows in row_tiles(len(queries), bytes_per_row=len(candidates) * queries.element_size()):
        products = torch.addmm(offsets, queries[rows], transposed)
        torch.max(products, dim=1, out=(value[rows], index[rows]))
    return Nearest(index, value)
