"""Running an experiment: what each cell needs, which cells are there, and making the others."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass, field
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path
from typing import Annotated, Any

from homolog.core.choices import Device
from homolog.core.errors import ArgumentError, DataError, ShapeError
from homolog.core.files import atomic_path, expanded, open_text, resuming
from homolog.core.folders import prepare_folder, remove_if_unused
from homolog.core.pretrained import AUTO_WEIGHTS, weights_file
from homolog.core.progress import Progress, ignore
from homolog.core.settings import Count, CountOrZero, Settings
from homolog.core.versions import commit, machine, version_of
from homolog.datasets import Pair, ShapeFolder, checksum
from homolog.evaluation import Protocol, evaluate
from homolog.geometry import OperatorCache
from homolog.matching import Match, Matcher, features_of_weights
from homolog.pairs import MatcherSettings
from homolog.pairs import Pair as ShapePair
from homolog.reproduction.cell_plans import CellPlan, figures_of
from homolog.reproduction.cells import cell_file, slug, stored_cell, write_cell
from homolog.reproduction.experiments import (
    COLUMNS,
    DataPlace,
    Experiment,
    Row,
    TrainingPlan,
    data_places,
    read_experiment,
    training_of,
)
from homolog.reproduction.lung_slices import write_lung_slices
from homolog.reproduction.pictures import write_curves, write_match
from homolog.reproduction.report import REPORT, write_report
from homolog.reproduction.training_runs import RUNS, SHAPES, TrainingRun
from homolog.synthesis import write_meshings

# Of the directions in which the triangles of other meshings are long.
_MESHING_SEED = 1


@dataclass(frozen=True, kw_only=True)
class ReproductionSettings(Settings):
    """What is made of an experiment.

    Args:
        weights: a file, or the name of pretrained ones, in place of all trainings but those that rows are about.
        train: train what is needed and not there yet.
        n_pairs: draw so many pairs of each dataset at random, for a quick look; by default all are matched.
        only: parts of names of rows; by default all rows are made.
        seed: of pairs, noise and turns.
        changes: values of recipes to use instead of theirs, by ``"section.key"``.
        device: where to compute.

    Raises:
        ArgumentError: if they do not fit each other.
        WeightsError: if there are no such weights.
    """

    weights: str | None = None
    train: bool = False
    n_pairs: Annotated[Count, "or None"] | None = None
    only: tuple[str, ...] = ()
    seed: CountOrZero = 0
    changes: dict[str, Any] = field(default_factory=dict)
    device: Device = "auto"

    def check(self) -> None:
        """Weights are given, or trained."""
        for name, is_given in (("train", self.train), ("changes", bool(self.changes))):
            if self.weights is not None and is_given:
                raise ArgumentError(
                    f"weights is {self.weights!r}, but {name} is given, too, and is for trainings; leave one out"
                )
        if self.weights not in (None, AUTO_WEIGHTS):
            weights_file(str(self.weights))


@dataclass(frozen=True)
class Reproduced:
    """What came of running an experiment.

    Args:
        report: the Markdown file with the tables of all experiments in the folder.
        made: how many cells were made.
        found: how many were there already.
        empty: the reason for each cell that stays empty, by the names of row and column.
    """

    report: Path
    made: int
    found: int
    empty: dict[tuple[str, str], str]


class _EmptyCellError(Exception):
    """A cell cannot be made with what is there."""


def reproduce(
    name: str,
    data: str | Path,
    output: str | Path,
    settings: ReproductionSettings | None = None,
    *,
    progress: Progress | None = None,
) -> Reproduced:
    """Run an experiment of the paper, from datasets to a table.

    Cells that are there, made with the same settings, weights and data, are not made again. A run that is interrupted
    leaves whole cells, and the next one goes on from there.

    Args:
        name: of the experiment.
        data: a folder that holds the datasets, ``FAUST_r`` and others, as subfolders.
        output: the folder for cells, tables, pictures and trainings; several experiments share it.
        settings: what is made.
        progress: told how far the work is, in pairs.

    Raises:
        ArgumentError: if there is no such experiment or row, or ``output`` holds other things.
        DataError: if no cell can be made with what is there.

    Examples:
        >>> from homolog.reproduction import ReproductionSettings, reproduce
        >>> quick = ReproductionSettings(weights="people", n_pairs=20)
        >>> reproduce("complete", "benchmarks", "reproduced", quick).report  # doctest: +SKIP
    """
    settings = settings or ReproductionSettings()
    experiment = read_experiment(name)
    rows = experiment.rows_named(settings.only)
    root, folders = expanded(output), [RUNS, SHAPES, name]
    if not expanded(data).is_dir():
        raise DataError(f"{data}: there is no such folder; give one that holds {', '.join(experiment.folders)}")
    with resuming(root), remove_if_unused(root, folders):
        prepare_folder(root, {"making": {"holds": "experiments"}}, folders, what="something")
        return _Run(experiment, rows, expanded(data), root, settings, progress or ignore).run()


@dataclass(frozen=True, eq=False)
class _CellPlace:
    """A cell's plan, what matches its pairs, the file that it belongs into, what names it, and whether it is there."""

    plan: CellPlan
    matcher: Matcher
    file: Path
    names: dict[str, str]
    is_there: bool


