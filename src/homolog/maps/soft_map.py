"""Matches of soft maps between features, read off tile by tile."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic

import torch
from jaxtyping import Float, Int
from torch import Tensor

from homolog.core.arguments import check_finite
from homolog.core.arrays import Array, takes_arrays
from homolog.core.reprs import short_repr
from homolog.maps.nearest import ColumnArgmax, row_argmax
from homolog.maps.sinkhorn import ITERATIONS, TEMPERATURE, balance


@dataclass(frozen=True)
class SoftMatches(Generic[Array]):
    """The matches of a soft map P (n_y, n_x), and the scalings that make it: P = exp(F_y F_x^T / temperature + f + g).

    Args:
        y_to_x: argmax of each row (n_y,).
        x_to_y: argmax of each column (n_x,).
        row_scaling: f (n_y,).
        column_scaling: g (n_x,).
    """

    y_to_x: Int[Array, " n_y"]
    x_to_y: Int[Array, " n_x"]
    row_scaling: Float[Array, " n_y"]
    column_scaling: Float[Array, " n_x"]

    __repr__ = short_repr


@takes_arrays
def normalised(features: Float[Tensor, "n d"]) -> Float[Tensor, "n d"]:
    """Features of unit length per point: those of meshes and clouds differ in length by a factor of ten."""
    return torch.nn.functional.normalize(features, dim=-1)


@takes_arrays
def sinkhorn_matches(
    features_y: Float[Tensor, "n_y d"],
    features_x: Float[Tensor, "n_x d"],
    *,
    temperature: float = TEMPERATURE,
    iterations: int = ITERATIONS,
) -> SoftMatches[Tensor]:
    """The matches of P_yx = Sinkhorn(F_y F_x^T / temperature), columns normalised first and rows last.

    Raises:
        ArgumentError: if the temperature or the number of iterations is not positive, or a feature not finite.
    """
    check_finite("features_y", features_y)
    check_finite("features_x", features_x)
    balanced = balance(features_y, features_x, temperature=temperature, iterations=iterations)
    f, g = balanced.rows[-1], balanced.columns[-1]
    u, v = balanced.kernel.relative(f, g)
    y_to_x = torch.empty(len(f), dtype=torch.int64, device=f.device)
    columns, scratch = ColumnArgmax(g), torch.empty_like(f[:0])
    for rows, tile in balanced.kernel.tiles():
        # One place for all tiles: fresh memory costs more than the product.
        scratch = torch.empty_like(tile) if scratch.numel() < tile.numel() else scratch[: len(tile)]
        # A row's own scaling does not move its largest entry, nor a column's its own.
        y_to_x[rows] = row_argmax(torch.mul(tile, v, out=scratch))
        columns.update(rows, torch.mul(tile, u[rows, None], out=scratch))
    return SoftMatches(y_to_x, columns.index, f, g)
