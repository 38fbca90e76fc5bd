"""Matching without learning: what the axiomatic route takes for features, and its first functional map."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from homolog.geometry import Operators
from homolog.maps import functional_map, resolvent_mask, smoothed_positions, wave_kernel_signature

# Size and regularisation of the functional map that the refinement starts from: small and stiff, as the descriptors are
# only roughly right; chosen on training pairs of upright people.
AXIOMATIC_EIGENPAIRS = 15
AXIOMATIC_REGULARISATION = 1000.0

# Weight of the three coordinates against each of the signature's channels, which have unit norm.
_POSITION_WEIGHT = 30.0


def axiomatic_descriptors(operators: Operators) -> Float[Tensor, "n d"]:
    """Wave-kernel signatures, and the smoothed position, which tells left from right.

    Needs the two shapes to stand alike: the same way up, facing the same way.
    """
    signature = wave_kernel_signature(operators.eigenvalues, operators.eigenvectors)
    share = operators.mass[:, None] / operators.mass.sum()
    deviation = signature - (share * signature).sum(dim=0)
    deviation = deviation / (operators.mass[:, None] * deviation.square()).sum(dim=0).sqrt()
    return torch.cat([deviation, _POSITION_WEIGHT * smoothed_positions(operators)], dim=1)


def misfit(source: Operators, target: Operators) -> float:
    """What is left of |C A - B|^2 + lambda sum_ij C_ij^2 mask_ij at the axiomatic route's first functional map."""
    x, y = source.truncated(AXIOMATIC_EIGENPAIRS), target.truncated(AXIOMATIC_EIGENPAIRS)
    a, b = x.coefficients(axiomatic_descriptors(source)), y.coefficients(axiomatic_descriptors(target))
    mask = resolvent_mask(x.eigenvalues, y.eigenvalues)
    c_xy = functional_map(a, b, mask, regularisation=AXIOMATIC_REGULARISATION)
    return float((c_xy @ a - b).square().sum() + AXIOMATIC_REGULARISATION * (c_xy.square() * mask).sum())
