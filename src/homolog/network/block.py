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
        hidden, basis.synthesis, basis.analysis, decay, mixing, *perceptron, dropout
    )
    return output


class _Block(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,
        hidden: Tensor,
        synthesis: Tensor,
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
        width = hidden.shape[1]
        growth = dropout.growth if dropout else 1.0
        coefficients = analysis @ hidden
        # Per point: the diffused channels, then the x and the y components of their gradients.
        decayed = decay * coefficients
        spread = (synthesis.flatten(0, 1) @ decayed).view(len(hidden), 3 * width)
        diffused, gradient = spread[:, :width], spread[:, width:]
        # Channels are mixed while they are coefficients: k rows instead of n, and a third less to derive.
        mixed = synthesis[:, 1:].flatten(1, 2) @ (decayed @ mixing).flatten(0, 1)
        features = _inner_products(gradient, mixed).tanh_()
        first = torch.addmm(b0, hidden, w0[:, :width].T)
        first.addmm_(diffused, w0[:, width : 2 * width].T).addmm_(features, w0[:, 2 * width :].T)
        _rectify(first, dropout.first if dropout else None)
        second = torch.addmm(b1, first, w1.T, alpha=growth)
        _rectify(second, dropout.second if dropout else None)
        output = torch.addmm(hidden, second, w2.T, alpha=growth).add_(b2)
        ctx.save_for_backward(
            hidden, synthesis, analysis, decay, mixing, w0, w1, w2, coefficients, spread, mixed, features, first, second
        )
        ctx.growth = growth
        return output

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, ...]:
        saved = ctx.saved_tensors
        hidden, synthesis, analysis, decay, mixing, w0, w1, w2, coefficients, spread, mixed, features, first, second = (
            saved
        )
        width, growth = hidden.shape[1], ctx.growth
        diffused, gradient = spread[:, :width], spread[:, width:]
        grad_second = _rectify_backward(torch.mm(grad, w2 * growth), second)
        grad_first = _rectify_backward(torch.mm(grad_second, w1 * growth), first)
        grad_products = torch.ops.aten.tanh_backward(grad_first @ w0[:, 2 * width :], features)
        grad_combined = _components(synthesis[:, 1:].flatten(1, 2).T @ _weighted(gradient, grad_products))
        grad_spread = torch.empty_like(spread)
        torch.mm(grad_first, w0[:, width : 2 * width], out=grad_spread[:, :width])
        _weighted(mixed, grad_products, out=grad_spread[:, width:])
        grad_decayed = synthesis.flatten(0, 1).T @ grad_spread.view(-1, width)
        grad_decayed += (grad_combined @ mixing.mT).sum(dim=0)
        decayed = decay * coefficients
        grad_hidden = torch.addmm(grad, grad_first, w0[:, :width]).addmm_(analysis.T, grad_decayed * decay)
        grad_w0 = torch.cat([grad_first.T @ part for part in (hidden, diffused, features)], dim=1)
        return (
            grad_hidden,
            None,
            None,
            grad_decayed * coefficients,
            decayed.T @ grad_combined,
            grad_w0,
            grad_first.sum(dim=0),
            growth * (grad_second.T @ first),
            grad_second.sum(dim=0),
            growth * (grad.T @ second),
            grad.sum(dim=0),
            None,
        )


def _inner_products(gradient: Float[Tensor, "n 2w"], mixed: Float[Tensor, "n 2w"]) -> Float[Tensor, "n w"]:
    """Per point and channel, the inner product of two vectors of the tangent plane."""
    (x, y), (u, v) = gradient.chunk(2, dim=1), mixed.chunk(2, dim=1)
    return (x * u).addcmul_(y, v)


def _components(stacked: Float[Tensor, "2k 2w"]) -> Float[Tensor, "2 k 2w"]:
    return stacked.view(2, -1, stacked.shape[1])


def _weighted(
    vectors: Float[Tensor, "n 2w"], weights: Float[Tensor, "n w"], out: Float[Tensor, "n 2w"] | None = None
) -> Float[Tensor, "n 2w"]:
    """Both components of each vector times its weight."""
    out = torch.empty_like(vectors, memory_format=torch.contiguous_format) if out is None else out
    width = weights.shape[1]
    torch.mul(vectors[:, :width], weights, out=out[:, :width])
    torch.mul(vectors[:, width:], weights, out=out[:, width:])
    return out


def _rectify(activation: Float[Tensor, "n w"], kept: Bool[Tensor, "n w"] | None) -> None:
    """ReLU and dropout, in place."""
    activation.clamp_min_(0)
    if kept is not None:
        activation.mul_(kept)


def _rectify_backward(grad: Float[Tensor, "n w"], activation: Float[Tensor, "n w"]) -> Float[Tensor, "n w"]:
    """Where an activation is zero, by the ReLU or by dropout, nothing comes through."""
    blocked: Tensor = torch.ops.aten.threshold_backward(grad, activation, 0)
    return blocked
