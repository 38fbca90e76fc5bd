"""Functional maps: small matrices that carry functions from one shape to another.

``C_xy`` of shape (k_y, k_x) takes spectral coefficients of a function on x to those of its counterpart on y
(Ovsjanikov, Ben-Chen, Solomon, Butscher and Guibas, "Functional maps", SIGGRAPH 2012).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from homolog.core.arguments import check_finite, check_indices, is_real
from homolog.core.arrays import takes_arrays, takes_arrays_of_any_precision
from homolog.core.errors import ArgumentError, UndeterminedError, bad_value
from homolog.maps.nearest import nearest_neighbour

# A linear system counts as singular if a pivot is no larger than this share of its diagonal.
_SMALLEST_PIVOT = 1e-10


@takes_arrays_of_any_precision
def resolvent_mask(
    eigenvalues_x: Float[Tensor, "*batch k_x"], eigenvalues_y: Float[Tensor, "*batch k_y"], *, gamma: float = 0.5
) -> Float[Tensor, "*batch k_y k_x"]:
    """Resolvent mask (Ren et al. 2019): a penalty for each entry of ``C_xy``, large where frequencies differ.

    The squared distance |R(y_i) - R(x_j)|^2 of the resolvents R(l) = 1 / (l^gamma - i) of both spectra, divided by the
    largest eigenvalue of both. Ren, Panine, Wonka and Ovsjanikov, "Structured regularization of functional map
    computations", SGP 2019, equation 9.

    Args:
        eigenvalues_x: of the Laplacian of x, ascending (k_x,); any leading batch dimensions.
        eigenvalues_y: likewise (k_y,).
        gamma: exponent of the eigenvalues, above 0; 0.25 to 1 are sensible. 0.5 is the paper's.

    Returns:
        The mask (k_y, k_x), zero where eigenvalues are equal.

    Examples:
        >>> import numpy as np
        >>> from homolog import resolvent_mask
        >>> resolvent_mask(np.array([0.0, 4.0]), np.array([0.0, 1.0, 4.0])).round(2)
        array([[0. , 0.5],
               [0.2, 0.1],
               [0.5, 0. ]])

    See Also:
        ``functional_map`` takes it.
    """
    largest = torch.maximum(eigenvalues_x.amax(dim=-1), eigenvalues_y.amax(dim=-1))[..., None]
    largest = largest.clamp(min=torch.finfo(largest.dtype).tiny)  # constants alone differ in nothing
    x = (eigenvalues_x.clamp(min=0) / largest)[..., None, :] ** gamma
    y = (eigenvalues_y.clamp(min=0) / largest)[..., :, None] ** gamma
    real = y / (y**2 + 1) - x / (x**2 + 1)
    imaginary = 1 / (y**2 + 1) - 1 / (x**2 + 1)
    return real**2 + imaginary**2


@takes_arrays_of_any_precision
def functional_map(
    coefficients_x: Float[Tensor, "*batch k_x c"],
    coefficients_y: Float[Tensor, "*batch k_y c"],
    mask: Float[Tensor, "*batch k_y k_x"],
    *,
    regularisation: float = 100.0,
) -> Float[Tensor, "*batch k_y k_x"]:
    """Functional map from descriptors: the C that minimises |C A - B|^2 + regularisation * sum_ij mask_ij C_ij^2.

    Each row of C solves a linear system of its own, (A A^T + regularisation * diag(mask_i)) c_i = A b_i (Donati, Sharma
    and Ovsjanikov, "Deep geometric functional maps", CVPR 2020); all are solved together, in float64, by Cholesky
    factors. Differentiable, twice, and under ``torch.func.grad`` and ``vmap``.

    Args:
        coefficients_x: A, spectral coefficients of the features of x (k_x, c), see ``Operators.coefficients``; any
            leading batch dimensions.
        coefficients_y: B, those of y (k_y, c).
        mask: see ``resolvent_mask`` (k_y, k_x).
        regularisation: weight of the mask, at least 0; 1 to 1,000 are sensible. 100 is the usual value with learned
            features.

    Returns:
        C_xy (k_y, k_x), in the precision of ``coefficients_x``.

    Raises:
        ArgumentError: if the systems are singular, as with fewer features than eigenpairs and no regularisation, or
            not finite.

    Examples:
        >>> import trimesh
        >>> from homolog import Shape, compute_operators, functional_map, resolvent_mask
        >>> from homolog.maps import wave_kernel_signature
        >>> mesh = trimesh.creation.icosphere(subdivisions=3)
        >>> ellipsoid = compute_operators(Shape(mesh.vertices * [1, 1.2, 1.5], mesh.faces)).truncated(30)
        >>> signature = wave_kernel_signature(ellipsoid.eigenvalues, ellipsoid.eigenvectors)
        >>> a, mask = ellipsoid.coefficients(signature), resolvent_mask(ellipsoid.eigenvalues, ellipsoid.eigenvalues)
        >>> c_xx = functional_map(a, a, mask)
        >>> c_xx.shape, round(float(c_xx[0, 0]), 3)
        (torch.Size([30, 30]), 1.0)

    See Also:
        ``point_map_from_functional_map``; ``homolog.maps.reference.functional_map`` is short and readable.
    """
    if not (is_real(regularisation) and regularisation >= 0):
        raise bad_value("regularisation", regularisation, "a finite number of at least 0")
    a, b, penalty = coefficients_x.double(), coefficients_y.double(), regularisation * mask.double()
    rows: Tensor = _Solve.apply(a @ a.mT, penalty, b @ a.mT, None)[0]  # type: ignore[no-untyped-call]
    return rows.to(coefficients_x.dtype)


class _Solve(torch.autograd.Function):
    """The rows c_i of (gram + diag(penalty_i)) c_i = right_i, and the Cholesky factors of these systems.

    The derivative solves the same systems once more, with the factors that are there; it can be derived again. So
    ``torch.func.grad``, ``jacrev`` and ``vmap`` work; for forward mode there is ``homolog.maps.reference``.
    """

    @staticmethod
    def forward(gram: Tensor, penalty: Tensor, right: Tensor, factors: Tensor | None) -> tuple[Tensor, Tensor]:
        factors = _factors(gram, penalty, right) if factors is None else factors.view_as(factors)
        halfway = torch.linalg.solve_triangular(factors, right[..., None], upper=False)
        return torch.linalg.solve_triangular(factors.mT, halfway, upper=True)[..., 0], factors

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Tensor | None, ...], output: tuple[Tensor, Tensor]) -> None:
        rows, factors = output
        ctx.mark_non_differentiable(factors)
        ctx.set_materialize_grads(False)
        ctx.save_for_backward(*inputs[:2], rows, factors)

    @staticmethod
    def backward(ctx: Any, grad: Tensor | None, _: None) -> tuple[Tensor | None, ...]:
        if grad is None:
            return None, None, None, None
        gram, penalty, rows, factors = ctx.saved_tensors
        right_grad, _ = _Solve.apply(gram, penalty, grad, factors)  # type: ignore[no-untyped-call]
        return -right_grad.mT @ rows, -right_grad * rows, right_grad, None

    @staticmethod
    def vmap(info: Any, in_dims: tuple[int | None, ...], *inputs: Tensor | None) -> tuple[Any, tuple[int, int]]:
        """Solve the systems of all members of a batch together, with the batch as the first dimension."""
        cores = (2, 2, 2, 3)  # dimensions behind any batch: of gram, penalty, right and factors
        given = [(t, at, core) for t, at, core in zip(inputs, in_dims, cores, strict=True) if t is not None]
        most = max(tensor.ndim - (at is not None) - core for tensor, at, core in given)
        batched = []
        for tensor, at, core in given:
            first = tensor[None] if at is None else tensor.movedim(at, 0)
            padded = first[(slice(None), *[None] * (1 + most + core - first.ndim))]
            batched.append(padded.expand(info.batch_size, *padded.shape[1:]))
        return _Solve.apply(*batched, *[None] * (4 - len(batched))), (0, 0)  # type: ignore[no-untyped-call]


def _factors(
    gram: Float[Tensor, "*batch k k"], penalty: Float[Tensor, "*batch j k"], right: Float[Tensor, "*batch j k"]
) -> Float[Tensor, "*batch j k k"]:
    """Cholesky factors of gram + diag(penalty_i) for each row i; an error where a system is singular or not finite."""
    batch = np.broadcast_shapes(gram.shape[:-2], penalty.shape[:-2])  # that of torch imports sympy
    systems = gram.expand(*batch, *gram.shape[-2:])[..., None, :, :].repeat_interleave(penalty.shape[-2], dim=-3)
    diagonal = systems.diagonal(dim1=-2, dim2=-1).add_(penalty)
    factors: Tensor
    factors, failed = torch.linalg.cholesky_ex(systems)
    # By rounding, a singular matrix can have a last pivot above zero, up to some 1e-11 of its diagonal.
    pivots = factors.diagonal(dim1=-2, dim2=-1).square()
    singular = pivots <= _SMALLEST_PIVOT * diagonal
    # A matrix product with the features of y spreads what is not finite in either: one small pass finds both.
    if bool(failed.any() or singular.any() or not right.isfinite().all()):
        raise _unsolvable(penalty, right)
    return factors


def _unsolvable(penalty: Tensor, right: Tensor) -> ArgumentError:
    if not right.isfinite().all():
        return ArgumentError("the features are not finite; check what makes them, such as the weights")
    if not penalty.isfinite().all():
        return ArgumentError("mask is not finite; check the eigenvalues that it is made from")
    return UndeterminedError(
        "the functional map is not determined: give at least as many independent features as eigenpairs, "
        "or a larger regularisation"
    )


@takes_arrays
def point_map_from_functional_map(
    c_xy: Float[Tensor, "k_y k_x"], eigenvectors_x: Float[Tensor, "n_x m_x"], eigenvectors_y: Float[Tensor, "n_y m_y"]
) -> Int[Tensor, " n_y"]:
    """Point map from a functional map: nearest neighbours between the rows of Phi_y and of Phi_x C_xy^T.

    Ovsjanikov et al., "Functional maps", SIGGRAPH 2012, in the spectral embedding.

    Args:
        c_xy: functional map from x to y (k_y, k_x).
        eigenvectors_x: of x, at least k_x of them (n_x, m_x).
        eigenvectors_y: of y, at least k_y of them (n_y, m_y).

    Returns:
        For each point of y the index of its point of x (n_y,).

    Raises:
        ArgumentError: if there are fewer eigenvectors than the functional map is for, or it is not finite.

    Examples:
        >>> import torch, trimesh
        >>> from homolog import Shape, compute_operators, point_map_from_functional_map
        >>> mesh = trimesh.creation.icosphere(subdivisions=3)
        >>> phi = compute_operators(Shape(mesh.vertices, mesh.faces)).eigenvectors
        >>> y_to_x = point_map_from_functional_map(torch.eye(40), phi, phi)
        >>> torch.equal(y_to_x, torch.arange(len(phi)))
        True

    See Also:
        ``zoomout`` refines it; ``functional_map_from_point_map`` is the way back.
    """
    _check_fits(c_xy, eigenvectors_x, eigenvectors_y)
    k_y, k_x = c_xy.shape
    carried = eigenvectors_x[:, :k_x] @ c_xy.T
    return nearest_neighbour(eigenvectors_y[:, :k_y], carried).index


def _check_fits(c_xy: Tensor, eigenvectors_x: Tensor, eigenvectors_y: Tensor) -> None:
    """Refuse a functional map that is for more eigenvectors than there are, or not finite."""
    check_finite("c_xy", c_xy)
    k_y, k_x = c_xy.shape
    if eigenvectors_x.shape[1] < k_x or eigenvectors_y.shape[1] < k_y:
        raise ArgumentError(
            f"c_xy has shape {(k_y, k_x)}, so eigenvectors_x must have at least {k_x} columns and eigenvectors_y "
            f"{k_y}, but they have {eigenvectors_x.shape[1]} and {eigenvectors_y.shape[1]}"
        )


@takes_arrays
def functional_map_from_point_map(
    y_to_x: Int[Tensor, " n_y"],
    eigenvectors_x: Float[Tensor, "n_x k_x"],
    eigenvectors_y: Float[Tensor, "n_y k_y"],
    mass_y: Float[Tensor, " n_y"],
) -> Float[Tensor, "k_y k_x"]:
    """Functional map from a point map, by pull-back: C_xy = Phi_y^T M_y Pi_yx Phi_x.

    Args:
        y_to_x: for each point of y a point of x (n_y,).
        eigenvectors_x: (n_x, k_x).
        eigenvectors_y: (n_y, k_y).
        mass_y: lumped mass of y (n_y,).

    Returns:
        C_xy (k_y, k_x).

    Raises:
        ArgumentError: if an index is that of no point, as is -1, where there is no counterpart.

    Examples:
        >>> import torch, trimesh
        >>> from homolog import Shape, compute_operators
        >>> from homolog.maps import functional_map_from_point_map
        >>> mesh = trimesh.creation.icosphere(subdivisions=3)
        >>> sphere = compute_operators(Shape(mesh.vertices, mesh.faces)).truncated(20)
        >>> identity = torch.arange(sphere.n_points)
        >>> c_xy = functional_map_from_point_map(identity, sphere.eigenvectors, sphere.eigenvectors, sphere.mass)
        >>> torch.allclose(c_xy, torch.eye(20), atol=1e-4)
        True
    """
    check_indices("y_to_x", y_to_x, len(eigenvectors_x))
    return eigenvectors_y.T @ (mass_y[:, None] * eigenvectors_x[y_to_x])
