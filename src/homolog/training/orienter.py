"""Training of the orienter: a network that tells, from one shape alone, how to turn it to stand as others do."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from homolog.core.errors import ArgumentError, TrainingError
from homolog.core.progress import Progress, ignore
from homolog.features import (
    ORIENTER_EIGENPAIRS,
    ORIENTER_NETWORK,
    ORIENTER_SAMPLES,
    DiffusionNet,
    Orienter,
    as_oriented,
    orienter_frame,
)
from homolog.geometry import Basis
from homolog.maps import Similarity
from homolog.training.augmentation import augmented, rotation_of
from homolog.training.schedule import learning_rate
from homolog.training.settings import AugmentationSettings, OptimiserSettings, OrienterSettings
from homolog.training.state import TrainingState
from homolog.training.store import MESH, ShapeStore

# An example takes 0.2 MB. Of each variant of a shape there are so many, or fewer if all would be more than that.
_EXAMPLES_PER_VARIANT, _MOST_EXAMPLES = 2, 4000
# How positions are varied before they are turned; the jitter is drawn anew for each shape, up to this.
_VARIED = AugmentationSettings(turn="none", least_scale=0.85, most_scale=1.15, shift=0.05, jitter=0.0)
_LARGEST_JITTER = 0.015
# Shapes are bent by a sum of the lowest eigenfunctions, each coordinate by up to this much, less by higher ones.
_BENDING, _LARGEST_BEND, _LEAST_SHARE = 15, 0.03, 0.3
_LEAST_WAVE, _HIGHEST_WAVE = 1e-6, 3.0
# The share of turns that are small, and how far their quaternions lie from that of no turn.
_SMALL_TURNS, _SPREAD = 0.4, 0.8 / 3
_WARMUP_STEPS, _AVERAGE, _LONGEST_GRADIENT = 100, 0.999, 1.0
# Squared lengths below this count little in the loss; how fast the mean of the loss follows.
_LEAST_SQUARE, _LOSS_FOLLOWS = 1e-3, 0.01
# What tells the choices made with the recipe's seed from others.
_STREAM = 5


def train_orienter(
    store: ShapeStore,
    names: Sequence[str],
    settings: OrienterSettings,
    *,
    start: Orienter | None = None,
    seed: int = 0,
    progress: Progress = ignore,
) -> tuple[Orienter, float]:
    """Train an orienter on shapes that stand alike: as meshes, and as each of the clouds of a recipe.

    A shape is bent, stretched, jittered, shifted and turned, and the network predicts where its points were. Partial
    clouds are given about their own centre, and predicted where they lie on the full shape. New here; see
    ``homolog.features.orienter`` for its relatives. On a CPU the same arguments give the same orienter, and no random
    state but its own is used.

    Args:
        store: gives the shapes.
        names: of the shapes to train on.
        settings: how; at least one step.
        start: one that is trained on; by default a new one.
        seed: of the first weights and of all that is drawn.
        progress: called with what is done.

    Returns:
        The orienter, and its loss: a running mean of the distance between prediction and truth, in units of sqrt(area).

    Raises:
        ArgumentError: without shapes or steps.
        TrainingError: if the loss is not finite.

    Examples:
        >>> from homolog.geometry import compute_operators
        >>> from homolog.training import OrienterSettings, Recipe, train_orienter
        >>> from homolog.training.data import TrainingSet
        >>> from homolog.training.store import ShapeStore
        >>> shapes = TrainingSet.open("scans", Recipe())  # doctest: +SKIP
        >>> store = ShapeStore(shapes, Recipe(), compute_operators)  # doctest: +SKIP
        >>> orienter, loss = train_orienter(store, shapes.trained, OrienterSettings())  # doctest: +SKIP
    """
    if not names or not settings.steps:
        raise ArgumentError("an orienter needs a shape and a step to learn; give names, and steps above 0")
    random = np.random.default_rng([seed, _STREAM])
    generator = torch.Generator(store.device).manual_seed(seed)
    examples = _examples(store, names, random)
    optimiser = OptimiserSettings(
        learning_rate=settings.learning_rate, warmup_steps=_WARMUP_STEPS, average=_AVERAGE, weight_decay=0.0
    )
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        network = DiffusionNet(ORIENTER_NETWORK) if start is None else copy.deepcopy(start.network).requires_grad_()
    state = TrainingState.of(network.to(store.device).train(), optimiser)
    mean = torch.zeros((), device=store.device)
    for step in range(settings.steps):
        drawn = [_drawn(examples, random) for _ in range(settings.shapes_per_step)]
        loss = _gradient(state.network, drawn, generator)
        state.take_step(learning_rate(optimiser, step, settings.steps), optimiser.average)
        mean = loss if step == 0 else mean.lerp(loss, _LOSS_FOLLOWS)
        _check(mean, step)
        progress(step + 1, settings.steps, "training the orienter")
    return Orienter(state.result().requires_grad_(False)), float(mean)


@dataclass(frozen=True, eq=False)
class _Example:
    """A shape at some of its points, as an orienter gets it, and where they belong (n, 3)."""

    basis: Basis
    upright: Float[Tensor, "n 3"]


def _examples(store: ShapeStore, names: Sequence[str], random: np.random.Generator) -> list[list[list[_Example]]]:
    """Of each shape, and of each of its variants, some examples."""
    variants = range(MESH, len(store.variants))
    kept = names[:: -(-len(names) * len(variants) // _MOST_EXAMPLES)]
    count = min(_EXAMPLES_PER_VARIANT, max(_MOST_EXAMPLES // (len(kept) * len(variants)), 1))
    partners = _full_partners(store)

    def of_variant(name: str, variant: int, upright: Similarity) -> list[_Example]:
        samples = store.samples(name, variant)
        found = list[_Example]()
        for basis in samples.bases[:count]:
            kept = torch.from_numpy(random.permutation(basis.n_points)[:ORIENTER_SAMPLES]).to(basis.points.device)
            some = basis.truncated(ORIENTER_EIGENPAIRS).sampled(kept)
            halved = as_oriented(some).in_precision(torch.float16)
            found.append(_Example(halved, upright(some.points + samples.centre)))
        return found

    return [[of_variant(name, variant, _upright(store, name, partners)) for variant in variants] for name in kept]


def _full_partners(store: ShapeStore) -> dict[str, str]:
    """The full shape that each partial shape of the training lies on, or is a part of."""
    if store.recipe.partial is None:
        return {}
    by_size = (sorted(pair, key=lambda name: store.frame(name).scale) for pair in store.shapes.pairs)
    return dict(by_size)


def _upright(store: ShapeStore, name: str, partners: Mapping[str, str]) -> Similarity:
    """What takes the positions of a shape to where an orienter is to put them: on the full shape, of radius
    ``ORIENTER_RADIUS`` about its centre. A partial shape that is not pre-aligned keeps its own centre.
    """
    full = partners.get(name, name)
    frame = orienter_frame(store.samples(full, MESH).bases[0])
    if full == name:
        return frame
    partial, shift = store.recipe.partial, torch.zeros_like(frame.shift)
    if partial is not None and partial.pre_aligned:
        place = torch.from_numpy(store.frame(full).to_unit(store.frame(name).centre)).to(shift)
        shift = frame.scale * place + frame.shift
    return replace(frame, scale=frame.scale * store.frame(name).scale / store.frame(full).scale, shift=shift)


def _drawn(examples: list[list[list[_Example]]], random: np.random.Generator) -> _Example:
    """Any shape, and of it any variant, each as likely."""
    shape = examples[random.integers(len(examples))]
    variant = shape[random.integers(len(shape))]
    return variant[random.integers(len(variant))]


def _gradient(network: DiffusionNet, drawn: Sequence[_Example], generator: torch.Generator) -> Float[Tensor, ""]:
    """Put the clipped mean gradient into the network, and give the loss."""
    network.zero_grad()
    drawn = [_bent(example, generator) for example in drawn]
    turned = [_turned(example.basis.points, generator) for example in drawn]
    bases = [example.basis.in_precision(torch.float32) for example in drawn]
    predicted = network.several(turned, bases, generator=generator)
    loss = torch.stack(list(_losses(predicted, drawn))).mean()
    torch.autograd.backward(loss)
    torch.nn.utils.clip_grad_norm_(network.parameters(), _LONGEST_GRADIENT)
    return loss.detach()


def _losses(predicted: Sequence[Float[Tensor, "n 3"]], drawn: Sequence[_Example]) -> Iterator[Float[Tensor, ""]]:
    """The mean distance of each shape's points from where they belong, weighted by mass."""
    for points, example in zip(predicted, drawn, strict=True):
        squares = (points - example.upright).square().sum(dim=1)
        yield (example.basis.mass * (squares + _LEAST_SQUARE).sqrt()).sum() / example.basis.mass.sum()


