"""Test-time adaptation: training a copy of a network on the pair that it is to match."""

from __future__ import annotations

import copy
from dataclasses import dataclass, field, replace

import torch

from homolog.core.errors import ArgumentError, TrainingError
from homolog.core.progress import Listener
from homolog.core.settings import Count, Settings
from homolog.features import DiffusionNet, NetworkFeatures
from homolog.geometry import Basis
from homolog.matching import Matcher, align_partial, orient
from homolog.pairs import Pair, PreprocessedShape
from homolog.training.losses import TOTAL
from homolog.training.objective import pair_losses
from homolog.training.quantities import TrainingShape
from homolog.training.samples import at_points, subsets
from homolog.training.settings import AugmentationSettings, LossSettings, OptimiserSettings, SampleSettings
from homolog.training.state import TrainingState


@dataclass(frozen=True, kw_only=True)
class AdaptationSettings(Settings):
    """How a network is adapted to a pair.

    Args:
        steps: updates of the weights.
        optimiser: how weights follow gradients. The learning rate is constant, and low: Adam's first steps are of that
            size for every weight, whatever the gradient.
        samples: on which points of the shapes.
        loss: the losses; functional maps have the matcher's size.
        augmentation: of the network's input.
        seed: of everything random.
    """

    steps: Count = 15
    optimiser: OptimiserSettings = field(default_factory=lambda: OptimiserSettings(learning_rate=1e-4))
    samples: SampleSettings = field(default_factory=SampleSettings)
    loss: LossSettings = field(default_factory=LossSettings)
    augmentation: AugmentationSettings = field(default_factory=AugmentationSettings)
    seed: int = 0


def adapt_to_pair(
    matcher: Matcher, pair: Pair, settings: AdaptationSettings, *, listener: Listener | None = None
) -> tuple[Matcher, Pair]:
    """Test-time adaptation: fine-tune a copy of a matcher's network on one pair, and compute the features anew.

    A mesh is also used as the cloud of its points, as in training. A cloud alone stands for its mesh.

    Args:
        matcher: with a network; stays as it is.
        pair: two preprocessed shapes.
        settings: how.
        listener: told of each step as it begins.

    Returns:
        A matcher with the adapted network, and the pair with its features, turned and aligned as it was trained on.

    Raises:
        ArgumentError: if the matcher has no network, or the losses do not fit the shapes that it is for.
        TrainingError: if a loss is not finite.
    """
    extractor = pair.extractor
    if not isinstance(extractor, NetworkFeatures):
        raise ArgumentError("adapting needs a network; give weights, and a method that uses them")
    if settings.loss.weights["orthogonality"] and not extractor.info.near_isometric:
        raise ArgumentError(
            f"the weights {extractor.info.name!r} are for shapes that are not near-isometric, but the losses of "
            "adapting are for those that are; leave --adapt out, or in Python give other losses"
        )
    pair = align_partial(orient(pair))
    loss = replace(settings.loss, map_eigenpairs=pair.map_size)
    network = copy.deepcopy(extractor.network).requires_grad_().train()
    sampled = (_training_shapes(matcher, shape, settings.samples) for shape in (pair.x, pair.y))
    _train(network, list(zip(*sampled, strict=True)), replace(settings, loss=loss), pair.is_partial, listener)
    adapted = matcher.with_extractor(replace(extractor, network=network.eval()))
    return adapted, pair.with_extractor(replace(extractor, network=network))


def _training_shapes(matcher: Matcher, shape: PreprocessedShape, settings: SampleSettings) -> list[TrainingShape]:
    """A shape at each of its subsets of points."""
    clean, mesh = shape.repaired.shape, shape.operators.basis
    cloud = mesh if clean.faces is None else _cloud_basis(matcher, shape)
    return [
        TrainingShape(clean.name, at_points(mesh, kept), at_points(cloud, kept)) for kept in subsets(mesh, settings)
    ]


def _cloud_basis(matcher: Matcher, shape: PreprocessedShape) -> Basis:
    scale = shape.operators.scale
    cloud = matcher.preprocess.operators(shape.repaired.shape, as_cloud=True, scale=scale).basis
    return replace(cloud, points=shape.operators.basis.points)  # of the same points, wherever a part was aligned


def _train(
    network: DiffusionNet,
    pairs: list[tuple[TrainingShape, TrainingShape]],
    settings: AdaptationSettings,
    partial: bool,
    listener: Listener | None,
) -> None:
    state = TrainingState.of(network, settings.optimiser)
    generator = torch.Generator(next(network.parameters()).device).manual_seed(settings.seed)
    for step in range(settings.steps):
        if listener is not None:
            listener(f"adapt, step {step + 1} of {settings.steps}")
        x, y = pairs[step % len(pairs)]
        losses = pair_losses(
            network,
            x,
            y,
            settings=settings.loss,
            augmentation=settings.augmentation,
            generator=generator,
            partial=partial,
        )
        network.zero_grad()
        torch.autograd.backward(losses[TOTAL])
        norm = torch.nn.utils.clip_grad_norm_(network.parameters(), settings.optimiser.gradient_clip or float("inf"))
        if not torch.isfinite(losses[TOTAL] + norm):
            raise TrainingError(f"adapting to {x.name} and {y.name}: the loss of step {step + 1} is not finite")
        state.take_step(settings.optimiser.learning_rate, 0.0)
