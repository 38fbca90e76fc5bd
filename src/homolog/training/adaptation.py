"""Test-time adaptation: training a copy of a network on the pair that it is to match."""

from __future__ import annotations

import copy
from dataclasses import dataclass, field, replace

import torch

from homolog.core.errors import ArgumentError, TrainingError
from homolog.core.progress import Listener
from homolog.core.settings import Count, Settings
from homolog.features import DiffusionNet
from homolog.geometry import Basis
from homolog.matching import Matcher, Prepared, Side
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
    matcher: Matcher,
    source: Prepared,
    target: Prepared,
    settings: AdaptationSettings,
    *,
    partial: Side | None = None,
    listener: Listener | None = None,
) -> tuple[Matcher, Prepared, Prepared]:
    """Train a copy of a matcher's network on one pair, and compute the features anew.

    A mesh is also used as the cloud of its points, as in training. A cloud alone stands for its mesh.

    Args:
        matcher: with a network; it is not changed.
        source: a prepared shape.
        target: another.
        settings: how.
        partial: which of the two, if any, is a part of a shape like the other.
        listener: called at each step.

    Returns:
        A matcher with the adapted network, and both shapes with its features.

    Raises:
        ArgumentError: if the matcher has no network, or the losses do not fit the shapes that it is for.
        TrainingError: if a loss is not finite.
    """
    if matcher.network is None:
        raise ArgumentError("adapting needs a network; give weights, and a method that uses them")
    if settings.loss.weights["orthogonality"] and not matcher.info.near_isometric:
        raise ArgumentError(
            f"the weights {matcher.info.name!r} are for shapes that are not near-isometric, but the losses of adapting "
            "are for those that are; leave --adapt out, or in Python give other losses"
        )
    if partial == "source":
        source = matcher.placed(target, source)
    elif partial == "target":
        target = matcher.placed(source, target)
    loss = replace(settings.loss, map_eigenpairs=matcher.map_size(partial=partial is not None))
    network = copy.deepcopy(matcher.network).requires_grad_().train()
    pairs = _training_pairs(matcher, source, target, settings, partial)
    _train(network, pairs, replace(settings, loss=loss), partial, listener)
    adapted = matcher.with_network(network)
    return adapted, _with_features(adapted, source), _with_features(adapted, target)


def _with_features(matcher: Matcher, shape: Prepared) -> Prepared:
    return replace(shape, features=matcher.features(shape.operators))


def _training_pairs(
    matcher: Matcher, source: Prepared, target: Prepared, settings: AdaptationSettings, partial: Side | None
) -> list[tuple[TrainingShape, TrainingShape]]:
    """The pair at each of its subsets of points; the full shape comes first."""
    x, y = (target, source) if partial == "source" else (source, target)
    sampled = (_training_shapes(matcher, shape, settings.samples) for shape in (x, y))
    return list(zip(*sampled, strict=True))


def _training_shapes(matcher: Matcher, prepared: Prepared, settings: SampleSettings) -> list[TrainingShape]:
    shape, mesh = prepared.repaired.shape, prepared.operators.basis
    cloud = mesh if shape.faces is None else _cloud_basis(matcher, prepared)
    return [
        TrainingShape(shape.name, at_points(mesh, kept), at_points(cloud, kept)) for kept in subsets(mesh, settings)
    ]


def _cloud_basis(matcher: Matcher, prepared: Prepared) -> Basis:
    scale = prepared.operators.scale
    cloud = matcher.operators(prepared.repaired.shape, as_cloud=True, scale=scale).basis
    return replace(
        cloud, points=prepared.operators.basis.points
    )  # a partial shape's points are aligned


def _train(
    network: DiffusionNet,
    pairs: list[tuple[TrainingShape, TrainingShape]],
    settings: AdaptationSettings,
    partial: Side | None,
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
            partial=partial is not None,
        )
        network.zero_grad()
        torch.autograd.backward(losses[TOTAL])
        norm = torch.nn.utils.clip_grad_norm_(network.parameters(), settings.optimiser.gradient_clip or float("inf"))
        if not torch.isfinite(losses[TOTAL] + norm):
            raise TrainingError(f"adapting to {x.name} and {y.name}: the loss of step {step + 1} is not finite")
        state.take_step(settings.optimiser.learning_rate, 0.0)
