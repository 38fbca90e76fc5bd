"""The arithmetic of a diffusion block, with its derivative by hand.

Nearly all of it is matrix products; what lies between them is kept to a few passes over memory, and the derivative to
what those products need. The slow, readable form is in the tests.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate
from typing import Any, NamedTuple

import torch
from jaxtyping import Float, UInt8
from torch import Tensor
from torch.autograd.function import once_differentiable

from homolog.geometry import Basis


class Stack:
    """Shapes of which the points lie one below the other, and so do the coefficients.

    What is done to each point is then done to those of all shapes at once.

    Args:
        bases: of the shapes.
        dtype: what to compute in; by default what they are in.
    """

    def __init__(self, bases: Sequence[Basis], dtype: torch.dtype | None = None) -> None:
        bases = bases if dtype is None else [basis.in_precision(dtype) for basis in bases]
        self.eigenvalues = torch.cat([basis.eigenvalues for basis in bases])
        points = _slices([basis.n_points for basis in bases])
        pairs = _slices([len(basis.eigenvalues) for basis in bases])
        self._parts = list(zip(bases, points, pairs, strict=True))

    def coefficients(self, functions: Float[Tensor, "n w"]) -> Float[Tensor, "k w"]:
        """The spectral coefficients of functions."""
        found = functions.new_empty(len(self.eigenvalues), functions.shape[1])
        for basis, points, pairs in self._parts:
            torch.mm(basis.pseudo_inverse, functions[points], out=found[pairs])
        return found

    def synthesised(
        self, for_gradients: Float[Tensor, "k w"], for_values: Float[Tensor, "k w"], values: Float[Tensor, "n w"]
    ) -> Float[Tensor, "n 2w"]:
        """Gradients of the functions with some coefficients; to ``values``, those with the others are added."""
        n, width = values.shape
        gradients = values.new_empty(2 * n, width)
        for basis, points, pairs in self._parts:
            values[points].addmm_(basis.eigenvectors, for_values[pairs])
            both = slice(2 * points.start, 2 * points.stop)
            torch.mm(basis.gradients.flatten(0, 1), for_gradients[pairs], out=gradients[both])
        return gradients.view(n, 2 * width)

    def back(
        self,
        grad_values: Float[Tensor, "n w"],
        vectors: Float[Tensor, "n 2w"],
        partners: Float[Tensor, "n 2w"],
        grad_products: Float[Tensor, "n w"],
    ) -> tuple[Float[Tensor, "k w"], Float[Tensor, "k w"], Float[Tensor, "2 k 2w"]]:
        """From values, and from the products of vectors with their partners, to the coefficients.

        Returns:
            What is asked for of the coefficients of the values, of those of the vectors, and, per component of the
            eigenvectors' gradients, of those of the partners.
        """
        width = grad_values.shape[1]
        of_values, of_vectors = (grad_values.new_empty(len(self.eigenvalues), width) for _ in range(2))
        of_partners = grad_values.new_empty(2, len(self.eigenvalues), 2 * width)
        for basis, points, pairs in self._parts:
            torch.mm(basis.eigenvectors.T, grad_values[points], out=of_values[pairs])
            weighted = _weighted(partners[points], grad_products[points]).view(-1, width)
            torch.mm(basis.gradients.flatten(0, 1).T, weighted, out=of_vectors[pairs])
            weighted = _weighted(vectors[points], grad_products[points])
            for component in (0, 1):
                torch.mm(basis.gradients[:, component].T, weighted, out=of_partners[component, pairs])
        return of_values, of_vectors, of_partners

    def add_back(self, grad: Float[Tensor, "n w"], coefficients: Float[Tensor, "k w"]) -> Float[Tensor, "n w"]:
        """Add, in place, what coefficients ask for of the functions that they are of."""
        for basis, points, pairs in self._parts:
            grad[points].addmm_(basis.pseudo_inverse.T, coefficients[pairs])
        return grad


def _slices(sizes: Sequence[int]) -> list[slice]:
    ends = list(accumulate(sizes))
    return [slice(end - size, end) for size, end in zip(sizes, ends, strict=True)]


class Dropout(NamedTuple):
    """Which hidden activations to keep in the two inner layers of a perceptron, and by how much they then grow."""

    first: UInt8[Tensor, "n w"]
    second: UInt8[Tensor, "n w"]
    growth: float


def diffusion_block(
    hidden: Float[Tensor, "n w"],
    stack: Stack,
    decay: Float[Tensor, "k w"],
    mixing: Float[Tensor, "2w 2w"],
    perceptron: Sequence[Tensor],
    dropout: Dropout | None,
) -> Float[Tensor, "n w"]:
    """Diffusion, gradient features and a perceptron per point, with a skip.

    Args:
        hidden: channels per point, of all shapes.
        stack: the shapes.
        decay: by what diffusion multiplies each coefficient of each channel.
        mixing: takes the two components of all channels' gradients, one after the other, to those of the combinations
            that each channel's gradient is multiplied with.
        perceptron: weights and biases of its three layers in turn; its inputs are the channels, the diffused channels
            and the gradient features, side by side.
        dropout: None to keep everything.
    """
    # Products that write into given places know nothing of autocast: what comes in decides the precision.
    with torch.autocast(hidden.device.type, enabled=False):
        weights = [weight.to(hidden.dtype) for weight in (decay, mixing, *perceptron)]
        output: Tensor = _Block.apply(hidden, stack, *weights, dropout)  # type: ignore[no-untyped-call]
    return output


class _Block(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,
        hidden: Tensor,
        stack: Stack,
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
        coefficients = stack.coefficients(hidden)
        # What is linear is done to the coefficients where it can be: they have k rows instead of n.
        decayed = decay * coefficients
        first = torch.addmm(b0, hidden, of_hidden.T)
        vectors = stack.synthesised(decayed, decayed @ of_diffused.T, first)
        partners = vectors @ mixing
        (x, y), (u, v) = vectors.chunk(2, dim=1), partners.chunk(2, dim=1)
        features = (x * u).addcmul_(y, v).tanh_()  # of the inner products of both vectors
        _rectify(first.addmm_(features, of_features.T), dropout.first if dropout else None)
        second = torch.addmm(b1, first, w1.T, alpha=growth)
        _rectify(second, dropout.second if dropout else None)
        ctx.save_for_backward(
            hidden, decay, mixing, w0, w1, w2, coefficients, vectors, partners, features, first, second
        )
        ctx.stack, ctx.growth = stack, growth
        return (hidden + b2).addmm_(second, w2.T, alpha=growth)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, ...]:
        hidden, decay, mixing, w0, w1, w2, coefficients, vectors, partners, features, first, second = ctx.saved_tensors
        of_hidden, of_diffused, of_features = w0.chunk(3, dim=1)
        decayed, growth = decay * coefficients, ctx.growth
        grad_second = _rectify_backward(grad @ (growth * w2), second)
        grad_first = _rectify_backward(grad_second @ (growth * w1), first)
        grad_features = grad_first @ of_features
        grad_products = torch.ops.aten.tanh_backward.grad_input(grad_features, features, grad_input=grad_features)
        grad_diffused, grad_decayed, grad_mixed = ctx.stack.back(grad_first, vectors, partners, grad_products)
        grad_decayed.addmm_(grad_diffused, of_diffused)
        for of_component, mixed in zip(mixing.chunk(2), grad_mixed, strict=True):
            grad_decayed.addmm_(mixed, of_component.T)
        grad_hidden = ctx.stack.add_back(torch.addmm(grad, grad_first, of_hidden), grad_decayed * decay)
        inputs = (grad_first, hidden), (grad_diffused, decayed), (grad_first, features)
        return (
            grad_hidden,
            None,
            grad_decayed * coefficients,
            (decayed.T @ grad_mixed).flatten(0, 1),
            _side_by_side(torch.empty_like(w0), inputs),
            grad_first.sum(dim=0),
            (grad_second.T @ first).mul_(growth),
            grad_second.sum(dim=0),
            (grad.T @ second).mul_(growth),
            grad.sum(dim=0),
            None,
        )


def _weighted(vectors: Float[Tensor, "n 2w"], weights: Float[Tensor, "n w"]) -> Float[Tensor, "n 2w"]:
    """Both components of each vector times its weight."""
    n, width = weights.shape
    return (vectors.view(n, 2, width) * weights[:, None]).view(n, 2 * width)


def _rectify(activation: Float[Tensor, "n w"], kept: UInt8[Tensor, "n w"] | None) -> None:
    """ReLU and dropout, in place."""
    activation.clamp_min_(0)
    if kept is not None:
        activation.mul_(kept)


def _rectify_backward(grad: Float[Tensor, "n w"], activation: Float[Tensor, "n w"]) -> Float[Tensor, "n w"]:
    """Where an activation is zero, by the ReLU or by dropout, nothing comes through; in place."""
    blocked: Tensor = torch.ops.aten.threshold_backward.grad_input(grad, activation, 0, grad_input=grad)
    return blocked


def _side_by_side(
    place: Float[Tensor, "w 3w"], factors: Sequence[tuple[Float[Tensor, "r w"], Float[Tensor, "r w"]]]
) -> Float[Tensor, "w 3w"]:
    """Products of pairs of matrices, the first ones transposed, in that place."""
    for part, (left, right) in zip(place.chunk(len(factors), dim=1), factors, strict=True):
        torch.mm(left.T, right, out=part)
    return place
