"""The losses that the network learns from: pure functions of maps and features.

Cao and Bernard, "Self-supervised learning for multimodal non-rigid 3D shape matching", CVPR 2023, section 4.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable

from homolog.core.arrays import takes_arrays
from homolog.core.errors import bad_value
from homolog.core.memory import row_tiles
from homolog.maps.sinkhorn import ITERATIONS, TEMPERATURE, carried_over

# The paper's temperature of the contrastive loss.
INFONCE_TEMPERATURE = 0.07
# Of the registration loss, in units of sqrt(area): the spacing of a thousand points on a shape.
REGISTRATION_REACH = 0.03


@takes_arrays
def bijectivity_loss(c_xy: Float[Tensor, "k_y k_x"], c_yx: Float[Tensor, "k_x k_y"]) -> Float[Tensor, ""]:
    """The maps are each other's inverse: |C_xy C_yx - I|^2 + |C_yx C_xy - I|^2."""
    return _off_identity(c_xy @ c_yx) + _off_identity(c_yx @ c_xy)


@takes_arrays
def orthogonality_loss(c_xy: Float[Tensor, "k_y k_x"], c_yx: Float[Tensor, "k_x k_y"]) -> Float[Tensor, ""]:
    """The maps preserve areas: |C_xy^T C_xy - I|^2 + |C_yx^T C_yx - I|^2."""
    return _off_identity(c_xy.mT @ c_xy) + _off_identity(c_yx.mT @ c_yx)


@takes_arrays
def partial_bijectivity_loss(
    c_xy: Float[Tensor, "k_y k_x"], c_yx: Float[Tensor, "k_x k_y"], *, rank: int
) -> Float[Tensor, ""]:
    """For y a part of x: |C_xy C_yx - I_r|^2, where the first r diagonal entries of I_r are one.

    Args:
        c_xy: from the full shape to the partial one.
        c_yx: from the partial shape to the full one.
        rank: r, see ``partial_rank``.
    """
    return _off_identity(c_xy @ c_yx, rank)


@takes_arrays
def partial_orthogonality_loss(c_xy: Float[Tensor, "k_y k_x"], *, rank: int) -> Float[Tensor, ""]:
    """For y a part of x: |C_xy C_xy^T - I_r|^2; see ``partial_bijectivity_loss``."""
    return _off_identity(c_xy @ c_xy.mT, rank)


@takes_arrays
def partial_rank(eigenvalues_x: Float[Tensor, " k_x"], eigenvalues_y: Float[Tensor, " k_y"]) -> int:
    """The rank of a functional map from a full shape x to its part y, both at one scale.

    A partial shape's eigenvalues grow faster, in the ratio of the areas (Weyl's law). The rank is the number of those
    below the largest of the full shape, and one more, at most k (Rodola et al., "Partial Functional Correspondence",
    2017).
    """
    return min(int((eigenvalues_y < eigenvalues_x.max()).sum()) + 1, len(eigenvalues_y))


@takes_arrays
def commutativity_loss(
    c_xy: Float[Tensor, "k_y k_x"], eigenvalues_x: Float[Tensor, " k_x"], eigenvalues_y: Float[Tensor, " k_y"]
) -> Float[Tensor, ""]:
    """The map of an isometry commutes with the Laplacians: |C_xy Lambda_x - Lambda_y C_xy|^2.

    The eigenvalues are divided by the largest of both, so that the loss does not depend on the scale.
    """
    largest = torch.maximum(eigenvalues_x.max(), eigenvalues_y.max())
    return (c_xy * ((eigenvalues_x[None, :] - eigenvalues_y[:, None]) / largest)).square().sum()


@takes_arrays
def descriptor_loss(
    c_xy: Float[Tensor, "k_y k_x"], products_x: Float[Tensor, "k_x d k_x"], products_y: Float[Tensor, "k_y d k_y"]
) -> Float[Tensor, ""]:
    """The map commutes with multiplication by descriptors: the mean over these of |C_xy D_x - D_y C_xy|^2.

    A map that is composition with a point map preserves products of functions. D. Nogneng and M. Ovsjanikov,
    "Informative Descriptor Preservation via Commutativity for Shape Matching", CGF 2017.

    Args:
        c_xy: from x to y.
        products_x: D_x of each descriptor, see ``multiplication_operators``.
        products_y: those of the same descriptors on y.
    """
    difference = torch.einsum("yx,xdk->ydk", c_xy, products_x) - products_y @ c_xy
    return difference.square().sum() / products_x.shape[1]


@takes_arrays
def multiplication_operators(
    functions: Float[Tensor, "n d"], eigenvectors: Float[Tensor, "n k"], pseudo_inverse: Float[Tensor, "k n"]
) -> Float[Tensor, "k d k"]:
    """Multiplication with each function, as a matrix (k, k) of coefficients: Phi^+ diag(f) Phi.

    Examples:
        >>> import torch
        >>> from homolog.maps.losses import multiplication_operators
        >>> multiplication_operators(torch.full((3, 1), 2.0), torch.eye(3), torch.eye(3))[:, 0].diagonal()
        tensor([2., 2., 2.])
    """
    products = functions[:, :, None] * eigenvectors[:, None, :]
    return (pseudo_inverse @ products.flatten(1)).view(-1, *products.shape[1:])


