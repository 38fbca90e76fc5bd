"""Pictures beside the tables: a match of each cell, curves of correct points, and errors along an axis."""

from __future__ import annotations

import logging
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

from homolog.core.errors import MissingExtraError
from homolog.core.files import made_folder
from homolog.evaluation import PckCurve, plot_errors, plot_pck_curves
from homolog.matching import Match
from homolog.reproduction.cells import slug, stored_cells
from homolog.reproduction.experiments import COLUMNS, Experiment
from homolog.reproduction.report import chosen_cells
from homolog.viewing import scene_of, write_picture

_log = logging.getLogger(__name__)

PICTURES = "pictures"
"""The folder of pictures, in that of an experiment."""
_WIDTH = 800


def write_match(folder: Path, name: str, match: Match) -> None:
    """Draw a match, as a picture of this name in the folder of an experiment."""
    with _without_extras():
        write_picture(made_folder(folder / PICTURES) / f"{name}.png", scene_of(match), width=_WIDTH)


def write_curves(experiment: Experiment, folder: Path) -> None:
    """Draw the correct-points curves of each column and origin of weights, and errors along the experiment's axis."""
    cells = chosen_cells(experiment, stored_cells(folder))
    rows = {row.name: row for row in experiment.rows}
    correct, along = defaultdict[str, dict[str, PckCurve]](dict), defaultdict[str, dict[float, float]](dict)
    for (name, column, origin), cell in cells.items():
        curve, row = cell["figures"]["curve"], rows[name]
        if curve is not None:
            correct[f"{column}-{slug(origin)}"][name] = (curve["thresholds"], curve["shares"], curve["area"])
        if experiment.axis:
            title = f"{row.curve}: {COLUMNS[column].title}, {origin}"
            along[title][getattr(row, experiment.axis)] = cell["figures"]["mean"]
    with _without_extras():
        for name, curves in correct.items():
            plot_pck_curves(folder / f"pck-{name}.png", curves)
        if along:
            plot_errors(folder / f"{experiment.axis}.png", along, along=experiment.axis)


@contextmanager
def _without_extras() -> Iterator[None]:
    """Say once what is not drawn for want of a package, and go on."""
    try:
        yield
    except MissingExtraError as error:
        _say_once(f"{error}; there will be no pictures")


@cache
def _say_once(line: str) -> None:
    _log.warning("%s.", line)
