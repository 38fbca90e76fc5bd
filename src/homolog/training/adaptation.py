"""Test-time adaptation: training a copy of a network on the pair that it is to match."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import torch

from homolog.core.errors import ArgumentError, TrainingError
from homolog.core.progress import Listener
from homolog.core.settings import Count, Settings
from homolog.features import DiffusionNet, FeatureInfo, NetworkFeatures, NetworkInput
from homolog.matching import Matcher, align_parts, map_misfit, orient
from homolog.pairs import Pair, PairAdaptation, PreprocessedShape
from homolog.training.losses import TOTAL
from homolog.training.objective import pair_losses
from homolog.training.quantities import TrainingShape
from homolog.training.samples import at_points, subsets
from homolog.training.settings import AugmentationSettings, LossSettings, OptimiserSettings, SampleSettings
from homolog.training.state import TrainingState

# For weights of shapes that are not near-isometric, which stand alike: as the recipe organs has it.
_OTHER_LOSSES = {"bijectivity": 0.0, "orthogonality": 0.0, "alignment": 0.0, "infonce": 0.1, "registration": 1.0}
_OTHER_AUGMENTATION = AugmentationSettings(turn="none", least_scale=1.0, most_scale=1.0, jitter=0.005)


@dataclass(frozen=True, kw_only=True)
class AdaptationSettings(Settings):
    """How a network is adapted to a pair.

    Args:
        steps: updates of the weights.
        optimiser: how weights follow gradients. The learning rate is constant, and low: Adam's first steps are of that
            size for every weight, whatever the gradient.
        samples: on which points of the shapes.
        loss: the losses; functional maps have the matcher's size. By default those of training; where the weights are
            for shapes that are not near-isometric, those of the recipe ``organs``, without any for near-isometric ones.
        augmentation: of the network's input; by default likewise.
        seed: of everything random.
    """

    steps: Count = 40
    optimiser: OptimiserSettings = field(default_factory=lambda: OptimiserSettings(learning_rate=1e-4))
    samples: SampleSettings = field(default_factory=SampleSettings)
    loss: LossSettings | None = None
    augmentation: AugmentationSettings | None = None
    seed: int = 0

    def loss_for(self, info: FeatureInfo) -> LossSettings:
        """The losses for features that expect such shapes."""
        if self.loss is not None:
            return self.loss
        return (
            LossSettings()
            if info.near_isometric
            else LossSettings(weights=_OTHER_LOSSES, soft_temperature=info.temperature)
        )

    def augmentation_for(self, info: FeatureInfo) -> AugmentationSettings:
        """The augmentation for features that expect such shapes."""
        return self.augmentation or (AugmentationSettings() if info.near_isometric else _OTHER_AUGMENTATION)


def adapt_if_better(
    matcher: Matcher, pair: Pair, settings: AdaptationSettings, *, listener: Listener | None = None
) -> tuple[Matcher, Pair]:
    """``adapt_to_pair`` with a guard: only where the adapted features lead to a map that contradicts itself less.

    The score is ``homolog.matching.map_misfit``. Where it does not fall, and where the pair is one for which a method
    without a network was chosen, matcher and pair are those that were given. ``Pair.adaptation``, and so the match's
    report, has both scores and which of the two was kept. New here.

    Args:
        matcher: that made the pair; stays as it is.
        pair: two preprocessed shapes.
        settings: how.
        listener: told of each step as it begins.

    Raises:
        ArgumentError: if the pair's features come from no network, and nothing else was asked for.
        ShapeError: if the shapes cannot be matched.
        TrainingError: if a loss is not finite.

    Examples:
        >>> matcher = homolog.Matcher.from_weights()  # doctest: +SKIP
        >>> pair, _ = matcher.pair("a.ply", "b.ply")  # doctest: +SKIP
        >>> matcher, pair = adapt_if_better(matcher, pair, AdaptationSettings())  # doctest: +SKIP
        >>> matcher.match_pair(pair).report["adaptation"]["kept"]  # doctest: +SKIP
        True
    """
    if pair.choice and not isinstance(pair.extractor, NetworkFeatures):
        return matcher, replace(pair, adaptation=PairAdaptation(0))
    adapted, after = adapt_to_pair(matcher, pair, settings, listener=listener)
    plain, other = (map_misfit(one.find(its), its.settings.choice) for one, its in ((matcher, pair), (adapted, after)))
    told = PairAdaptation(settings.steps, plain, other, kept=other < plain)
    return (adapted, replace(after, adaptation=told)) if told.kept else (matcher, replace(pair, adaptation=told))


def adapt_to_pair(
    matcher: Matcher, pair: Pair, settings: AdaptationSettings, *, listener: Listener | None = None
) -> tuple[Matcher, Pair]:
    """Test-time adaptation: fine-tune a copy of a matcher's network on one pair, and compute the features anew.

    A mesh is also used as the cloud of its points, as in training. A cloud alone stands for its mesh.

    Args:
        matcher: that made the pair; stays as it is.
        pair: two preprocessed shapes.
        settings: how.
        listener: told of each step as it begins.

    Returns:
        A matcher with the adapted network, and the pair with its features, turned and aligned as it was trained on.

    Raises:
        ArgumentError: if the pair's features come from no network, or both shapes are parts.
        TrainingError: if a loss is not finite.
    """
    _network_features(pair)
    if pair.are_parts:
        raise ArgumentError("partial is 'both', but a network is adapted to full shapes, or to a part and its whole")
    pair = align_parts(orient(pair))
    adapted = _adapted(matcher, [pair], settings, listener)
    return matcher.with_extractor(adapted), pair.with_extractor(adapted)


def adapt_to_pairs(
    matcher: Matcher, pairs: Sequence[Pair], settings: AdaptationSettings, *, listener: Listener | None = None
) -> NetworkFeatures:
    """Fine-tune one copy of a matcher's network on several pairs of full shapes of one kind; see ``adapt_to_pair``.

    Args:
        matcher: that made the pairs; stays as it is.
        pairs: of preprocessed shapes, with the same features; at least one.
        settings: how. Steps are those of all pairs together, which take turns.
        listener: told of each step as it begins.

    Raises:
        ArgumentError: if the pairs' features come from no network.
        TrainingError: if a loss is not finite.
    """
    _network_features(pairs[0])
    return _adapted(matcher, [orient(pair) for pair in pairs], settings, listener)


def _network_features(pair: Pair) -> NetworkFeatures:
    if not isinstance(pair.extractor, NetworkFeatures):
        raise ArgumentError("adapt is given, but there is no network; give weights, and a method that uses them")
    return pair.extractor


def _adapted(
    matcher: Matcher, pairs: Sequence[Pair], settings: AdaptationSettings, listener: Listener | None
) -> NetworkFeatures:
    """The features of a copy of the network, trained on pairs that are the right way round."""
    first, extractor = pairs[0], _network_features(pairs[0])
    loss = replace(settings.loss_for(extractor.info), map_eigenpairs=first.map_size)
    settings = replace(settings, augmentation=settings.augmentation_for(extractor.info))
    network = copy.deepcopy(extractor.network).requires_grad_().train()
    sampled = [
        zip(*(_training_shapes(matcher, shape, settings.samples) for shape in (pair.x, pair.y)), strict=True)
        for pair in pairs
    ]
    in_turns = [both for turn in zip(*sampled, strict=True) for both in turn]
    _train(network, in_turns, settings, loss, first.is_partial, extractor.info.input, listener)
    return replace(extractor, network=network.eval())


def _training_shapes(matcher: Matcher, shape: PreprocessedShape, settings: SampleSettings) -> list[TrainingShape]:
    """A shape at each of its subsets of points."""
    clean, mesh = shape.repaired.shape, shape.operators.basis
    cloud = mesh
    if clean.faces is not None:  # of the same points, wherever a part was aligned
        of_points = matcher.preprocess.operators(clean, as_cloud=True, scale=shape.operators.scale).basis
        cloud = replace(of_points, points=mesh.points)
    return [
        TrainingShape(clean.name, at_points(mesh, kept), at_points(cloud, kept)) for kept in subsets(mesh, settings)
    ]


def _train(
    network: DiffusionNet,
    pairs: list[tuple[TrainingShape, TrainingShape]],
    settings: AdaptationSettings,
    loss: LossSettings,
    partial: bool,
    features_from: NetworkInput,
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
            settings=loss,
            augmentation=settings.augmentation,
            generator=generator,
            partial=partial,
            features_from=features_from,
        )
        network.zero_grad()
        torch.autograd.backward(losses[TOTAL])
        norm = torch.nn.utils.clip_grad_norm_(network.parameters(), settings.optimiser.gradient_clip or float("inf"))
        if not torch.isfinite(losses[TOTAL] + norm):
            raise TrainingError(f"adapting to {x.name} and {y.name}: the loss of step {step + 1} is not finite")
        state.take_step(settings.optimiser.learning_rate, 0.0)