@takes_arrays
def smoothness_loss(
    c_xy: Float[Tensor, "k_y k_x"],
    positions_x: Float[Tensor, "k_x 3"],
    positions_y: Float[Tensor, "k_y 3"],
    eigenvalues_y: Float[Tensor, " k_y"],
) -> Float[Tensor, ""]:
    """The displacement is smooth: the Dirichlet energy of C_xy x - y, of positions x and y, as a function on y.

    The Dirichlet energy of a function is the sum of the eigenvalues times its squared coefficients, so that
    translations cost nothing, and rotations and folds much. For pre-aligned shapes that differ by a deformation, such
    as organs, where many maps preserve areas and lengths about equally well. M. Eisenberger, Z. Laehner and
    D. Cremers, "Smooth shells" (CVPR 2020), penalise the deformation that aligns two shapes in the same way.

    Args:
        c_xy: takes coefficients of functions on x to those on y.
        positions_x: coefficients of the positions of x, in units of sqrt(area).
        positions_y: of those of y.
        eigenvalues_y: of the functions on y.
    """
    displacement = c_xy @ positions_x - positions_y
    return (eigenvalues_y[:, None] * displacement.square()).sum()


@takes_arrays
def alignment_loss(
    c_xy: Float[Tensor, "k_y k_x"],
    eigenvectors_x: Float[Tensor, "n_x k_x"],
    eigenvectors_y: Float[Tensor, "n_y k_y"],
    features_x: Float[Tensor, "m_x d"],
    features_y: Float[Tensor, "m_y d"],
    *,
    temperature: float = TEMPERATURE,
    iterations: int = ITERATIONS,
) -> Float[Tensor, ""]:
    """The soft map of the features agrees with the functional map: |Phi_y C_xy - P_yx Phi_x|^2.

    It is also called coupling. No gradient flows into the functional map, which teaches the features.

    Args:
        c_xy: the functional map of the meshes.
        eigenvectors_x: of the mesh x, at the points of its cloud.
        eigenvectors_y: of the mesh y, likewise.
        features_x: of the points of the cloud of x.
        features_y: of those of y.
        temperature: of Sinkhorn's map.
        iterations: likewise.
    """
    mapped = carried_over(features_y, features_x, eigenvectors_x, temperature=temperature, iterations=iterations)
    return (eigenvectors_y @ c_xy.detach() - mapped).square().sum()


@takes_arrays
def partial_alignment_loss(
    c_xy: Float[Tensor, "k_y k_x"],
    eigenvectors_x: Float[Tensor, "n_x k_x"],
    eigenvectors_y: Float[Tensor, "n_y k_y"],
    features_x: Float[Tensor, "n_x d"],
    features_y: Float[Tensor, "n_y d"],
    *,
    temperature: float = TEMPERATURE,
) -> Float[Tensor, ""]:
    """``alignment_loss`` for y a part of x: the soft map is a softmax over x, as not all of x has a counterpart.

    Raises:
        ArgumentError: if the temperature is not positive.
    """
    mapped = softly_mapped(features_y, features_x, eigenvectors_x, temperature=temperature)
    return (eigenvectors_y @ c_xy.detach() - mapped).square().sum()


@takes_arrays
def softly_mapped(
    features_y: Float[Tensor, "n_y d"],
    features_x: Float[Tensor, "n_x d"],
    functions: Float[Tensor, "n_x c"],
    *,
    temperature: float = TEMPERATURE,
) -> Float[Tensor, "n_y c"]:
    """Functions on x at the points of y by the soft map softmax(F_y F_x^T / temperature), which is never held.

    Gradients are those of the features; the functions have none.

    Raises:
        ArgumentError: if the temperature is not positive.
    """
    if not temperature > 0:
        raise bad_value("temperature", temperature, "positive")
    mapped: Tensor = _SoftlyMapped.apply(features_y / temperature, features_x, functions)  # type: ignore[no-untyped-call]
    return mapped


