"""DiffusionNet: a network on shapes that does not depend on how they are sampled.

Sharp, Attaiki, Crane and Ovsjanikov, "DiffusionNet: Discretization Agnostic Learning on Surfaces", ACM TOG 2022.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import torch
from jaxtyping import Float, UInt8
from torch import Tensor, nn

from homolog.core.settings import Count, Settings, Share
from homolog.features.block import Dropout, Stack, diffusion_block
from homolog.geometry import Basis, Operators

GradientProduct = Literal["equivariant", "published"]
"""How the components of a gradient are multiplied with a complex matrix A = A_re + i A_im.

``"equivariant"``: as complex numbers, so that a turn of the tangent frames changes nothing (the paper's equation 8);
``"published"``: imaginary part A_re x + A_im y, the order that the authors' released weights were trained with.
"""

# Diffusion times cannot become negative: heat does not flow backwards.
_SHORTEST_TIME = 1e-8

# Shapes go through the network together up to this many points: that makes fewer and larger operations, but what lies
# between them should stay in the processor's cache.
_POINTS_TOGETHER = 8192

# Of each of the eight bytes of a number.
_LOWEST_BITS = 0x0101010101010101


@dataclass(frozen=True)
class NetworkSettings(Settings):
    """The architecture, stored beside the weights.

    Args:
        in_channels: channels of the input; 3 for positions.
        out_channels: channels of the features.
        width: channels inside.
        blocks: number of diffusion blocks.
        dropout: share of hidden activations dropped in training, below one; rounded to 1/256.
        gradient_product: ``"equivariant"``, or ``"published"`` for the weights that the paper's authors released.
    """

    in_channels: Count = 3
    out_channels: Count = 128
    width: Count = 128
    blocks: Count = 4
    dropout: Share = 0.5
    gradient_product: GradientProduct = "equivariant"


class DiffusionNet(nn.Module):
    """Features per point from positions and operators; the same weights serve meshes and clouds."""

    def __init__(self, settings: NetworkSettings | None = None) -> None:
        super().__init__()
        self.settings = settings = settings or NetworkSettings()
        self.first = nn.Linear(settings.in_channels, settings.width)
        self.blocks = nn.ModuleList(DiffusionBlock(settings) for _ in range(settings.blocks))
        self.last = nn.Linear(settings.width, settings.out_channels)

    def forward(
        self,
        inputs: Float[Tensor, "n i"],
        operators: Operators | Basis,
        *,
        generator: torch.Generator | None = None,
    ) -> Float[Tensor, "n o"]:
        """Features (n, out_channels) of the inputs (n, in_channels), a function of these and the operators alone.

        Args:
            inputs: channels per point.
            operators: of the shape, or their basis at the points of the inputs.
            generator: of what dropout drops in training.
        """
        basis = operators if isinstance(operators, Basis) else operators.basis
        return self.several([inputs], [basis], generator=generator)[0]

    def several(
        self,
        inputs: Sequence[Float[Tensor, "n i"]],
        bases: Sequence[Basis],
        *,
        generator: torch.Generator | None = None,
    ) -> list[Float[Tensor, "n o"]]:
        """Features of several shapes, of small ones in less time than of one after the other.

        Args:
            inputs: of each shape, channels per point.
            bases: of the shapes, at the points of the inputs.
            generator: of what dropout drops in training.
        """
        features: list[Tensor] = []
        for some in _groups([len(each) for each in inputs]):
            features += self._together(inputs[some], bases[some], generator)
        return features

    def _together(
        self, inputs: Sequence[Float[Tensor, "n i"]], bases: Sequence[Basis], generator: torch.Generator | None
    ) -> Sequence[Float[Tensor, "n o"]]:
        hidden = self.first(torch.cat(list(inputs)))
        stack = Stack(bases, hidden.dtype)
        for block in self.blocks:
            hidden = block(hidden, stack, generator)
        return torch.split(self.last(hidden).to(inputs[0].dtype), [len(each) for each in inputs])


def _groups(sizes: Sequence[int]) -> Iterator[slice]:
    """Which consecutive shapes to take together: as many as have up to so many points, or a larger one alone."""
    start = points = 0
    for place, size in enumerate(sizes):
        if place > start and points + size > _POINTS_TOGETHER:
            yield slice(start, place)
            start, points = place, 0
        points += size
    yield slice(start, len(sizes))


class DiffusionBlock(nn.Module):
    """Diffusion for a learned time per channel, gradient features, and a perceptron per point, with a skip."""

    def __init__(self, settings: NetworkSettings) -> None:
        super().__init__()
        width = settings.width
        self.times = nn.Parameter(torch.zeros(width))
        self.real = nn.Linear(width, width, bias=False)
        self.imaginary = nn.Linear(width, width, bias=False)
        self.perceptron = nn.ModuleList([nn.Linear(3 * width, width), nn.Linear(width, width), nn.Linear(width, width)])
        # Of every 256 activations, at least one is kept.
        self.dropped = min(round(256 * settings.dropout), 255)
        self.gradient_product = settings.gradient_product

    def forward(
        self, hidden: Float[Tensor, "n w"], stack: Stack, generator: torch.Generator | None = None
    ) -> Float[Tensor, "n w"]:
        """The block's output, of the same shape as its input."""
        dropout = None
        if self.training and self.dropped:
            kept = _kept(hidden, self.dropped, generator), _kept(hidden, self.dropped, generator)
            dropout = Dropout(*kept, growth=256 / (256 - self.dropped))
        decay = heat_decay(stack.eigenvalues, self.times)
        return diffusion_block(hidden, stack, decay, self._mixing(), list(self.perceptron.parameters()), dropout)

    def _mixing(self) -> Float[Tensor, "2w 2w"]:
        """What takes gradients (x, y) to those multiplied with the complex matrix A, both components side by side."""
        real, imaginary = self.real.weight.T, self.imaginary.weight.T
        to_y = [real, imaginary] if self.gradient_product == "published" else [imaginary, real]
        return torch.cat([torch.cat([real, to_y[0]], dim=1), torch.cat([-imaginary, to_y[1]], dim=1)])


def heat_decay(eigenvalues: Float[Tensor, " k"], times: Float[Tensor, " c"]) -> Float[Tensor, "k c"]:
    """By what heat diffusion multiplies the coefficients of functions, each for its own time.

    What is far below rounding is zero. Long times would leave numbers too small for the ordinary format, with which
    processors multiply a hundred times more slowly: trained networks took twice as long as new ones.
    """
    positive: Tensor = _AtLeastShortest.apply(times)  # type: ignore[no-untyped-call]
    decay = torch.exp(-eigenvalues[:, None] * positive)
    return decay.masked_fill(decay < torch.finfo(decay.dtype).eps ** 2, 0.0)


class _AtLeastShortest(torch.autograd.Function):
    """Times bounded from below, with a gradient that can lift those below the bound: all begin at zero."""

    @staticmethod
    def forward(ctx: Any, times: Tensor) -> Tensor:
        ctx.save_for_backward(times)
        return times.clamp(min=_SHORTEST_TIME)

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> Tensor:
        (times,) = ctx.saved_tensors
        return torch.where((times < _SHORTEST_TIME) & (grad > 0), 0.0, grad)


def _kept(like: Float[Tensor, "n w"], dropped: int, generator: torch.Generator | None) -> UInt8[Tensor, "n w"]:
    """What dropout keeps if it drops so many of 256: one for what is kept, zero for the rest.

    Drawing is slow, so each drawn number makes 64 fair bits, and these are combined to the share wanted.
    """
    bits = torch.zeros(like.numel() // 64 + 1, dtype=torch.int64, device=like.device)
    for digit in f"{256 - dropped:08b}".rstrip("0")[::-1]:
        # With a fair coin for each binary digit of the share, from the last: what was p becomes p/2, or 1/2 + p/2.
        coins = torch.empty_like(bits).random_(-(2**63), None, generator=generator)
        bits = coins | bits if digit == "1" else coins & bits
    shifts = torch.arange(8, device=like.device)[:, None]
    return ((bits >> shifts) & _LOWEST_BITS).view(torch.uint8).flatten()[: like.numel()].view(like.shape)
