"""Descriptors of points that need no learning."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from homolog.core.arrays import takes_arrays
from homolog.core.errors import bad_value
from homolog.geometry import Operators

# Of energies in logarithms: where all eigenvalues of a small, symmetric shape are equal, there are no others.
_LEAST_SPREAD = 1e-3


@takes_arrays
def wave_kernel_signature(
    eigenvalues: Float[Tensor, " k"], eigenvectors: Float[Tensor, "n k"], *, n_energies: int = 100
) -> Float[Tensor, "n e"]:
    """The wave kernel signature: how much a quantum particle of each energy dwells at each point.

    Aubry, Schlickewei and Cremers, "The wave kernel signature", ICCV workshops 2011. It does not change under
    isometries, and so cannot tell left from right.

    Raises:
        ArgumentError: if there is but one eigenpair, the constant.
    """
    if len(eigenvalues) < 2:
        raise bad_value("n_eigenpairs", len(eigenvalues), "at least 2 for wave-kernel signatures")
    logarithms = eigenvalues.clamp(min=1e-6 * float(eigenvalues[-1])).log()
    lowest, highest = logarithms[1], logarithms[-1]
    spread = (7 * (highest - lowest) / n_energies).clamp(min=_LEAST_SPREAD)
    energies = torch.linspace(float(lowest + 2 * spread), float(highest - 2 * spread), n_energies, device=spread.device)
    weights = torch.exp(-((energies[:, None] - logarithms[None, 1:]) ** 2) / (2 * spread**2))
    signature = eigenvectors[:, 1:].square() @ weights.T
    return signature / weights.sum(dim=1)


def smoothed_positions(operators: Operators, *, n_eigenpairs: int = 20) -> Float[Tensor, "n 3"]:
    """Positions without detail: their part in the lowest eigenfunctions."""
    low = operators.truncated(n_eigenpairs)
    return low.eigenvectors @ low.coefficients(operators.points)
