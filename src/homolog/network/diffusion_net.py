"""DiffusionNet: a network on shapes that does not depend on how they are sampled.

Sharp, Attaiki, Crane and Ovsjanikov, "DiffusionNet: Discretization Agnostic Learning on Surfaces", ACM TOG 2022.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import torch
from jaxtyping import Float
from torch import Tensor, nn

from homolog.errors import bad_choice
from homolog.geometry import Operators

# How the components of a gradient are multiplied with a complex matrix A = A_re + i A_im:
# "equivariant": as complex numbers, so that a turn of the tangent frames changes nothing (the paper's equation 8);
# "published": imaginary part A_re x + A_im y, the order that the authors' released weights were trained with.
GradientProduct = Literal["equivariant", "published"]

# Diffusion times cannot become negative: heat does not flow backwards.
_SHORTEST_TIME = 1e-8


@dataclass(frozen=True)
class NetworkSettings:
    """The architecture, stored beside the weights.

    Args:
        in_channels: channels of the input; 3 for positions.
        out_channels: channels of the features.
        width: channels inside.
        blocks: number of diffusion blocks.
        dropout: share of hidden activations dropped in training.
        gradient_product: ``"equivariant"``, or ``"published"`` for the weights that the paper's authors released.
    """

    in_channels: int = 3
    out_channels: int = 128
    width: int = 128
    blocks: int = 4
    dropout: float = 0.5
    gradient_product: GradientProduct = "equivariant"


class DiffusionNet(nn.Module):
    """Features per point from positions and operators; the same weights serve meshes and clouds."""

    def __init__(self, settings: NetworkSettings | None = None) -> None:
        super().__init__()
        self.settings = settings = settings or NetworkSettings()
        if settings.gradient_product not in get_args(GradientProduct):
            raise bad_choice("gradient_product", settings.gradient_product, get_args(GradientProduct))
        self.first = nn.Linear(settings.in_channels, settings.width)
        self.blocks = nn.ModuleList(DiffusionBlock(settings) for _ in range(settings.blocks))
        self.last = nn.Linear(settings.width, settings.out_channels)

    def forward(self, inputs: Float[Tensor, "n i"], operators: Operators) -> Float[Tensor, "n o"]:
        """Features (n, out_channels) of the inputs (n, in_channels), a function of these and the operators alone."""
        hidden = self.first(inputs)
        for block in self.blocks:
            hidden = block(hidden, operators)
        features: Tensor = self.last(hidden)
        return features


class DiffusionBlock(nn.Module):
    """Diffusion for a learned time per channel, gradient features, and a perceptron per point, with a skip."""

    def __init__(self, settings: NetworkSettings) -> None:
        super().__init__()
        width = settings.width
        self.times = nn.Parameter(torch.zeros(width))
        self.real = nn.Linear(width, width, bias=False)
        self.imaginary = nn.Linear(width, width, bias=False)
        self.perceptron = nn.ModuleList([nn.Linear(3 * width, width), nn.Linear(width, width), nn.Linear(width, width)])
        self.dropout = nn.Dropout(settings.dropout)
        self.gradient_product = settings.gradient_product

    def forward(self, hidden: Float[Tensor, "n w"], operators: Operators) -> Float[Tensor, "n w"]:
        """The block's output, of the same shape as its input."""
        diffused = diffuse(hidden, self.times, operators)
        gradients = self._gradient_features(diffused, operators)
        activation = self.perceptron[0](torch.cat([hidden, diffused, gradients], dim=-1))
        for layer in self.perceptron[1:]:
            activation = layer(self.dropout(torch.relu(activation)))
        output: Tensor = hidden + activation
        return output

    def _gradient_features(self, diffused: Float[Tensor, "n w"], operators: Operators) -> Float[Tensor, "n w"]:
        """Tanh of the inner products between each channel's gradient and learned combinations of all channels'."""
        x, y = operators.gradient_x @ diffused, operators.gradient_y @ diffused
        real_x, imaginary_y = self.real(x), self.imaginary(y)
        published = self.gradient_product == "published"
        along_y = real_x + imaginary_y if published else self.real(y) + self.imaginary(x)
        return torch.tanh(x * (real_x - imaginary_y) + y * along_y)


def diffuse(functions: Float[Tensor, "n c"], times: Float[Tensor, " c"], operators: Operators) -> Float[Tensor, "n c"]:
    """Heat diffusion of functions on a shape, each for its own time, in the operators' eigenbasis."""
    decay = torch.exp(-operators.eigenvalues[:, None] * times.clamp(min=_SHORTEST_TIME))
    return operators.eigenvectors @ (decay * operators.coefficients(functions))
