"""The state of a training, which checkpoints keep."""

from __future__ import annotations

import copy
import logging
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from homolog.core.errors import ArgumentError, WeightsError
from homolog.features import DiffusionNet, FeatureInfo, load_weights
from homolog.training.settings import OptimiserSettings, Recipe

_log = logging.getLogger(__name__)

# An average of weights forgets the first ones sooner: after n steps its decay is at most (n + 1) / (n + 10).
_AVERAGE_DELAY = 10

Record = dict[str, Any]


@dataclass(eq=False)
class TrainingState:
    """Weights and what their optimiser remembers, and how far the training is.

    Random numbers are no part of it: they follow from the recipe's seed and the step.

    Args:
        network: in training mode.
        optimiser: Adam.
        average: running average of the weights by name, if the recipe wants one.
        step: how many steps are done.
        seconds: of training, over all runs.
        best: the lowest validation loss, once there is one.
        records: what validations found, in order.
        started_from: name, licence and hash of the weights that it started from, if these were not random.
    """

    network: DiffusionNet
    optimiser: torch.optim.AdamW
    average: dict[str, Tensor] | None
    step: int = 0
    seconds: float = 0.0
    best: float | None = None
    records: list[Record] = field(default_factory=list)
    started_from: dict[str, str] | None = None

    @classmethod
    def new(
        cls, recipe: Recipe, device: torch.device | str = "cpu", *, weights: str | Path | None = None
    ) -> TrainingState:
        """The state before the first step, with random weights or with some that were trained before.

        Raises:
            ArgumentError: if there are no weights and no steps.
            WeightsError: if there are no such weights, or they are of another network than the recipe's.
        """
        if weights is not None:
            network, info = _pretrained(recipe, weights)
            state = cls.of(network.to(device).train(), recipe.optimiser)
            state.started_from = {"name": info.name, "licence": info.licence, "sha256": info.sha256}
            return state
        if not recipe.training.steps:
            raise ArgumentError("[training] steps is 0, which trains nothing; give --weights to start from")
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(recipe.seed)
            network = DiffusionNet(recipe.network)
        return cls.of(network.to(device).train(), recipe.optimiser)

    @classmethod
    def of(cls, network: DiffusionNet, settings: OptimiserSettings) -> TrainingState:
        """The state before the first step from the weights that a network has."""
        optimiser = torch.optim.AdamW(
            network.parameters(), settings.learning_rate, settings.betas, weight_decay=settings.weight_decay, fused=True
        )
        average = {name: weight.detach().clone() for name, weight in network.named_parameters()}
        return cls(network, optimiser, average if settings.average else None)

    def take_step(self, learning_rate: float, decay: float) -> None:
        """Follow the gradients, and let the average follow the weights."""
        for group in self.optimiser.param_groups:
            group["lr"] = learning_rate
        self.optimiser.step()
        if self.average is not None:
            decay = min(decay, (self.step + 1) / (self.step + _AVERAGE_DELAY))
            weights = [weight.detach() for weight in self.network.parameters()]
            torch._foreach_lerp_(list(self.average.values()), weights, 1 - decay)
        self.step += 1

    def result(self) -> DiffusionNet:
        """A copy of the network to use: in evaluation mode, with averaged weights if there are such."""
        network = copy.deepcopy(self.network).eval()
        if self.average is not None:
            network.load_state_dict(self.average)
        return network


def _pretrained(recipe: Recipe, weights: str | Path) -> tuple[DiffusionNet, FeatureInfo]:
    """The recipe's network with weights from a file, and what these are; dropout has none, and may differ."""
    pretrained = load_weights(weights)
    trained, info = pretrained.network, pretrained.info
    theirs = {**asdict(trained.settings), "dropout": recipe.network.dropout}
    for name, given in asdict(recipe.network).items():
        if theirs[name] != given:
            raise WeightsError(
                f"{weights} has {name} {theirs[name]!r}, but the recipe's [network] says {given!r}; "
                "change the recipe, or give other weights"
            )
    _warn_of_differences(recipe, info)
    network = DiffusionNet(recipe.network)
    network.load_state_dict(trained.state_dict())
    return network, info


def _warn_of_differences(recipe: Recipe, info: FeatureInfo) -> None:
    """Say where a recipe departs from what the weights that it begins with were trained with, or are given under."""
    for name, given in asdict(recipe.operators).items():
        if getattr(info, name) != given:
            _log.warning(
                "%s were trained with %s %s, and the recipe's [operators] say %s.",
                *(info.name, name, getattr(info, name), given),
            )
    if info.licence != recipe.licence:
        _log.warning(
            "%s are under %r, which counts for what comes of them as well; the recipe's licence is %r.",
            *(info.name, info.licence, recipe.licence),
        )
