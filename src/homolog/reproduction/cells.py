"""The cells of tables as JSON files: what was measured, how, by what, and when."""

from __future__ import annotations

import hashlib
import json
import logging
import re
from pathlib import Path
from typing import Any

from typing_extensions import TypedDict

from homolog.core.errors import DataError
from homolog.core.files import made_folder, write_json
from homolog.core.records import read_record, record

_log = logging.getLogger(__name__)

_LONGEST_NAME = 80

FOLDER = "cells"
"""The folder of an experiment's cells, in the experiment's own."""
NO_WEIGHTS = "no weights"
"""What tables call the origin of weights where there are none."""


@record
class Curve(TypedDict):
    """The correct-points curve: shares of points with an error of at most each threshold, and the area under it."""

    thresholds: list[float]
    shares: list[float]
    area: float


@record
class Figures(TypedDict):
    """The figures of a cell: mean and median errors as tables show them, with self-pairs and without.

    ``f1`` tells how well points without a counterpart are found, or points that were added; None if there are none.
    """

    mean: float
    mean_without_self_pairs: float | None
    median: float
    unit: str
    pairs: int
    self_pairs: int
    is_whole: bool
    f1: float | None
    curve: Curve | None


@record
class Trained(TypedDict):
    """What is kept of a training that is done."""

    key: str
    weights: str
    steps: int
    seconds: float
    command: str


@record
class Cell(TypedDict):
    """One cell of a table, as it is stored."""

    experiment: str
    row: str
    column: str
    key: str
    figures: Figures
    paper: float | None
    made_by: str
    weights: list[dict[str, Any]]
    training: Trained | None
    protocol: dict[str, Any]
    data: dict[str, Any]
    command: str
    seed: int
    commit: str | None
    version: str
    machine: str
    device: str
    seconds: float
    date: str


def key_of(made_with: Any) -> str:
    """What tells apart cells that were made with other settings, weights or data."""
    return hashlib.sha256(json.dumps(made_with, sort_keys=True, default=str).encode()).hexdigest()[:12]


def slug(text: str) -> str:
    """A text as a part of a file's name; a long one is cut, and told apart from others by its hash.

    Examples:
        >>> slug("FAUST_r, noisy cloud")
        'FAUST_r-noisy-cloud'
    """
    name = re.sub(r"[^\w.]+", "-", text).strip("-")
    return name if len(name) <= _LONGEST_NAME else f"{name[:_LONGEST_NAME]}-{key_of(text)}"


def cell_file(folder: Path, row: str, column: str, key: str) -> Path:
    """The file of a cell in the folder of its experiment."""
    return folder / FOLDER / f"{slug(row)}--{column}--{key}.json"


def stored_cell(file: Path, key: str) -> dict[str, Any] | None:
    """A cell that was made before; None if there is none, or, with a warning, if its file is damaged."""
    found = _whole(file, "it is made again") if file.is_file() else None
    if found is not None and found["key"] != key:
        _log.warning("%s is another cell's, %s; it is made again.", file, found["key"])
        return None
    return found


def stored_cells(folder: Path) -> list[dict[str, Any]]:
    """All whole cells in the folder of an experiment; damaged ones are named in a warning."""
    found = (_whole(file, "it is left out of the table") for file in sorted((folder / FOLDER).glob("*.json")))
    return [cell for cell in found if cell is not None]


def write_cell(file: Path, cell: dict[str, Any]) -> None:
    """Write a cell whole or not at all."""
    made_folder(file.parent)
    write_json(file, cell)


def _whole(file: Path, instead: str) -> dict[str, Any] | None:
    """The cell in a file; None, with a warning, if it is damaged."""
    try:
        return read_record(file, Cell, instead=instead)
    except DataError as error:
        _log.warning("%s.", error)
        return None
