"""Nearest neighbours between rows of two matrices, tile by tile, within the working memory."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Generic

import torch
from jaxtyping import Float, Int
from torch import Tensor

from homolog.core.arrays import Array, takes_arrays
from homolog.core.memory import row_tiles
from homolog.core.reprs import short_repr


@dataclass(frozen=True)
class Nearest(Generic[Array]):
    """For each query its nearest candidate, and how near.

    Args:
        index: candidate indices (n,), int64.
        value: squared distances, or inner products (n,).

    Examples:
        >>> import torch
        >>> from homolog.maps import Nearest, nearest_neighbour
        >>> found: Nearest[torch.Tensor] = nearest_neighbour(torch.eye(3), torch.eye(3))
        >>> found
        Nearest(index=[0, 1, 2], value=[0, 0, 0])
    """

    index: Int[Array, " n"]
    value: Float[Array, " n"]

    __repr__ = short_repr


@takes_arrays
def nearest_neighbour(queries: Float[Tensor, "n d"], candidates: Float[Tensor, "m d"]) -> Nearest[Tensor]:
    """Nearest neighbour in Euclidean distance: for each query its candidate, with the squared distance.

    Costs 2 n m d operations as matrix products; temporary memory stays within ``homolog.set_working_memory``.

    Args:
        queries: a row each (n, d).
        candidates: likewise (m, d).

    Returns:
        Indices and squared distances; the first of equally near candidates.

    Examples:
        >>> import numpy as np
        >>> from homolog.maps import nearest_neighbour
        >>> nearest = nearest_neighbour(np.array([[0.9], [5.0]]), np.array([[0.0], [1.0], [3.0]]))
        >>> nearest.index, nearest.value.round(2)
        (array([1, 2]), array([0.01, 4. ]))

    See Also:
        ``most_similar`` for inner products.
    """
    # Around a common centre the squared norms are small, and less is lost in |q|^2 - 2 q c + |c|^2.
    centre = candidates.mean(dim=0)
    queries, candidates = queries - centre, candidates - centre
    nearest = _largest_product(queries, candidates, -0.5 * candidates.square().sum(dim=1))
    squared = queries.square().sum(dim=1) - 2 * nearest.value
    return Nearest(nearest.index, squared.clamp(min=0))


@takes_arrays
def most_similar(queries: Float[Tensor, "n d"], candidates: Float[Tensor, "m d"]) -> Nearest[Tensor]:
    """Nearest neighbour in cosine similarity, for unit features: the candidate with the greatest inner product.

    Args:
        queries: a row each (n, d).
        candidates: likewise (m, d).

    Returns:
        Indices and inner products; the first of equally similar candidates.

    Examples:
        >>> import numpy as np
        >>> from homolog.maps import most_similar
        >>> most_similar(np.array([[1.0, 0.1]]), np.eye(2)).index
        array([0])
    """
    return _largest_product(queries, candidates)


def _largest_product(
    queries: Float[Tensor, "n d"], candidates: Float[Tensor, "m d"], offsets: Float[Tensor, " m"] | None = None
) -> Nearest[Tensor]:
    if offsets is not None:  # as one more dimension, so that adding them costs no pass over the products
        queries = torch.cat([queries, torch.ones_like(queries[:, :1])], dim=1)
        candidates = torch.cat([candidates, offsets[:, None]], dim=1)
    index = torch.empty(len(queries), dtype=torch.int64, device=queries.device)
    value = queries.new_empty(len(queries))
    tiles = list(row_tiles(len(queries), bytes_per_row=len(candidates) * queries.element_size()))
    # One buffer for all tiles: fresh memory costs as much as the products themselves.
    scratch = queries.new_empty(tiles[0].stop if tiles else 0, len(candidates))
    for rows in tiles:
        products = torch.mm(queries[rows], candidates.T, out=scratch[: rows.stop - rows.start])
        index[rows] = row_argmax(products)
        value[rows] = products.gather(1, index[rows, None])[:, 0]
    return Nearest(index, value)


def row_argmax(values: Float[Tensor, "t m"]) -> Int[Tensor, " t"]:
    """The column of the largest entry of each row, the first of equal ones.

    Finding where a maximum lies is several times slower than finding it. So the maxima of stretches of each row are
    found first, then the stretch, then the column within.
    """
    width = math.isqrt(values.shape[1])
    covered = values.shape[1] - values.shape[1] % width
    stretches = values[:, :covered].view(len(values), -1, width)
    largest, stretch = stretches.amax(dim=2).max(dim=1)
    found: Tensor = stretch * width + stretches[torch.arange(len(values), device=values.device), stretch].argmax(dim=1)
    if covered == values.shape[1]:
        return found
    last, where = values[:, covered:].max(dim=1)
    index: Tensor = torch.where(last > largest, covered + where, found)
    return index


class ColumnArgmax:
    """The row of the largest entry of each column, over row tiles that come one after another."""

    def __init__(self, like: Float[Tensor, " m"]) -> None:
        self.largest = torch.full_like(like, -torch.inf)
        self.index = torch.zeros(len(like), dtype=torch.int64, device=like.device)

    def update(self, rows: slice, tile: Float[Tensor, "t m"]) -> None:
        """Take in the next tile; indices are updated only in columns that got a larger entry."""
        best = tile.amax(dim=0)
        (better,) = torch.nonzero(best > self.largest, as_tuple=True)
        self.largest[better] = best[better]
        self.index[better] = tile[:, better].argmax(dim=0) + rows.start