@takes_arrays
def registration_loss(
    features_x: Float[Tensor, "n_x d"],
    features_y: Float[Tensor, "n_y d"],
    points_x: Float[Tensor, "n_x 3"],
    targets: Float[Tensor, "n_y 3"],
    *,
    reach: float = REGISTRATION_REACH,
    temperature: float = TEMPERATURE,
) -> Float[Tensor, ""]:
    """The soft map agrees with a registration: the mean divergence KL(Q_yx | P_yx) of the rows. New here.

    P = softmax(F_y F_x^T / temperature) is the soft map of the features. Q = softmax(-|s - x|^2 / (2 reach^2)) is the
    distribution over the points of x that each target s gives. Targets come from ``registered_positions`` of each
    pair. One network learns from all pairs, so that errors which differ from pair to pair average out. For pre-aligned
    shapes that differ by a deformation, such as organs.

    Args:
        features_x: of the points of one cloud.
        features_y: of those of the other.
        points_x: their positions.
        targets: where the points of y lie on x.
        reach: standard deviation of Q around its target, in the unit of the positions.
        temperature: of the soft map.

    Raises:
        ArgumentError: if the reach or the temperature is not positive.
    """
    for name, value in (("reach", reach), ("temperature", temperature)):
        if not value > 0:
            raise bad_value(name, value, "positive")
    found = torch.log_softmax(features_y @ features_x.mT / temperature, dim=1)
    expected = torch.log_softmax(torch.cdist(targets, points_x).square() / (-2 * reach**2), dim=1)
    return torch.nn.functional.kl_div(found, expected, reduction="batchmean", log_target=True)


@takes_arrays
def infonce_loss(
    features: Float[Tensor, "n d"], counterparts: Float[Tensor, "n d"], *, temperature: float = INFONCE_TEMPERATURE
) -> Float[Tensor, ""]:
    """Each row must resemble its counterpart more than all others: PointInfoNCE, the mean over the rows.

    With the rows of a mesh and its own cloud this is the paper's equation 8; with corresponding rows of two shapes, the
    supervised loss of its supplement. The features should be of unit length. The gradient is taken on the way, tile by
    tile, so that nothing of size n x n is kept.

    Raises:
        ArgumentError: if the temperature is not positive.
    """
    if not temperature > 0:
        raise bad_value("temperature", temperature, "positive")
    loss: Tensor = _Contrast.apply(features, counterparts, temperature)  # type: ignore[no-untyped-call]
    return loss


def _off_identity(product: Float[Tensor, "k k"], rank: int | None = None) -> Float[Tensor, ""]:
    ones = torch.ones_like(product[0])
    if rank is not None:
        ones[rank:] = 0
    return (product - torch.diag(ones)).square().sum()


class _Contrast(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, features: Tensor, counterparts: Tensor, temperature: float) -> Tensor:
        left, right = features / temperature, counterparts.T
        total = features.new_zeros((), dtype=torch.float64)
        left_grad, right_grad = torch.empty_like(features), torch.zeros_like(counterparts)
        for rows in row_tiles(len(left), bytes_per_row=2 * len(left) * left.element_size()):
            tile = left[rows] @ right
            paired = tile.diagonal(rows.start)
            # Relative to the pair's own logit nothing overflows that matters, nor can the sum vanish.
            largest = tile.amax(dim=1, keepdim=True)
            own = paired - largest[:, 0]
            tile.sub_(largest).exp_()
            sums = tile.sum(dim=1)
            total += (sums.log() - own).sum(dtype=torch.float64)
            # Scaling the rows of a product is cheaper than those of the tile.
            share = 1 / (len(left) * sums[:, None])
            torch.mm(tile, counterparts, out=left_grad[rows]).mul_(share)
            right_grad.addmm_(tile.T, share * left[rows])
        left_grad.sub_(counterparts, alpha=1 / len(left))
        right_grad.sub_(left, alpha=1 / len(left))
        ctx.save_for_backward(left_grad.div_(temperature), right_grad)
        return (total / len(left)).to(features)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, ...]:
        left_grad, right_grad = ctx.saved_tensors
        return grad * left_grad, grad * right_grad, None


class _SoftlyMapped(torch.autograd.Function):
    """Attention: softmax(left right^T) functions, row tile by row tile, made anew for the derivative."""

    @staticmethod
    def forward(ctx: Any, left: Tensor, right: Tensor, functions: Tensor) -> Tensor:
        mapped = functions.new_empty(len(left), functions.shape[1])
        for rows in _softmax_tiles(left, right):
            torch.mm(torch.softmax(left[rows] @ right.T, dim=1), functions, out=mapped[rows])
        ctx.save_for_backward(left, right, functions)
        return mapped

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, ...]:
        left, right, functions = ctx.saved_tensors
        left_grad, right_grad = torch.empty_like(left), torch.zeros_like(right)
        for rows in _softmax_tiles(left, right):
            soft = torch.softmax(left[rows] @ right.T, dim=1)
            soft_grad = (grad[rows] @ functions.T).mul_(soft)
            soft_grad.sub_(soft.mul_(soft_grad.sum(dim=1, keepdim=True)))
            torch.mm(soft_grad, right, out=left_grad[rows])
            right_grad.addmm_(soft_grad.T, left[rows])
        return left_grad, right_grad, None


def _softmax_tiles(left: Float[Tensor, "n d"], right: Float[Tensor, "m d"]) -> Iterator[slice]:
    return row_tiles(len(left), bytes_per_row=3 * len(right) * left.element_size())
