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


@takes_arrays
def heat_kernel_signature(
    eigenvalues: Float[Tensor, " k"], eigenvectors: Float[Tensor, "n k"], *, n_times: int = 16
) -> Float[Tensor, "n t"]:
    """The heat kernel signature: how much heat stays at each point, for times from 0.01 to 1 in unit area.

    Sun, Ovsjanikov and Guibas, "A concise and provably informative multi-scale signature based on heat diffusion",
    SGP 2009; with the times of Sharp et al., "DiffusionNet", ACM TOG 2022.

    Example:
        >>> import torch
        >>> from homolog.maps import heat_kernel_signature
        >>> heat_kernel_signature(torch.tensor([0.0, 1.0]), torch.ones(5, 2), n_times=3).shape
        torch.Size([5, 3])
    """
    times = torch.logspace(-2.0, 0.0, n_times, dtype=eigenvalues.dtype, device=eigenvalues.device)
    return eigenvectors.square() @ torch.exp(-eigenvalues[:, None] * times)


def smoothed_positions(operators: Operators, *, n_eigenpairs: int = 20) -> Float[Tensor, "n 3"]:
    """Positions without detail: their part in the lowest eigenfunctions."""
    low = operators.truncated(n_eigenpairs)
    return low.eigenvectors @ low.coefficients(operators.points)