class _Run:
    """One run of an experiment."""

    def __init__(
        self,
        experiment: Experiment,
        rows: tuple[Row, ...],
        data: Path,
        root: Path,
        settings: ReproductionSettings,
        progress: Progress,
    ) -> None:
        self.experiment, self.rows, self.data, self.root = experiment, rows, data, root
        self.settings, self.progress = settings, progress
        self.folder = root / experiment.name
        self.dataset, self.training, self.matcher = cache(self._dataset), cache(self._training), cache(self._matcher)
        self.place = cache(self._place_of)
        self.empty: dict[tuple[str, str], str] = {}
        self.made = self.found = self.pairs_done = self.pairs_left = 0

    def run(self) -> Reproduced:
        """Make the cells that are not there, and the tables of all."""
        n_pairs = {(row, column): self._n_pairs(row, column) for row in self.rows for column in self.experiment.columns}
        self.pairs_left = sum(n_pairs.values())
        try:
            for (row, column), number in n_pairs.items():
                self.pairs_left -= number
                self._cell(row, column)
        finally:
            report = write_report(self.root) if self.made else self.root / REPORT
        if not self.made + self.found:
            raise DataError(f"no cell of {self.experiment.name} can be made: {next(iter(self.empty.values()))}")
        write_curves(self.experiment, self.folder)
        return Reproduced(report, self.made, self.found, self.empty)

    def _cell(self, row: Row, column: str) -> None:
        """Make a cell, unless it is there or lacks what it needs."""
        try:
            place = self.place(row, column)
            if place.is_there:
                self.found += 1
            else:
                self._make(place)
                self.made += 1
        except (_EmptyCellError, DataError, ShapeError) as reason:
            self.empty[row.name, column] = str(reason)

    def _place_of(self, row: Row, column: str) -> _CellPlace:
        """Where a cell belongs; weights that it lacks are trained, or refused."""
        plan = self._plan(row, column)
        matcher = self.matcher(plan.weights, plan.settings)
        key = plan.key(matcher)
        file = cell_file(self.folder, row.name, column, key)
        names = {"row": row.name, "column": column, "key": key}
        return _CellPlace(plan, matcher, file, names, stored_cell(file, key) is not None)

    def _plan(self, row: Row, name: str) -> CellPlan:
        folder, contents = self.dataset(row.data)
        described, column = folder.description, COLUMNS[name]
        weights, training = self._weights(row, name)
        pairs, listed = self._pairs(row, folder)
        protocol = Protocol(
            modality=row.modality,
            split=row.split,
            pairs_file=listed,
            n_pairs=_fewer(self.settings.n_pairs, pairs),
            partial=described.partial,
            pre_aligned=described.partial and described.pre_aligned,
            noise=row.noise,
            outliers=row.outliers,
            outlier_kind=row.outlier_kind,
            clutter=column.clutter,
            turn=row.turn,
            orient=column.orient,
            seed=self.settings.seed,
        )
        return CellPlan(row, column, folder, pairs, protocol, weights, training, contents)

    def _make(self, place: _CellPlace) -> None:
        """Evaluate, and write the cell with what made it."""
        plan, matcher, first = place.plan, place.matcher, list[Match]()

        def find(pair: ShapePair) -> Match:
            first.append(matcher.find(pair))
            return first[0] if len(first) == 1 else first.pop()

        began = time.perf_counter()
        evaluation = evaluate(matcher, plan.folder, plan.protocol, match_pair=find, progress=self._part_of(plan))
        seconds = time.perf_counter() - began
        self.pairs_done += plan.n_pairs
        features = matcher.describe()["features"]
        write_match(self.folder, place.file.stem, first[0])
        told = {
            "experiment": self.experiment.name,
            **place.names,
            "figures": figures_of(evaluation, is_whole=plan.is_whole),
            "paper": plan.row.paper,
            "made_by": plan.origin,
            "weights": features if isinstance(features, list) else [features] if features else [],
            "training": plan.training and plan.training.done(),
            "protocol": asdict(plan.protocol),
            "data": {"folder": str(plan.folder.root), "sha256": plan.checksum},
            "command": plan.command,
            "seed": plan.protocol.seed,
            "commit": commit(),
            "version": str(version_of("homolog")),
            "machine": machine(),
            "device": str(matcher.device),
            "seconds": seconds,
            "date": time.strftime("%Y-%m-%d"),
            "settings": plan.settings.to_dict(),
            "evaluation": evaluation.to_dict(),
        }
        write_cell(place.file, told)

    def _part_of(self, plan: CellPlan) -> Progress:
        """The progress of one cell, as a part of that of all."""
        before, total = self.pairs_done, self.pairs_done + plan.n_pairs + self.pairs_left

        def report(done: int, steps: int, what: str) -> None:
            self.progress(before + plan.n_pairs * done // steps, total, f"{plan.row.name}, {plan.column.title}: {what}")

        return report

    # ---- what cells need, each found once

    def _dataset(self, name: str) -> tuple[ShapeFolder, str]:
        """A dataset, and the checksum of its files."""
        place = data_places()[name]
        folder = ShapeFolder.open(self._place(name), place.description)
        return folder, checksum(folder.root, folder.description)

    def _place(self, name: str) -> Path:
        place = data_places()[name]
        found = place.find(self.data)
        if found is None and place.made_from:
            return self._made(name, place)
        if found is None:
            raise _EmptyCellError(f"{self.data} has no folder {' or '.join(place.folders)}; {place.to_be_had}")
        return found

    def _made(self, name: str, place: DataPlace) -> Path:
        """The folder of a dataset that is made from another one, if it is not there."""
        source, made = self._place(place.made_from), self.root / SHAPES / name
        description = data_places()[place.made_from].description

        def report(done: int, total: int, what: str) -> None:
            self.progress(done, total, f"{name}: {what}")

        if place.making == "meshings":
            write_meshings(source, made, description=description, seed=_MESHING_SEED, progress=report)
        else:
            write_lung_slices(ShapeFolder.open(source, description), made, progress=report)
        return made

    def _n_pairs(self, row: Row, column: str) -> int:
        """How many pairs are to be matched for a cell; 0 if it is there, or lacks what it needs."""
        try:
            pairs = self._pairs(row, self.dataset(row.data)[0])[0]
            is_to_be_trained = self._check_weights(row, column) and not (
                self.settings.weights or self.training(row, column).done()
            )
            if not is_to_be_trained and self.place(row, column).is_there:
                return 0
        except (_EmptyCellError, DataError, ShapeError):
            return 0
        return _fewer(self.settings.n_pairs, pairs) or len(pairs)

    def _pairs(self, row: Row, folder: ShapeFolder) -> tuple[tuple[Pair, ...], str | None]:
        """The pairs of a row, and their list where only shapes of some names are tested."""
        pairs = folder.pairs(row.split)
        if row.names == "*":
            return pairs, None
        chosen = tuple(pair for pair in pairs if fnmatchcase(pair[1], row.names))
        if not chosen:
            raise _EmptyCellError(f"{folder.root} has no shapes {row.names}; get the dataset again")
        file = self.folder / f"{row.data}-{slug(row.names)}-pairs.txt"
        with atomic_path(file) as temporary, open_text(temporary) as lines:
            lines.writelines(f"{source},{target}\n" for source, target in chosen)
        return chosen, str(file)

    def _check_weights(self, row: Row, column: str) -> TrainingPlan | None:
        """The training that a cell needs weights of, if any; refuse one that is not there, and is not to be made."""
        plan = training_of(row, column)
        if plan is None:
            return None
        if self.settings.weights is None:
            if not (self.settings.train or self.training(row, column).done()):
                raise _EmptyCellError(f"the training {plan.name} is not there; use --train, or give --weights FILE")
        elif row.trained_only or COLUMNS[column].changes:
            raise _EmptyCellError(f"it is about the training {plan.name}, which other weights cannot replace")
        return plan

    def _weights(self, row: Row, column: str) -> tuple[str | None, TrainingRun | None]:
        """The weights of a cell, and the training that they are from, which is run if need be."""
        plan = self._check_weights(row, column)
        if plan is None or self.settings.weights is not None:
            return self.settings.weights if plan else None, None
        training = self.training(row, column)
        if training.done() is None:
            name = f"training {plan.name}"
            training.run(self.settings.device, lambda done, of, what: self.progress(done, of, f"{name}: {what}"))
        return str(training.weights), training

    def _training(self, row: Row, column: str) -> TrainingRun:
        plan = training_of(row, column)
        assert plan is not None  # asked for by who has seen that there is one
        folders = {each: self._place(each) for each in plan.data}
        try:
            return TrainingRun.of(plan, folders, self.root, self.settings.changes)
        except DataError as error:
            raise _EmptyCellError(f"the training {plan.name} is not there, and cannot be made ({error})") from None

    def _matcher(self, weights: str | None, settings: MatcherSettings) -> Matcher:
        features = features_of_weights(weights, settings)
        operators = OperatorCache.default().operators
        return Matcher(features, settings=settings, device=self.settings.device, operators=operators)


def _fewer(wanted: int | None, pairs: tuple[Pair, ...]) -> int | None:
    """How many pairs are drawn, at most those of different shapes; None for all, also where there are no such pairs."""
    return min(wanted or 0, len({pair for pair in pairs if pair[0] != pair[1]})) or None
