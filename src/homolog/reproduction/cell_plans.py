"""What a cell is made with, and the command that makes it alone."""

from __future__ import annotations

import shlex
from dataclasses import asdict, dataclass
from typing import Any

from homolog.datasets import Pair, ShapeFolder
from homolog.evaluation import Evaluation, Protocol, area_under_pck, pck_curve
from homolog.matching import Matcher
from homolog.pairs import MatcherSettings
from homolog.reproduction.cells import NO_WEIGHTS, key_of
from homolog.reproduction.experiments import Column, Row, data_places
from homolog.reproduction.training_runs import TrainingRun

# Options of the command by the fields of the protocol that they set. What is partial, and where it lies, the
# descriptions of datasets say.
_OPTIONS = {
    "split": "--split",
    "pairs_file": "--pairs",
    "n_pairs": "-n",
    "modality": "--modality",
    "noise": "--noise",
    "outliers": "--outliers",
    "outlier_kind": "--outlier-kind",
    "clutter": "--clutter",
    "turn": "--turn",
    "orient": "--orient",
    "seed": "--seed",
}


@dataclass(frozen=True, eq=False)
class CellPlan:
    """What a cell is made with.

    Args:
        row: of the table.
        column: of the table.
        folder: the dataset.
        pairs: of the row, before some are drawn.
        protocol: of the evaluation.
        weights: name or file; None for methods that need none, or for the usual ones.
        training: that the weights are from, if they are from one.
        checksum: of the dataset's files.
    """

    row: Row
    column: Column
    folder: ShapeFolder
    pairs: tuple[Pair, ...]
    protocol: Protocol
    weights: str | None
    training: TrainingRun | None
    checksum: str

    @property
    def settings(self) -> MatcherSettings:
        """How maps are made."""
        without: dict[str, Any] = dict.fromkeys(self.column.left_out)
        return MatcherSettings(method=self.method, **without)

    @property
    def method(self) -> str:
        """By which maps are made."""
        return self.column.method or self.row.method

    @property
    def n_pairs(self) -> int:
        """How many pairs are matched."""
        return self.protocol.n_pairs or len(self.pairs)

    @property
    def is_whole(self) -> bool:
        """Whether these are all pairs of the dataset."""
        return self.protocol.n_pairs is None and self.folder.description.n_pairs in (0, len(self.pairs))

    @property
    def origin(self) -> str:
        """Where the weights come from, as tables show it."""
        if self.weights is None:
            return NO_WEIGHTS
        if self.training is None:
            return self.weights
        changed = ", ".join(f"{name}={value}" for name, value in self.training.changes.items())
        return f"trained ({changed})" if changed else "trained"

    @property
    def command(self) -> str:
        """The command that makes this cell alone."""
        usual, dataset = Protocol(), data_places()[self.row.data].dataset
        words = ["homolog", "evaluate", str(self.folder.root), "--dataset", dataset]
        for name, option in _OPTIONS.items():
            value = getattr(self.protocol, name)
            words += [option, str(value)] if value != getattr(usual, name) else []
        words += ["--method", self.method] if self.method != MatcherSettings().method else []
        words += ["--weights", self.weights] if self.weights is not None else []
        return shlex.join([*words, *(f"--no-{stage}" for stage in self.column.left_out)])

    def key(self, matcher: Matcher) -> str:
        """What tells the cell from those that are made with other settings, weights or data."""
        protocol = {name: value for name, value in asdict(self.protocol).items() if name != "pairs_file"}
        told = {name: value for name, value in matcher.describe().items() if name != "device"}
        return key_of([protocol, self.pairs, self.checksum, told])


def figures_of(evaluation: Evaluation, *, is_whole: bool) -> dict[str, Any]:
    """The figures of a cell, with self-pairs and without."""
    told = evaluation.to_dict()
    others = evaluation.errors_without_self_pairs
    detected = evaluation.clutter or evaluation.missing
    errors, is_geodesic = evaluation.errors, evaluation.error_kind == "geodesic"
    thresholds, shares = pck_curve(errors)
    curve = {"thresholds": thresholds.tolist(), "shares": shares.tolist(), "area": area_under_pck(errors)}
    return {
        "mean": told[f"mean_{evaluation.error_kind}_error"],
        "mean_without_self_pairs": None if others is None else evaluation.shown(others.mean()),
        "median": told[f"median_{evaluation.error_kind}_error"],
        "unit": told["unit"],
        "pairs": len(evaluation.pairs),
        "self_pairs": sum(source == target for source, target in (pair.pair for pair in evaluation.pairs)),
        "is_whole": is_whole,
        "f1": None if detected is None else detected.f1,
        "curve": curve if is_geodesic else None,
    }
