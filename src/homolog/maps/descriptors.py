"""Axiomatic descriptors of points, without learning: wave kernel signature and smoothed positions."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from homolog.core.arrays import takes_arrays
from homolog.core.errors import bad_value
from homolog.geometry import Basis, Operators

# The variance of the energies is at least this: the eigenvalues of a small, symmetric shape can all be equal.
_LEAST_SPREAD = 1e-3


@takes_arrays
def wave_kernel_signature(
    eigenvalues: Float[Tensor, " k"], eigenvectors: Float[Tensor, "n k"], *, n_energies: int = 100
) -> Float[Tensor, "n e"]:
    """Wave kernel signature (Aubry, Schlickewei and Cremers, ICCV workshops 2011).

    The probability of a quantum particle of each energy to be at each point. It is invariant to isometries, and so
    cannot tell left from right.

    Args:
        eigenvalues: of the Laplacian, ascending (k,).
        eigenvectors: (n, k).
        n_energies: e, at least 1; 50 to 200 are sensible. 100 is the paper's, as is the variance of 7 steps.

    Returns:
        The signature (n, e).

    Raises:
        ArgumentError: if there is but one eigenpair, the constant.

    Examples:
        >>> import trimesh
        >>> from homolog import Shape, compute_operators
        >>> from homolog.maps import wave_kernel_signature
        >>> mesh = trimesh.creation.icosphere(subdivisions=3)
        >>> sphere = compute_operators(Shape(mesh.vertices, mesh.faces))
        >>> wave_kernel_signature(sphere.eigenvalues, sphere.eigenvectors).shape
        torch.Size([642, 100])
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

    Examples:
        >>> import torch
        >>> from homolog.maps import heat_kernel_signature
        >>> heat_kernel_signature(torch.tensor([0.0, 1.0]), torch.ones(5, 2), n_times=3).shape
        torch.Size([5, 3])
    """
    times = torch.logspace(-2.0, 0.0, n_times, dtype=eigenvalues.dtype, device=eigenvalues.device)
    return eigenvectors.square() @ torch.exp(-eigenvalues[:, None] * times)


def smoothed_positions(operators: Operators | Basis, *, n_eigenpairs: int = 20) -> Float[Tensor, "n 3"]:
    """Low-pass filtered positions: the coordinates projected onto the lowest eigenfunctions.

    Args:
        operators: of the shape, or its basis.
        n_eigenpairs: eigenfunctions kept, at least 1; 6 to 50 are sensible.

    Returns:
        Positions (n, 3), in normalised coordinates.

    Examples:
        >>> import trimesh
        >>> from homolog import Shape, compute_operators
        >>> from homolog.maps import smoothed_positions
        >>> mesh = trimesh.creation.icosphere(subdivisions=3)
        >>> sphere = compute_operators(Shape(mesh.vertices, mesh.faces))
        >>> smoothed_positions(sphere).shape
        torch.Size([642, 3])
    """
    low = operators.truncated(n_eigenpairs)
    return low.eigenvectors @ low.coefficients(operators.points)
