"""Trainings that experiments share: each is run once for a recipe and its data, and goes on where it was stopped."""

from __future__ import annotations

import json
import shlex
import shutil
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from homolog.core.choices import Device
from homolog.core.errors import DataError
from homolog.core.files import atomic_path, made_folder, open_text, sha256, write_json
from homolog.core.pretrained import weights_file
from homolog.core.progress import Progress, ignore
from homolog.core.records import stored_record
from homolog.core.versions import commit, machine, version_of
from homolog.datasets import DatasetDescription, ShapeFolder
from homolog.datasets.folder import path_of
from homolog.reproduction.cells import Trained, key_of
from homolog.reproduction.experiments import TrainingPlan, data_places
from homolog.training import WEIGHTS, Recipe, read_recipe, train
from homolog.training.data import TrainingSet

RUNS, SHAPES = "runs", "shapes"
"""The folders of trainings, and of shapes that were gathered for them."""
_DONE = "trained.json"


@dataclass(frozen=True)
class TrainingRun:
    """A training of an experiment, in a folder of its own.

    Args:
        plan: what is trained.
        recipe: with all changes.
        changes: of the user, by ``"section.key"``.
        data: the folder that is trained on.
        description: of the dataset in it; None where shapes were gathered.
        folder: of checkpoints and weights.
        key: what tells it apart from trainings by other recipes, or on other shapes.
    """

    plan: TrainingPlan
    recipe: Recipe
    changes: Mapping[str, Any]
    data: Path
    description: DatasetDescription | None
    folder: Path
    key: str

    @classmethod
    def of(
        cls, plan: TrainingPlan, folders: Mapping[str, Path], output: Path, changes: Mapping[str, Any]
    ) -> TrainingRun:
        """The run of a plan.

        Args:
            plan: what is trained.
            folders: of the datasets, by name.
            output: below which runs are kept.
            changes: values to use instead of the plan's.

        Raises:
            ArgumentError: if a change is not as it should be.
            DataError: if there are too few shapes.
        """
        recipe = read_recipe(plan.recipe, {**plan.changes, **changes})
        data, description = _training_data(plan, folders, output)
        shapes = TrainingSet.open(data, recipe, description)
        contents = sha256(*(shapes.files[name] for name in shapes.used))
        start = sha256(weights_file(plan.start)) if plan.start else None
        told = asdict(recipe.for_dataset(description))
        weights = told["loss"]["weights"]
        told["loss"]["weights"] = {name: weight for name, weight in weights.items() if weight}  # others may come
        key = key_of([told, shapes.names, shapes.pairs, contents, start])
        return cls(plan, recipe, changes, data, description, output / RUNS / f"{plan.name}-{key}", key)

    @property
    def weights(self) -> Path:
        """The file of the weights, once they are trained."""
        return self.folder / WEIGHTS

    @property
    def command(self) -> str:
        """The command that makes these weights."""
        words = ["homolog", "train", str(self.data), "-o", str(self.folder), "--recipe", self.plan.recipe]
        for name, value in {**self.plan.changes, **self.changes}.items():
            words += ["--set", f"{name}={toml_text(value)}"]
        words += ["--dataset", data_places()[self.plan.data[0]].dataset] if self.description is not None else []
        return shlex.join(words + (["--weights", self.plan.start] if self.plan.start else []))

    def done(self) -> dict[str, Any] | None:
        """What is kept of it, if it is done and its weights are those that it wrote."""
        found = stored_record(self.folder / _DONE, Trained)
        is_whole = found is not None and found["key"] == self.key and self.weights.is_file()
        return found if is_whole and found is not None and sha256(self.weights) == found["weights"] else None

    def run(self, device: Device, progress: Progress | None = None) -> dict[str, Any]:
        """Train, or go on with it; what is kept of it then."""
        state = train(
            self.recipe,
            self.data,
            self.folder,
            description=self.description,
            resume=True,
            weights=self.plan.start or None,
            device=device,
            progress=progress or ignore,
        )
        told = {
            "key": self.key,
            "training": self.plan.name,
            "recipe": self.plan.recipe,
            "changes": {**self.plan.changes, **self.changes},
            "weights": sha256(self.weights),
            "steps": state.step,
            "seconds": state.seconds,
            "command": self.command,
            "commit": commit(),
            "version": version_of("homolog"),
            "machine": machine(),
            "date": time.strftime("%Y-%m-%d"),
        }
        write_json(self.folder / _DONE, told)
        return told


def _training_data(
    plan: TrainingPlan, folders: Mapping[str, Path], output: Path
) -> tuple[Path, DatasetDescription | None]:
    """The folder of a plan's shapes: a dataset as it is, or links to shapes of one or several."""
    descriptions = {name: data_places()[name].description for name in plan.data}
    if len(plan.data) == 1 and not plan.first:
        name = plan.data[0]
        return folders[name], descriptions[name]
    sources = {name: ShapeFolder.without_truth(folders[name], descriptions[name]) for name in plan.data}
    chosen = [(name, shape) for name in plan.data for shape in _first(sources[name], plan)]
    files = [str(sources[name].file(shape).resolve()) for name, shape in chosen]
    root = made_folder(output / SHAPES / f"{'-'.join(plan.data)}-{key_of(files)}")
    for name, shape in chosen:
        source, described = sources[name], descriptions[name]
        _link(root / "off" / f"{name}_{shape}", source.file(shape))
        if len(sources) == 1:  # several have no common template
            _link(root / "corres" / f"{name}_{shape}", path_of(source.root, described.truth_files, shape))
    with atomic_path(root / "train.txt") as temporary, open_text(temporary) as lines:
        lines.writelines(f"{name}_{shape}\n" for name, shape in chosen)
    return root, None


def _first(source: ShapeFolder, plan: TrainingPlan) -> tuple[str, ...]:
    """The training shapes of a dataset that a plan takes."""
    names = source.split("train")
    if len(names) < plan.first:
        raise DataError(
            f"{source.root} has {len(names)} shapes to train on, but {plan.name} takes {plan.first}; "
            "add some, or leave its rows out"
        )
    return names[: plan.first or None]


def _link(place: Path, file: Path) -> None:
    """A link to a file, if that is there, under a name and with the file's suffix; a copy where there are no links."""
    link = made_folder(place.parent) / f"{place.name}{file.suffix}"
    if link.exists() or not file.is_file():
        return
    link.unlink(missing_ok=True)  # one that leads nowhere
    try:
        link.symlink_to(file.resolve())
    except OSError:  # on Windows links need a right that users seldom have
        shutil.copyfile(file, link)


def toml_text(value: Any) -> str:
    """A value of a recipe as TOML has it.

    Examples:
        >>> toml_text(["*_shape_1?"]), toml_text(False), toml_text(0.5)
        ('["*_shape_1?"]', 'false', '0.5')
    """
    return json.dumps(value)