def _bent(example: _Example, generator: torch.Generator) -> _Example:
    """The shape in another pose, as far as a smooth displacement makes one."""
    waves = example.basis.eigenvectors[:, 1 : _BENDING + 1].float()
    # Those of small components are zero at most points, or at all of the samples.
    waves = (waves / waves.square().mean(dim=0).sqrt().clamp(min=_LEAST_WAVE)).clamp(-_HIGHEST_WAVE, _HIGHEST_WAVE)
    heights = torch.randn(waves.shape[1], 3, generator=generator, device=generator.device).to(waves)
    heights = heights * torch.linspace(1, _LEAST_SHARE, waves.shape[1]).to(waves)[:, None]
    size = _LARGEST_BEND * torch.rand(1, generator=generator, device=generator.device).to(waves)
    bend = size * waves @ heights
    return _Example(replace(example.basis, points=example.basis.points + bend), example.upright + bend)


def _turned(points: Float[Tensor, "n 3"], generator: torch.Generator) -> Float[Tensor, "n 3"]:
    small, jitter = torch.rand(2, generator=generator, device=generator.device).tolist()
    varied = augmented(points, replace(_VARIED, jitter=_LARGEST_JITTER * jitter), generator)
    quaternion = torch.randn(4, generator=generator, device=generator.device).cpu()
    if small < _SMALL_TURNS:
        quaternion = torch.cat([torch.ones(1), _SPREAD * quaternion[1:]])
    return varied @ rotation_of(quaternion).T.to(points)


def _check(loss: Tensor, step: int) -> None:
    if not bool(torch.isfinite(loss)):
        raise TrainingError(
            f"step {step + 1} of the orienter: the loss is not finite; lower [orienter] learning_rate, or set steps = 0"
        )
