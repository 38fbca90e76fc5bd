"""The losses of one pair of shapes, without any correspondence between them."""

from __future__ import annotations

import importlib
from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from homolog.core.errors import ArgumentError
from homolog.core.plugins import described, fault
from homolog.features import DiffusionNet, NetworkInput, network_input
from homolog.training.augmentation import augmented
from homolog.training.losses import BUILTIN_LOSSES, TOTAL, Loss, installed_losses
from homolog.training.quantities import CLOUD_FEATURES, PairQuantities, TrainingShape
from homolog.training.settings import AugmentationSettings, LossSettings


def pair_losses(
    network: DiffusionNet,
    x: TrainingShape,
    y: TrainingShape,
    *,
    settings: LossSettings,
    losses: Sequence[Loss] | None = None,
    augmentation: AugmentationSettings | None = None,
    generator: torch.Generator | None = None,
    partial: bool = False,
    registration_targets: Float[Tensor, "m_y 3"] | None = None,
    features_from: NetworkInput = "xyz",
) -> dict[str, Float[Tensor, ""]]:
    """The weighted losses of a pair of shapes by name, and ``"total"``, their sum; from four passes of the network.

    Clouds pass through it only if a loss looks at their features.

    Args:
        network: in training or evaluation mode.
        x: a shape; the full one if ``partial``.
        y: another; a part of one like x if ``partial``, at the same scale.
        settings: weights and sizes.
        losses: which to compute; by default those of the settings.
        augmentation: how to vary the input of each pass; None to leave it.
        generator: of all that is random, dropout included; torch's own by default.
        partial: use the losses for partial shapes.
        registration_targets: where y's cloud lies once it is registered to x's, see
            ``homolog.maps.registered_positions``; by default that of the samples.
        features_from: what the network takes.
    """
    used = losses or losses_of(settings)
    looks_at_clouds = any(loss.requires & CLOUD_FEATURES for loss in used)
    bases = [x.mesh, y.mesh, *((x.cloud, y.cloud) if looks_at_clouds else ())]
    inputs = [basis.points for basis in bases]
    with _full_precision(inputs[0].device):
        if augmentation is not None:
            inputs = [augmented(points, augmentation, generator) for points in inputs]
        inputs = [
            network_input(basis, features_from, network.settings.in_channels, points=points)
            for basis, points in zip(bases, inputs, strict=True)
        ]
    features = network.several(inputs, bases, generator=generator)
    with _full_precision(inputs[0].device):
        pair = PairQuantities(
            x,
            y,
            features,
            settings,
            partial=partial,
            registration_targets=registration_targets,
            generator=generator,
        )
        values = {loss.name: loss.weighted(pair) for loss in used}
        return {**values, TOTAL: sum(values.values(), start=inputs[0].new_zeros(()))}


def _full_precision(device: torch.device) -> torch.autocast:
    """In bfloat16, positions would be off by as much as their jitter, and the logits of the losses by a twentieth."""
    return torch.autocast(device.type, enabled=False)


def losses_of(settings: LossSettings, more: Sequence[Loss] = ()) -> tuple[Loss, ...]:
    """The losses with a weight above 0, of settings and of one's own: their sum is what a training minimises.

    Raises:
        ArgumentError: if a function cannot be imported or is no loss, a name comes twice, or no loss is left.
    """
    named = [_named(name, weight, settings) for name, weight in settings.weights.items() if weight]
    losses = (*named, *(loss for loss in more if loss.weight))
    names = [loss.name for loss in losses]
    for name in names:
        if names.count(name) > 1:
            raise ArgumentError(f"there are {names.count(name)} losses {name!r}; give yours another name")
    if not losses:
        raise ArgumentError("no loss has a weight above 0; give [loss] of the recipe one that has")
    return losses


def _named(name: str, weight: float, settings: LossSettings) -> Loss:
    if name in BUILTIN_LOSSES:
        return Loss.of(name, weight, BUILTIN_LOSSES[name].function)
    path = settings.functions.get(name)
    origin = described(installed_losses()[name]) if path is None else repr(path)
    try:
        if path is None:
            function = installed_losses()[name].load()
        else:
            module, _, attribute = path.partition(":")
            function = getattr(importlib.import_module(module), attribute)
        return Loss.of(name, weight, function)
    except ArgumentError:
        raise
    except Exception as error:  # importing a module raises whatever its lines do
        raise ArgumentError(
            f"the function of the loss {name}, {origin}, cannot be used ({fault(error)}); "
            "give package.module:function of an installed package"
        ) from error
