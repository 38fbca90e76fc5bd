"""How good the shapes of a collection are, the worst first: a table and a contact sheet."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.stats import rankdata

from homolog.core.files import write_csv
from homolog.shape_models.folder import Outcome
from homolog.shape_models.gathered import Gathered
from homolog.shape_models.registering import Figures
from homolog.shapes import Shape, stand_upright
from homolog.viewing import MOST_TILES, Tile, contact_sheet, write_png

MOST_SHOWN = MOST_TILES - 1
"""So many shapes a contact sheet shows, beside the template."""

_FIGURES = tuple(field.name for field in fields(Figures))


def worst_first(outcomes: Sequence[Outcome]) -> list[Outcome]:
    """Shapes that could not be placed, then doubtful ones, then the others; each of these the worst first.

    Confidence, Dirichlet energy and how unevenly lengths came out each order shapes about as their true errors do, and
    none of them best everywhere (``docs/results.md``); flipped triangles order nothing. So it is by the mean of the
    ranks in these three; of shapes that are equal in it, by the order given.
    """
    failed = [outcome for outcome in outcomes if outcome.figures is None]
    placed = [outcome for outcome in outcomes if outcome.figures is not None]
    badness = _badness([outcome.figures for outcome in outcomes if outcome.figures is not None])
    order = sorted(range(len(placed)), key=lambda number: (not placed[number].warnings, -badness[number]))
    return [*failed, *(placed[number] for number in order)]


def _badness(figures: Sequence[Figures]) -> Float[np.ndarray, " s"]:
    """The mean rank of each shape in the figures that tell, more for worse ones."""
    measures = [(-one.confidence, one.dirichlet_energy, one.unevenness) for one in figures]
    return np.asarray(rankdata(np.reshape(measures, (-1, 3)), axis=0).mean(axis=1))


def write_quality(path: Path, gathered: Gathered) -> None:
    """Write a row per shape, in the order given; ``sheet`` is its number in the contact sheet, if it is shown there."""
    shown = worst_first(gathered.outcomes)[:MOST_SHOWN]
    places = {outcome.subject.name: place for place, outcome in enumerate(shown, start=1)}
    head = ["name", "row", "sheet", *_FIGURES, "distance_from_mean", "seconds", "doubts", "file"]
    rows = [
        [outcome.subject.name, *_measured(outcome, gathered, places.get(outcome.subject.name)), outcome.subject.file]
        for outcome in gathered.outcomes
    ]
    write_csv(path, [head, *rows])


def _measured(outcome: Outcome, gathered: Gathered, place: int | None) -> list[Any]:
    """The cells between a shape's name and its file."""
    if outcome.figures is None:
        return [None, place, *[None] * (len(_FIGURES) + 2), f"not placed: {outcome.error}"]
    row, figures = gathered.names.index(outcome.subject.name), asdict(outcome.figures)
    numbers = [None if figures[name] is None else f"{figures[name]:.6g}" for name in _FIGURES]
    away = f"{gathered.aligned.distances[row]:.6g}"
    return [row, place, *numbers, away, f"{outcome.seconds:.2f}", "; ".join(outcome.warnings)]


def write_sheet(path: Path, gathered: Gathered) -> None:
    """Draw the template and all shapes, the worst first, each with its number."""
    settings = gathered.settings
    base = stand_upright(gathered.template, settings.template_up)
    tiles = [Tile("template", (gathered.template.name,), base.points, base.faces, gathered.colours)]
    for place, outcome in enumerate(worst_first(gathered.outcomes), start=1):
        tiles.append(_tile(f"{place}. {outcome.subject.name}", outcome, gathered))
    write_png(path, contact_sheet(tiles))


def _tile(title: str, outcome: Outcome, gathered: Gathered) -> Tile:
    figures = outcome.figures
    if figures is None:
        return Tile(title, ("", "not placed"), alarming=True)
    points = gathered.points[gathered.names.index(outcome.subject.name)]
    shape = stand_upright(Shape(points), gathered.settings.shapes_up)
    flipped = "" if figures.flipped_triangles is None else f", {100 * figures.flipped_triangles:.1f} % flipped"
    lines = [f"confidence {figures.confidence:.2f}{flipped}", *(["doubtful"] if outcome.warnings else [])]
    alarming = bool(outcome.warnings)
    return Tile(title, tuple(lines), shape.points, gathered.template.faces, gathered.colours, alarming=alarming)
