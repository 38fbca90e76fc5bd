"""Checkpoints: safetensors with a JSON header, which cannot run code, written whole or not at all."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import torch
from annotated_types import Ge
from safetensors import SafetensorError
from torch import Tensor
from typing_extensions import TypedDict

from homolog.core.errors import TrainingError
from homolog.core.files import parse_json
from homolog.core.reasons import reason_of
from homolog.core.records import checked_json, record
from homolog.core.settings import NotNegative
from homolog.core.tensors import read_tensors, write_tensors
from homolog.training.losses import Loss
from homolog.training.settings import Recipe
from homolog.training.state import TrainingState

_FORMAT = "homolog-checkpoint-1"
# Settings that change no weight; a training may go on with others.
_WITHOUT_EFFECT = frozenset(
    {
        "name",
        "licence",
        "upright",
        "near_isometric",
        "data.memory_gb",
        "data.workers",
        "orienter.learning_rate",
        "orienter.lender",
        "orienter.lent_steps",
        "orienter.shapes_per_step",
        "orienter.steps",
        "training.checkpoint_minutes",
        "validation.score_every",
        "validation.score_pairs",
    }
)
# What Adam remembers of each weight, beside the number of steps.
_MOMENTS = ("exp_avg", "exp_avg_sq")


@record
class _Progress(TypedDict):
    """What a checkpoint keeps of a ``TrainingState`` beside its tensors."""

    step: Annotated[int, Ge(0)]
    seconds: NotNegative
    best: float | None
    records: list[dict[str, Any]]
    started_from: dict[str, str] | None


def save_checkpoint(
    path: Path, state: TrainingState, recipe: Recipe, shapes: str, *, losses: Sequence[Loss] = ()
) -> None:
    """Write all that a training needs to go on.

    Args:
        path: of the file.
        state: to keep.
        recipe: of the training.
        shapes: a digest of the shapes trained on.
        losses: of one's own, of which names and weights are noted.
    """
    progress = {name: getattr(state, name) for name in _Progress.__annotations__}
    header = {
        "format": _FORMAT,
        "shapes": shapes,
        "recipe": json.dumps(_described(recipe, losses)),
        "progress": json.dumps(progress),
    }
    write_tensors(path, _tensors(state), header)


def load_checkpoint(
    path: Path,
    recipe: Recipe,
    shapes: str,
    device: torch.device | str = "cpu",
    *,
    losses: Sequence[Loss] = (),
) -> TrainingState:
    """Read what ``save_checkpoint`` wrote, for the same recipe, shapes and losses. Nothing that it names is imported.

    Raises:
        TrainingError: if the file is damaged, or comes from another recipe or other shapes.
    """
    try:
        tensors, header = read_tensors(path)
        if header.get("format") != _FORMAT:
            raise ValueError("it is no checkpoint")
        _check_recipe(path, parse_json(header["recipe"]), _described(recipe, losses))
        if header["shapes"] != shapes:
            raise TrainingError(f"{path} was trained on other shapes; give the same DATA, or another -o")
        return _state(recipe, tensors, checked_json(header["progress"], _Progress), device)
    except TrainingError:
        raise
    except (OSError, SafetensorError, ValueError, KeyError, TypeError, AttributeError, RuntimeError) as error:
        reason = reason_of(error)
        raise TrainingError(f"{path} cannot be gone on from ({reason}); give another -o") from None


def _tensors(state: TrainingState) -> dict[str, Tensor]:
    tensors: dict[str, Tensor] = {}
    for name, weight in state.network.named_parameters():
        tensors[f"weights.{name}"] = weight
        for moment in _MOMENTS if state.step else ():
            tensors[f"{moment}.{name}"] = state.optimiser.state[weight][moment]
    tensors |= {f"average.{name}": weight for name, weight in (state.average or {}).items()}
    return tensors


def _state(
    recipe: Recipe, tensors: dict[str, Tensor], progress: dict[str, Any], device: torch.device | str
) -> TrainingState:
    state = TrainingState.new(recipe, device)
    for name in _Progress.__annotations__:
        setattr(state, name, progress[name])
    for name, weight in state.network.named_parameters():
        _fill(weight.data, tensors[f"weights.{name}"])
        if state.step:
            moments = {moment: _fill(torch.empty_like(weight), tensors[f"{moment}.{name}"]) for moment in _MOMENTS}
            state.optimiser.state[weight] = {"step": torch.tensor(float(state.step), device=device), **moments}
    for name, mean in (state.average or {}).items():
        _fill(mean, tensors[f"average.{name}"])
    return state


def _fill(place: Tensor, values: Tensor) -> Tensor:
    if place.shape != values.shape:
        raise ValueError(f"a tensor has shape {tuple(values.shape)} instead of {tuple(place.shape)}")
    return place.detach().copy_(values)


def _described(recipe: Recipe, losses: Sequence[Loss] = ()) -> dict[str, Any]:
    return {**asdict(recipe.for_dataset()), "losses": {loss.name: loss.weight for loss in losses}}


def _check_recipe(path: Path, found: dict[str, Any], recipe: dict[str, Any]) -> None:
    now, by_default = (_flat(json.loads(json.dumps(table))) for table in (recipe, _described(Recipe())))
    before = {**by_default, **_flat(found)}  # what an older checkpoint does not name was as it is by default
    for key in sorted((before.keys() | now.keys()) - _WITHOUT_EFFECT):
        if before.get(key) != now.get(key):
            raise TrainingError(
                f"{path} was trained with {key} = {before.get(key)!r}, but the recipe has {now.get(key)!r}; "
                "give the same recipe, or another -o"
            )


def _flat(table: dict[str, Any], within: str = "") -> dict[str, Any]:
    """Nested tables as one, with keys such as ``optimiser.learning_rate``."""
    flat: dict[str, Any] = {}
    for key, value in table.items():
        flat |= _flat(value, f"{within}{key}.") if isinstance(value, dict) else {f"{within}{key}": value}
    return flat
