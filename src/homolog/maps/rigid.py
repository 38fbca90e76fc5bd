"""The rigid motion that best takes points to where a map says that they belong."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from homolog.core.arrays import takes_arrays

# Residuals of a perfect fit are zero, which could not be divided by.
_LEAST_RESIDUAL = 1e-6


@takes_arrays
def rigid_motion(
    points: Float[Tensor, "n 3"], places: Float[Tensor, "n 3"], *, rounds: int = 15
) -> tuple[Float[Tensor, "3 3"], Float[Tensor, " 3"]]:
    """The rotation R and shift t with ``points @ R.T + t`` near to ``places``, whatever many of them are wrong.

    Least squares (Kabsch, "A solution for the best rotation to relate two sets of vectors", 1976), taken again with
    each pair weighted by Cauchy's function of its residual, in units of their median.

    Args:
        points: what is moved.
        places: where each of them belongs.
        rounds: how often it is weighted anew.
    """
    start, end = points.double(), places.double()
    weights = torch.ones_like(start[:, 0])
    for _ in range(rounds):
        rotation, shift = _least_squares(start, end, weights)
        residuals = (start @ rotation.T + shift - end).norm(dim=1)
        weights = 1 / (1 + (residuals / residuals.median().clamp(min=_LEAST_RESIDUAL)) ** 2)
    rotation, shift = _least_squares(start, end, weights)
    return rotation.to(points), shift.to(points)


def _least_squares(
    points: Float[Tensor, "n 3"], places: Float[Tensor, "n 3"], weights: Float[Tensor, " n"]
) -> tuple[Float[Tensor, "3 3"], Float[Tensor, " 3"]]:
    shares = weights / weights.sum()
    middle, goal = shares @ points, shares @ places
    left, _, right = torch.linalg.svd((shares[:, None] * (points - middle)).T @ (places - goal))
    # The best orthogonal matrix may be a reflection; the best rotation then gives way along the weakest direction.
    upright = torch.ones(3, dtype=points.dtype, device=points.device)
    upright[2] = torch.linalg.det(left @ right).sign()
    rotation = right.T @ (upright[:, None] * left.T)
    return rotation, goal - rotation @ middle
