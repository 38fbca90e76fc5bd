"""Experiments of the paper as data: which rows and columns a table has, and what each cell is measured on.

They are TOML files: ``experiments/NAME.toml`` for each experiment, ``trainings.toml`` for the trainings that they
share, and ``data.toml`` for the folders of the datasets. Nothing here loads PyTorch.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal

from homolog.core.choices import KeepClutter, Modalities, Orient, OutlierKind, Split, Turn
from homolog.core.errors import bad_choice
from homolog.core.method_names import AUTO
from homolog.core.settings import Count, CountOrZero, NotNegative, Settings, read_settings, read_toml
from homolog.datasets.description import DatasetDescription, read_description

_FOLDER = Path(__file__).parent / "experiments"


@dataclass(frozen=True, kw_only=True)
class DataPlace(Settings):
    """Where a dataset lies below the folder of all, and what it is.

    Args:
        dataset: name of its description.
        folders: names that its folder may have.
        source: where to get it, where the description does not say so.
        made_from: name of the dataset that it is made from where it is not there.
        making: what is made: other meshings of its test shapes, with long triangles, or surfaces and slices of lungs.
    """

    dataset: str
    folders: tuple[str, ...]
    source: str = ""
    made_from: str = ""
    making: Literal["meshings", "slices"] = "meshings"

    @property
    def description(self) -> DatasetDescription:
        """The description of the dataset."""
        return read_description(self.dataset)

    @property
    def to_be_had(self) -> str:
        """Where to get it."""
        return self.source or f"get it from {self.description.source}"

    def find(self, data: Path) -> Path | None:
        """Its folder below the folder of all; None if it is not there."""
        return next((data / name for name in self.folders if (data / name).is_dir()), None)


@dataclass(frozen=True, kw_only=True)
class TrainingPlan(Settings):
    """A training that experiments take weights from.

    Args:
        name: by which rows call it.
        recipe: name of a recipe.
        data: names of datasets, whose training shapes are taken together.
        first: so many of them, of each dataset; 0 for all.
        changes: values that differ from the recipe's, by ``"section.key"``.
        start: name of the pretrained weights to start from; random ones by default.
        minutes: that it takes on two cores, about.
    """

    name: str
    recipe: str
    data: tuple[str, ...]
    first: Annotated[CountOrZero, "0 for all"] = 0
    changes: dict[str, Any] = field(default_factory=dict)
    start: str = ""
    minutes: Count = 60


@dataclass(frozen=True, kw_only=True)
class Row(Settings):
    """What the cells of a row are measured on.

    Args:
        name: of the row.
        data: name of the dataset.
        training: name of the training that weights come from; empty for a method that needs none.
        trained_only: the row is about this training, so that weights that are given cannot take its place.
        paper: the paper's figure, as tables show it, if it has one.
        names: pattern of the shapes that are tested: the second ones of pairs; by default all of the split.
        curve: the curve that the row is a point of, where the experiment has an axis.
        split: these and the following are options of ``homolog.evaluation.Protocol``, and the method.
        modality: of source and target.
        noise: on clouds.
        outliers: added to clouds.
        outlier_kind: where they lie.
        turn: of every shape.
        method: by which maps are made.
    """

    name: str
    data: str
    training: str = ""
    trained_only: bool = False
    paper: float | None = None
    names: str = "*"
    curve: str = ""
    split: Split = "test"
    modality: Modalities = "mesh"
    noise: NotNegative = 0.0
    outliers: NotNegative = 0.0
    outlier_kind: OutlierKind = "box"
    turn: Turn = "none"
    method: str = AUTO


@dataclass(frozen=True, kw_only=True)
class Column(Settings):
    """How the cells of a column are matched, and what they are trained with.

    Args:
        title: of the column.
        orient: whether the way round is found, or trusted.
        clutter: whether what does not belong to clouds is set apart.
        left_out: stages of matching that are left out: their settings are None.
        method: by which maps are made, in place of the row's; one that needs no weights.
        changes: of the recipe of the row's training, for weights of the column's own.
    """

    title: str
    orient: Orient = "auto"
    clutter: KeepClutter = "remove"
    left_out: tuple[Literal["refinement", "alignment"], ...] = ()
    method: str = ""
    changes: dict[str, Any] = field(default_factory=dict)


_MESHES_ALONE = {"loss.alignment": 0.0, "loss.infonce": 0.0}

COLUMNS = {
    "paper": Column(title="the paper's setting", orient="given", clutter="keep", left_out=("refinement", "alignment")),
    "ours": Column(title="ours"),
    "axiomatic": Column(title="axiomatic", method="axiomatic"),
    "axiomatic_given": Column(title="axiomatic, poses trusted", orient="given", method="axiomatic"),
    "surfmnet": Column(
        title="losses of SURFMNet",
        changes={**_MESHES_ALONE, "loss.commutativity": 20.0, "loss.descriptors": 100.0},
    ),
    "geomfmaps": Column(
        title="loss of GeomFMaps",
        changes={**_MESHES_ALONE, "loss.bijectivity": 0.0, "loss.orthogonality": 0.0, "loss.true_maps": 1.0},
    ),
    "ulrssm": Column(title="losses of ULRSSM", changes={**_MESHES_ALONE, "loss.coupling": 1.0}),
    "dpfm": Column(title="losses of unsupervised DPFM", changes=_MESHES_ALONE),
}
"""The columns of experiments: the paper's setting has no search and no refinement, and trusts poses. The others are
matched as ours are; baselines are trained with other losses, or not at all."""


@dataclass(frozen=True)
class Experiment:
    """A table of the paper.

    Args:
        name: by which the command knows it.
        title: for people.
        about: what is trained on and tested on, and how the paper's figures compare.
        rows: of the table.
        axis: the option of rows that errors are drawn against; empty for none.
        columns: names of those of ``COLUMNS`` that each row has.
    """

    name: str
    title: str
    about: str
    rows: tuple[Row, ...]
    axis: Literal["", "noise", "outliers"] = ""
    columns: tuple[str, ...] = ("paper", "ours")

    @property
    def trainings(self) -> tuple[TrainingPlan, ...]:
        """The trainings that its cells take weights from, in their order."""
        plans = (training_of(row, column) for row in self.rows for column in self.columns)
        return tuple({plan.name: plan for plan in plans if plan is not None}.values())

    @property
    def folders(self) -> tuple[str, ...]:
        """The folders of the datasets that are tested on and trained on."""
        names = [*(row.data for row in self.rows), *(name for plan in self.trainings for name in plan.data)]
        places = (data_places()[name] for name in names)
        return tuple(dict.fromkeys(place.made_from or place.folders[0] for place in places))

    def rows_named(self, words: tuple[str, ...]) -> tuple[Row, ...]:
        """The rows whose names contain one of these words, in any case; all rows where there are none.

        Raises:
            ArgumentError: if a word is in no name.
        """
        for word in words:
            if not any(word.lower() in row.name.lower() for row in self.rows):
                raise bad_choice("only", word, [row.name for row in self.rows], "or give a part of a name")
        return tuple(row for row in self.rows if not words or any(word.lower() in row.name.lower() for word in words))


def experiment_names() -> tuple[str, ...]:
    """The names of all experiments.

    Examples:
        >>> "complete" in experiment_names()
        True
    """
    return tuple(path.stem for path in sorted(_FOLDER.glob("*.toml")))


@cache
def read_experiment(name: str) -> Experiment:
    """An experiment by its name.

    Raises:
        ArgumentError: if there is none of this name.

    Examples:
        >>> read_experiment("complete").rows[0].paper
        2.0
    """
    if name not in experiment_names():
        raise bad_choice("the experiment", name, experiment_names())
    path = _FOLDER / f"{name}.toml"
    table = read_toml(path)
    rows = tuple(read_settings(Row, row, f"{path}: [[rows]]") for row in table.pop("rows"))
    columns = tuple(table.pop("columns", Experiment.columns))
    return Experiment(name=name, rows=rows, columns=columns, **table)


@cache
def trainings() -> dict[str, TrainingPlan]:
    """The trainings that experiments share, by name."""
    path = _FOLDER.parent / "trainings.toml"
    return {
        name: read_settings(TrainingPlan, {"name": name, **table}, f"{path}: [{name}]")
        for name, table in read_toml(path).items()
    }


def training_of(row: Row, column: str) -> TrainingPlan | None:
    """The training that a cell takes weights from: the row's, or with a column's changes; None if it needs none."""
    if not row.training or COLUMNS[column].method:
        return None
    plan, changes = trainings()[row.training], COLUMNS[column].changes
    return replace(plan, name=f"{plan.name}_{column}", changes={**plan.changes, **changes}) if changes else plan


@cache
def data_places() -> dict[str, DataPlace]:
    """The datasets that experiments need, by name."""
    path = _FOLDER.parent / "data.toml"
    return {
        name: read_settings(DataPlace, {"folders": [name], **table}, f"{path}: [{name}]")
        for name, table in read_toml(path).items()
    }
