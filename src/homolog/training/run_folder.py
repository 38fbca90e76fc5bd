"""The folder that a training writes."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float

from homolog.core.errors import ArgumentError, DataError
from homolog.core.files import made_folder, sha256, write_json
from homolog.core.progress import Progress
from homolog.core.records import read_record
from homolog.core.versions import versions
from homolog.features import FeatureInfo, NetworkFeatures, Orienter, load_weights, save_weights
from homolog.pairs import OperatorSource
from homolog.training.alignment import Aligned, aligned, oriented
from homolog.training.checkpoints import load_checkpoint, save_checkpoint
from homolog.training.data import TrainingSet
from homolog.training.losses import Loss
from homolog.training.settings import Recipe
from homolog.training.state import TrainingState

WEIGHTS = "weights.safetensors"
"""The weights to use: those with the lowest validation loss, or the latest where nothing is validated."""
_LAST, _BEST, _REPORT, _ALIGNMENT = "last.safetensors", "best.safetensors", "report.json", "alignment.json"
RUN_FILES = (WEIGHTS, _LAST, _BEST, _REPORT, _ALIGNMENT)
"""Names of the files that a training writes and replaces, beside those of TensorBoard."""
_LOCK = ".lock"


@dataclass(frozen=True)
class RunFolder:
    """Where a training keeps its files.

    Checkpoints are ``last.safetensors`` and ``best.safetensors``, weights to use ``weights.safetensors``; there are
    ``report.json`` for people, and TensorBoard's files. ``alignment.json`` says how shapes were turned, if they were.

    Args:
        path: of the folder.
        recipe: of the training.
        shapes: trained on.
        losses: of one's own, beside those of the recipe.
    """

    path: Path
    recipe: Recipe
    shapes: TrainingSet
    losses: tuple[Loss, ...] = ()

    @property
    def last(self) -> Path:
        """The latest checkpoint."""
        return self.path / _LAST

    def make(self, *, resume: bool) -> None:
        """Make the folder, or make sure that it is one to go on in.

        Raises:
            ArgumentError: if it cannot be made, or holds files and ``resume`` is not given.
        """
        if any("\ud800" <= sign <= "\udfff" for sign in str(self.path)):  # as Python has other bytes
            raise ArgumentError(f"{self.path} is no UTF-8, which TensorBoard needs; give another -o")
        made_folder(self.path)
        if not os.access(self.path, os.W_OK):
            raise ArgumentError(f"{self.path} is read-only; give another -o")
        if not resume and any(entry.name != _LOCK for entry in self.path.iterdir()):
            raise ArgumentError(f"{self.path} holds files already; give another -o, or --resume to go on with it")

    @contextmanager
    def held(self) -> Iterator[None]:
        """Keep other trainings out of the folder for as long as this lasts.

        Raises:
            ArgumentError: if one is at work in it.
        """
        from filelock import FileLock, Timeout

        file = self.path / _LOCK
        lock = FileLock(file, blocking=False)
        try:
            lock.acquire()
        except Timeout:
            raise ArgumentError(
                f"another training is at work in {self.path}; wait for it, or give another -o"
            ) from None
        except (OSError, NotImplementedError) as error:
            raise ArgumentError(f"{file} cannot be locked ({error}); give an -o elsewhere, on another disk") from None
        try:
            yield
        finally:
            lock.release()

    def align(self, operators: OperatorSource, progress: Progress, *, weights: str | Path | None = None) -> None:
        """Find how to turn the shapes to stand alike, and write it down, unless that was done before.

        Weights to start from that have an orienter know how they are to stand. The new weights keep that orienter.
        """
        if self.rotations().keys() == set(self.shapes.used):
            return
        lender = None if weights is None else load_weights(weights)
        if lender is None or lender.orienter is None:
            found = aligned(self.shapes, progress)
        else:
            start = TrainingState.new(self.recipe, weights=weights)  # before anything is written: they must fit
            of_mesh = partial(operators, settings=self.recipe.operators)
            found = oriented(self.shapes, lender.orienter, of_mesh, progress)
            self._export(start, lender=lender)
        write_json(self._alignment, {name: asdict(how) for name, how in found.items()})

    def rotations(self) -> dict[str, Float[np.ndarray, "3 3"]]:
        """By which the shapes are to be turned, by name; none where they are not aligned."""
        if not (self.recipe.data.align and self._alignment.is_file()):
            return {}
        instead = "remove it, and give --resume"
        found = read_record(self._alignment, dict[str, Aligned], instead=instead)
        for name, how in found.items():
            rows = how["rotation"]
            square = list(map(len, rows)) == [3, 3, 3]
            if not (square and np.allclose(np.array(rows) @ np.transpose(rows), np.eye(3), atol=1e-4)):
                raise DataError(f"{self._alignment} is damaged: {name} has no rotation; {instead}")
        return {name: np.array(how["rotation"]) for name, how in found.items()}

    @property
    def _alignment(self) -> Path:
        return self.path / _ALIGNMENT

    def load(self, device: torch.device | str, *, weights: str | Path | None = None) -> TrainingState:
        """The state of the latest checkpoint, or a new one where there is none, with these weights if any are given."""
        if self.last.is_file():
            return load_checkpoint(self.last, self.recipe, self._digest, device, losses=self.losses)
        return TrainingState.new(self.recipe, device, weights=weights)

    def save_last(self, state: TrainingState) -> None:
        """Write the latest checkpoint."""
        save_checkpoint(self.last, state, self.recipe, self._digest, losses=self.losses)
        if state.best is None:  # nothing is validated, or nothing yet
            self._export(state)

    def save_best(self, state: TrainingState) -> None:
        """Write the best checkpoint, and its weights for use."""
        save_checkpoint(self.path / _BEST, state, self.recipe, self._digest, losses=self.losses)
        self._export(state)

    def lacks_orienter(self) -> bool:
        """Whether the weights are without the orienter that the recipe asks for."""
        wanted = self.recipe.upright and self.recipe.orienter.steps > 0
        return wanted and load_weights(self.path / WEIGHTS).orienter is None

    def add_orienter(self, orienter: Orienter, *, lender: str = "") -> None:
        """Write the weights anew, with an orienter, and whose it was."""
        found = load_weights(self.path / WEIGHTS)
        info = replace(found.info, lender=lender)
        save_weights(self.path / WEIGHTS, found.network, info, orienter=orienter)

    def save_report(
        self, state: TrainingState, device: torch.device, *, orienter: dict[str, float | str] | None = None
    ) -> None:
        """Write the report, with steps and loss of the orienter, or who lent it, once there is one."""
        report = {
            "recipe": asdict(self.recipe),
            "losses": {loss.name: loss.weight for loss in self.losses},
            "data": str(self.shapes.root),
            "started_from": state.started_from,
            "shapes": len(self.shapes.used),
            "held_out": ["{} - {}".format(*pair) for pair in self.shapes.held_out],
            "device": str(device),
            "steps": state.step,
            "minutes": state.seconds / 60,
            "best_validation_loss": state.best,
            "validations": state.records,
            "orienter": orienter,
            "versions": versions(),
        }
        write_json(self.path / _REPORT, report)

    def _export(self, state: TrainingState, *, lender: NetworkFeatures | None = None) -> None:
        """Write the weights for use, with a lender's orienter, or the one that those have which are there already."""
        file, info = self.path / WEIGHTS, weights_info(self.recipe)
        if lender is not None:
            save_weights(file, state.result(), replace(info, lender=lender.info.name), orienter=lender.orienter)
            return
        kept = load_weights(file) if file.is_file() else None
        if kept is not None:
            info = replace(info, lender=kept.info.lender)
        save_weights(file, state.result(), info, orienter=None if kept is None else kept.orienter)

    @cached_property
    def _digest(self) -> str:
        """A hash of the shapes and pairs that are trained on, by their names and contents."""
        contents = sha256(*(self.shapes.files[name] for name in self.shapes.used))
        described: Any = [self.shapes.names, self.shapes.pairs, self.shapes.held_out, contents]
        return hashlib.sha256(json.dumps(described).encode()).hexdigest()


def is_begun(path: Path) -> bool:
    """Whether a training has begun in a folder."""
    return (path / _LAST).is_file()


def weights_info(recipe: Recipe) -> FeatureInfo:
    """What one must know to use the weights of a training."""
    return FeatureInfo(
        name=recipe.name,
        licence=recipe.licence,
        input=recipe.input,
        upright=recipe.upright,
        n_eigenpairs=recipe.operators.n_eigenpairs,
        laplacian=recipe.operators.laplacian,
        n_neighbours=recipe.operators.n_neighbours,
        map_eigenpairs=recipe.loss.map_eigenpairs,
        partial=recipe.partial is not None,
        near_isometric=recipe.near_isometric,
        temperature=recipe.loss.soft_temperature,
    )
