"""The arithmetic of a diffusion block, with its derivative by hand.

Nearly all of it is matrix products; what lies between them is kept to a few passes over memory, and the derivative to
what those products need. The slow, readable form is in the tests.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.autograd.function import once_differentiable

from homolog.geometry import Basis


class Dropout(NamedTuple):
    """Which hidden activations to keep in the two inner layers of a perceptron, and by how much they then grow."""

    first: Bool[Tensor, "n w"]
    second: Bool[Tensor, "n w"]
    growth: float


def diffusion_block(
    hidden: Float[Tensor, "n w"],
    basis: Basis,
    decay: Float[Tensor, "k w"],
    mixing: Float[Tensor, "2 w 2w"],
    perceptron: Sequence[Tensor],
    dropout: Dropout | None,
) -> Float[Tensor, "n w"]:
    """Diffusion, gradient features and a perceptron per point, with a skip.

    Args:
        hidden: channels per point.
        basis: of the shape.
        decay: by what diffusion multiplies each coefficient of each channel.
        mixing: takes the two components of all channels' gradients to those of the combinations that each channel's
            gradient is multiplied with.
        perceptron: weights and biases of its three layers in turn; its inputs are the channels, the diffused channels
            and the gradient features, side by side.
        dropout: None to keep everything.
    """
    output: Tensor = _Block.apply(  # type: ignore[no-untyped-call]
        hidden, basis.eigenvectors, basis.gradients, basis.analysis, decay, mixing, *perceptron, dropout
    )
    return output


class _Block(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,
        hidden: Tensor,
        eigenvectors: Tensor,
        gradients: Tensor,
        analysis: Tensor,
        decay: Tensor,
        mixing: Tensor,
        w0: Tensor,
        b0: Tensor,
        w1: Tensor,
        b1: Tensor,
        w2: Tensor,
        b2: Tensor,
        dropout: Dropout | None,
    ) -> Tensor:
        growth = dropout.growth if dropout else 1.0
        of_hidden, of_diffused, of_features = w0.chunk(3, dim=1)
        coefficients = analysis @ hidden
        decayed = decay * coefficients
        # What is linear is done to the coefficients: they have k rows instead of n, and so has all that is derived.
        vectors = (gradients.flatten(0, 1) @ decayed).view(len(hidden), -1)
        partners = gradients.flatten(1, 2) @ (decayed @ mixing).flatten(0, 1)
        features = _inner_products(vectors, partners).tanh_()
        first = torch.addmm(b0, hidden, of_hidden.T)
        first.addmm_(eigenvectors, decayed @ of_diffused.T).addmm_(features, of_features.T)
        _rectify(first, dropout.first if dropout else None)
        second = torch.addmm(b1, first, w1.T, alpha=growth)
        _rectify(second, dropout.second if dropout else None)
        output = torch.addmm(hidden, second, w2.T, alpha=growth).add_(b2)
        fixed = eigenvectors, gradients, analysis
        ctx.save_for_backward(
            *fixed, hidden, decay, mixing, w0, w1, w2, coefficients, vectors, partners, features, first, second
        )
        ctx.growth = growth
        return output

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, ...]:
        eigenvectors, gradients, analysis, hidden, decay, mixing, w0, w1, w2, *kept = ctx.saved_tensors
        coefficients, vectors, partners, features, first, second = kept
        of_hidden, of_diffused, of_features = w0.chunk(3, dim=1)
        decayed, growth = decay * coefficients, ctx.growth
        grad_second = _rectify_backward(grad @ (growth * w2), second)
        grad_first = _rectify_backward(grad_second @ (growth * w1), first)
        grad_products = torch.ops.aten.tanh_backward(grad_first @ of_features, features)
        grad_mixed = (gradients.flatten(1, 2).T @ _weighted(vectors, grad_products)).view(2, *decayed.shape[:1], -1)
        grad_diffused = eigenvectors.T @ grad_first
        grad_decayed = (gradients.flatten(0, 1).T @ _weighted(partners, grad_products).view(-1, decayed.shape[1])).add_(
            grad_diffused @ of_diffused
        )
        grad_decayed += (grad_mixed @ mixing.mT).sum(dim=0)
        grad_hidden = torch.addmm(grad, grad_first, of_hidden).addmm_(analysis.T, grad_decayed * decay)
        grad_w0 = torch.cat([grad_first.T @ hidden, grad_diffused.T @ decayed, grad_first.T @ features], dim=1)
        return (
            grad_hidden,
            *(None, None, None),
            grad_decayed * coefficients,
            decayed.T @ grad_mixed,
            grad_w0,
            grad_first.sum(dim=0),
            growth * (grad_second.T @ first),
            grad_second.sum(dim=0),
            growth * (grad.T @ second),
            grad.sum(dim=0),
            None,
        )


def _inner_products(vectors: Float[Tensor, "n 2w"], partners: Float[Tensor, "n 2w"]) -> Float[Tensor, "n w"]:
    """Per point and channel, the inner product of two vectors of the tangent plane."""
    (x, y), (u, v) = vectors.chunk(2, dim=1), partners.chunk(2, dim=1)
    return (x * u).addcmul_(y, v)


def _weighted(vectors: Float[Tensor, "n 2w"], weights: Float[Tensor, "n w"]) -> Float[Tensor, "n 2w"]:
    """Both components of each vector times its weight."""
    n, width = weights.shape
    return (vectors.view(n, 2, width) * weights[:, None]).view(n, 2 * width)


def _rectify(activation: Float[Tensor, "n w"], kept: Bool[Tensor, "n w"] | None) -> None:
    """ReLU and dropout, in place."""
    activation.clamp_min_(0)
    if kept is not None:
        activation.mul_(kept)


def _rectify_backward(grad: Float[Tensor, "n w"], activation: Float[Tensor, "n w"]) -> Float[Tensor, "n w"]:
    """Where an activation is zero, by the ReLU or by dropout, nothing comes through."""
    blocked: Tensor = torch.ops.aten.threshold_backward(grad, activation, 0)
    return blocked
