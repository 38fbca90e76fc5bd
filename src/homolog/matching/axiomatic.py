"""Matching without learning: what the axiomatic route takes for features."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from homolog.geometry import Operators
from homolog.maps import smoothed_positions, wave_kernel_signature

# Size and regularisation of the functional map that the refinement starts from.
AXIOMATIC_EIGENPAIRS = 20
AXIOMATIC_REGULARISATION = 1.0


def axiomatic_descriptors(operators: Operators) -> Float[Tensor, "n d"]:
    """Wave-kernel signatures, alone and multiplied by the smoothed position, which tells left from right.

    Needs the two shapes to stand alike: same way up, same facing.
    """
    signature = wave_kernel_signature(operators.eigenvalues, operators.eigenvectors)
    positions = smoothed_positions(operators)
    return torch.cat([signature, positions], dim=1)
