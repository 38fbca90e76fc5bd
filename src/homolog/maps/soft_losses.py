"""Losses of soft maps between two surfaces, with gradients into features and functional maps alike.

P_yx = softmax(F_y F_x^T / temperature) takes functions on x to y; see ``softly_mapped``. Weights of these losses are 0
unless a recipe says otherwise.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from jaxtyping import Float, Int
from torch import Tensor

from homolog.core.arrays import takes_arrays
from homolog.core.errors import ArgumentError, bad_value
from homolog.geometry import Basis
from homolog.maps.losses import softly_mapped

SOFT_TEMPERATURE = 0.07
"""Of the soft map between unit features, as Cao, Roetzer and Bernard (2023) have it."""
DIFFUSION_TIME, DIFFUSION_FUNCTIONS = 0.01, 128
"""The longest time of ``diffusion_loss``, in units of area, and the number of its functions."""
DAMPING, DAMPED_SIZES = 3.0, (100, 150, 200)
"""Of ``damped_spectrum_loss``: the exponent at the largest eigenvalue, and the numbers of eigenfunctions."""


@takes_arrays
def coupling_loss(
    c_xy: Float[Tensor, "k_y k_x"], mapped: Float[Tensor, "n_y k_x"], pseudo_inverse_y: Float[Tensor, "k_y n_y"]
) -> Float[Tensor, ""]:
    """The functional map is that of the soft map: |C_xy - Phi_y^+ P_yx Phi_x|^2, with gradients into both.

    D. Cao, P. Roetzer and F. Bernard, "Unsupervised learning of robust spectral shape matching" (ACM TOG 2023),
    equation 8.

    Args:
        c_xy: takes coefficients of functions on x to those on y.
        mapped: P_yx Phi_x, the eigenvectors of x by the soft map at the points of y.
        pseudo_inverse_y: takes functions on y to their coefficients.

    Examples:
        >>> import torch
        >>> from homolog.maps.soft_losses import coupling_loss
        >>> coupling_loss(torch.eye(2), torch.eye(2), torch.eye(2))
        tensor(0.)
    """
    return (c_xy - pseudo_inverse_y @ mapped).square().sum()


@takes_arrays
def true_map_loss(c_xy: Float[Tensor, "k_y k_x"], true: Float[Tensor, "k_y k_x"]) -> Float[Tensor, ""]:
    """The functional map is that of the ground truth: |C_xy - C|^2.

    N. Donati, A. Sharma and M. Ovsjanikov, "Deep geometric functional maps" (CVPR 2020).
    """
    return (c_xy - true).square().sum()


@takes_arrays
def map_from_common_points(
    eigenvectors_x: Float[Tensor, "p k_x"], eigenvectors_y: Float[Tensor, "p k_y"]
) -> Float[Tensor, "k_y k_x"]:
    """The functional map of points that correspond: the least-squares solution C_xy of Phi_y C_xy = Phi_x.

    Args:
        eigenvectors_x: of x, at the points.
        eigenvectors_y: of y, at the same points in the same order.

    Raises:
        ArgumentError: if there are fewer points than eigenvectors.
    """
    if len(eigenvectors_y) < eigenvectors_y.shape[1]:
        raise ArgumentError(
            f"{len(eigenvectors_y)} points correspond, but a functional map of {eigenvectors_y.shape[1]} eigenvectors "
            "needs as many; take fewer map_eigenpairs"
        )
    found: Tensor = torch.linalg.lstsq(eigenvectors_y.double(), eigenvectors_x.double()).solution
    return found.to(eigenvectors_x.dtype)


@takes_arrays
def teacher_loss(
    features_y: Float[Tensor, "n_y d"],
    features_x: Float[Tensor, "n_x d"],
    y_to_x: Int[Tensor, " n_y"],
    *,
    temperature: float = SOFT_TEMPERATURE,
) -> Float[Tensor, ""]:
    """The soft map agrees with a point map that teaches it: the mean of -log P_yx at the counterparts. New here.

    Args:
        features_y: of unit length (n_y, d).
        features_x: likewise (n_x, d).
        y_to_x: the point map, such as one that ZoomOut refined.
        temperature: of the soft map.
    """
    _check_positive(temperature=temperature)
    return torch.nn.functional.cross_entropy(features_y @ features_x.mT / temperature, y_to_x)


def diffused(basis: Basis, functions: Float[Tensor, "n c"], times: Float[Tensor, " c"]) -> Float[Tensor, "n c"]:
    """Functions after heat diffusion, each by its own time: Phi exp(-lambda t) Phi^+ f, in the lowest eigenfunctions.

    Args:
        basis: of the shape.
        functions: at its points.
        times: in units of the area that eigenvalues are in.
    """
    decay = torch.exp(-basis.eigenvalues.clamp(min=0)[:, None] * times)
    return basis.eigenvectors @ (decay * (basis.pseudo_inverse @ functions))


def diffusion_loss(
    features_y: Float[Tensor, "n_y d"],
    features_x: Float[Tensor, "n_x d"],
    y: Basis,
    x: Basis,
    coefficients: Float[Tensor, "k c"],
    times: Float[Tensor, " c"],
    *,
    temperature: float = SOFT_TEMPERATURE,
) -> Float[Tensor, ""]:
    """The soft map commutes with diffusion: the mean of |P_yx diffuse_x(f) - diffuse_y(P_yx f)|^2 over functions f.

    D. Cao, Z. Laehner and F. Bernard, "Synchronous diffusion for unsupervised smooth non-rigid 3D shape matching" (ECCV
    2024). Here functions are given by coefficients, so that they do not depend on how a shape is sampled, and squares
    are weighed by area.

    Args:
        features_y: of unit length (n_y, d).
        features_x: likewise (n_x, d).
        y: basis of y.
        x: basis of x.
        coefficients: of random functions on x.
        times: for each function how long it diffuses.
        temperature: of the soft map.
    """
    functions = x.eigenvectors @ coefficients
    both = torch.cat([functions, diffused(x, functions, times)], dim=1)
    mapped, after = softly_mapped(features_y, features_x, both, temperature=temperature).chunk(2, dim=1)
    squares = (after - diffused(y, mapped, times)).square().mean(dim=1)
    return (y.mass * squares).sum() / y.mass.sum()


def damped_spectrum_loss(
    features_y: Float[Tensor, "n_y d"],
    features_x: Float[Tensor, "n_x d"],
    y: Basis,
    x: Basis,
    *,
    damping: float = DAMPING,
    sizes: Sequence[int] = DAMPED_SIZES,
    temperature: float = SOFT_TEMPERATURE,
) -> Float[Tensor, ""]:
    """The soft map takes damped eigenfunctions to each other: the sum over sizes k of |Psi_y - P Psi_x C^T|^2.

    Psi = Phi exp(-T) are the k lowest eigenfunctions, and C = Psi_y^+ P Psi_x. T = damping * eigenvalue / the largest
    of the k, which is given and not learned: the loss is least where everything is damped away, so that nothing but a
    bound would keep a learned T finite. Each term is divided by |Psi_y|^2. Sizes beyond the basis are cut to it, and
    equal ones count once.

    Args:
        features_y: of unit length (n_y, d).
        features_x: likewise (n_x, d).
        y: basis of y.
        x: basis of x.
        damping: exponent at the largest eigenvalue; 0 for none.
        sizes: numbers of eigenfunctions.
        temperature: of the soft map.
    """
    _check_positive(temperature=temperature)
    most = min(len(x.eigenvalues), len(y.eigenvalues))
    total = features_y.new_zeros(())
    mapped = softly_mapped(features_y, features_x, x.eigenvectors[:, : min(most, max(sizes))], temperature=temperature)
    for size in sorted({min(size, most) for size in sizes}):
        damp_x, damp_y = (torch.exp(-damping * b.eigenvalues[:size] / b.eigenvalues[size - 1]) for b in (x, y))
        psi_y, carried = y.eigenvectors[:, :size] * damp_y, mapped[:, :size] * damp_x
        c_xy = (y.pseudo_inverse[:size] @ carried) / damp_y[:, None]
        squares = (psi_y - carried @ c_xy.mT).square().sum(dim=1)
        total = total + (y.mass * squares).sum() / (y.mass * psi_y.square().sum(dim=1)).sum()
    return total


def _check_positive(**given: float) -> None:
    for name, value in given.items():
        if not value > 0:
            raise bad_value(name, value, "positive")
