"""Point maps from soft maps: Sinkhorn normalisation of feature similarities, read off tile by tile."""

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
    """Point maps of a soft map P (n_y, n_x), and its scalings: P = exp(F_y F_x^T / temperature + f + g).

    Args:
        y_to_x: argmax of each row (n_y,).
        x_to_y: argmax of each column (n_x,).
        row_scaling: f (n_y,).
        column_scaling: g (n_x,).

    Examples:
        >>> import torch
        >>> from homolog import sinkhorn_matches
        >>> sinkhorn_matches(torch.eye(5), torch.eye(5))
        SoftMatches(y_to_x=int64 (5,), x_to_y=int64 (5,), row_scaling=float32 (5,), column_scaling=float32 (5,))
    """

    y_to_x: Int[Array, " n_y"]
    x_to_y: Int[Array, " n_x"]
    row_scaling: Float[Array, " n_y"]
    column_scaling: Float[Array, " n_x"]

    __repr__ = short_repr


@takes_arrays
def normalised(features: Float[Tensor, "n d"]) -> Float[Tensor, "n d"]:
    """L2-normalise features: unit length per point.

    Features of meshes and clouds from one network differ in length by a factor of ten; only their directions compare.

    Args:
        features: numbers per point (n, d).

    Returns:
        The same directions (n, d); zero stays zero.

    Examples:
        >>> import torch
        >>> from homolog.maps import normalised
        >>> normalised(torch.tensor([[3.0, 4.0]]))
        tensor([[0.6000, 0.8000]])
    """
    return torch.nn.functional.normalize(features, dim=-1)


@takes_arrays
def sinkhorn_matches(
    features_y: Float[Tensor, "n_y d"],
    features_x: Float[Tensor, "n_x d"],
    *,
    temperature: float = TEMPERATURE,
    iterations: int = ITERATIONS,
) -> SoftMatches[Tensor]:
    """Sinkhorn normalisation: point maps of P_yx = Sinkhorn(F_y F_x^T / temperature), columns first and rows last.

    Sinkhorn 1967; Cuturi, "Sinkhorn distances", 2013; as Cao and Bernard (CVPR 2023) use it between point
    clouds. P is never held: at most one array of n_y x n_x, and none where it does not fit ``working_memory``.

    Args:
        features_y: of unit length per point, see ``normalised`` (n_y, d).
        features_x: likewise (n_x, d).
        temperature: above 0; 0.05 to 0.5 are sensible. 0.2 is the paper's.
        iterations: of both normalisations, at least 1; 5 to 30 are sensible. 10 is the paper's.

    Returns:
        Both point maps, and the scalings that make P.

    Raises:
        ArgumentError: if the temperature or the number of iterations is not positive, or a feature is not finite.

    Examples:
        >>> import numpy as np
        >>> from homolog import sinkhorn_matches
        >>> x = np.eye(4, dtype=np.float32)
        >>> sinkhorn_matches(x[[2, 0, 3]], x).y_to_x
        array([2, 0, 3])

    See Also:
        ``homolog.maps.reference.soft_map`` for P itself, ``most_similar`` without normalisation.
    """
    check_finite("features_y", features_y)
    check_finite("features_x", features_x)
    balanced = balance(features_y, features_x, temperature=temperature, iterations=iterations)
    f, g = balanced.rows[-1], balanced.columns[-1]
    u, v = balanced.kernel.relative(f, g)
    y_to_x = torch.empty(len(f), dtype=torch.int64, device=f.device)
    columns, scratch = ColumnArgmax(g), torch.empty_like(f[:0])
    for rows, tile in balanced.kernel.tiles():
        # One buffer for all tiles: fresh memory costs more than the product.
        scratch = torch.empty_like(tile) if scratch.numel() < tile.numel() else scratch[: len(tile)]
        # A row's own scaling does not move its largest entry, nor a column's its own.
        y_to_x[rows] = row_argmax(torch.mul(tile, v, out=scratch))
        columns.update(rows, torch.mul(tile, u[rows, None], out=scratch))
    return SoftMatches(y_to_x, columns.index, f, g)
