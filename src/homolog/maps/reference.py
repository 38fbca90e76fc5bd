"""Readable references of the fast paths: dense, short, in plain torch operations. New readers start here.

They compute what ``homolog.maps`` computes, to rounding, and hold every intermediate array: n_y x n_x numbers for each
Sinkhorn iteration. Take them to read, to test against, and wherever an operation of the fast path lacks something that
torch derives by itself: ``torch.compile``, forward-mode and second derivatives, ``torch.func.vmap`` over gradients. All
take any leading batch dimensions.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from homolog.maps.sinkhorn import ITERATIONS, TEMPERATURE


def soft_map(
    features_y: Float[Tensor, "*batch n_y d"],
    features_x: Float[Tensor, "*batch n_x d"],
    *,
    temperature: float = TEMPERATURE,
    iterations: int = ITERATIONS,
) -> Float[Tensor, "*batch n_y n_x"]:
    """Sinkhorn normalisation of F_y F_x^T / temperature (Sinkhorn 1967; Cuturi 2013, "Sinkhorn distances").

    In the logarithm: columns are normalised first and rows last, so that each row of the map sums to one. The reference
    of ``sinkhorn_matches`` and of the soft maps in the losses.

    Examples:
        >>> import torch
        >>> from homolog.maps import reference, sinkhorn_matches
        >>> features = torch.randn(50, 8, generator=torch.Generator().manual_seed(0))
        >>> soft = reference.soft_map(features[:30], features)
        >>> torch.equal(soft.argmax(dim=1), sinkhorn_matches(features[:30], features).y_to_x)
        True
    """
    logits = features_y @ features_x.mT / temperature
    for _ in range(iterations):
        logits = logits - logits.logsumexp(dim=-2, keepdim=True)
        logits = logits - logits.logsumexp(dim=-1, keepdim=True)
    return logits.exp()


def functional_map(
    coefficients_x: Float[Tensor, "*batch k_x c"],
    coefficients_y: Float[Tensor, "*batch k_y c"],
    mask: Float[Tensor, "*batch k_y k_x"],
    *,
    regularisation: float = 100.0,
) -> Float[Tensor, "*batch k_y k_x"]:
    """Functional map with a mask: argmin over C of |C A - B|^2 + regularisation * sum_ij mask_ij C_ij^2.

    Each row c_i solves (A A^T + regularisation * diag(mask_i)) c_i = A b_i (Donati, Sharma and Ovsjanikov, "Deep
    geometric functional maps", CVPR 2020). The reference of ``homolog.maps.functional_map``.

    Examples:
        >>> import torch
        >>> from homolog.maps import reference
        >>> a = torch.eye(3)
        >>> reference.functional_map(a, 2 * a, torch.ones(3, 3), regularisation=1.0).diagonal()
        tensor([1., 1., 1.])
    """
    a, b = coefficients_x.double(), coefficients_y.double()
    systems = (a @ a.mT)[..., None, :, :] + torch.diag_embed(regularisation * mask.double())
    rows: Tensor = torch.linalg.solve(systems, (b @ a.mT)[..., None])[..., 0]
    return rows.to(coefficients_x.dtype)


def resolvent_mask(
    eigenvalues_x: Float[Tensor, "*batch k_x"], eigenvalues_y: Float[Tensor, "*batch k_y"], *, gamma: float = 0.5
) -> Float[Tensor, "*batch k_y k_x"]:
    """Resolvent mask |R(y_i) - R(x_j)|^2 with R(l) = 1 / (l^gamma - i) of eigenvalues over the largest of both.

    Ren, Panine, Wonka and Ovsjanikov, "Structured regularization of functional map computations", SGP 2019, equation 9,
    in complex numbers. The reference of ``homolog.maps.resolvent_mask``.

    Examples:
        >>> import torch
        >>> from homolog.maps import reference
        >>> reference.resolvent_mask(torch.tensor([0.0, 4.0]), torch.tensor([0.0, 4.0]))
        tensor([[0.0000, 0.5000],
                [0.5000, 0.0000]])
    """
    largest = torch.maximum(eigenvalues_x.amax(dim=-1), eigenvalues_y.amax(dim=-1))[..., None]
    x, y = (1 / ((values / largest) ** gamma - 1j) for values in (eigenvalues_x, eigenvalues_y))
    return (y[..., :, None] - x[..., None, :]).abs().square()
