"""Overview of a shape model's quality: a table, and a contact sheet with the worst shapes first."""

from __future__ import annotations

from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

from homolog.core.files import write_csv
from homolog.shape_models.folder import Outcome
from homolog.shape_models.registered_shapes import RegisteredShapes
from homolog.shape_models.registration import Figures
from homolog.shapes import Shape, stand_upright
from homolog.viewing import MOST_TILES, Tile, contact_sheet, write_png

MOST_SHOWN = MOST_TILES - 1
"""The largest number of shapes on a contact sheet, beside the template."""

_FIGURES = tuple(field.name for field in fields(Figures))


def write_quality(path: Path, shapes: RegisteredShapes) -> None:
    """Write a table with a row per shape, in the given order.

    ``row`` is the shape's index in ``points.npy``, ``sheet`` its number on the contact sheet, if it is shown there.
    """
    number_of = {
        outcome.subject.name: number for number, outcome in enumerate(shapes.worst_first[:MOST_SHOWN], start=1)
    }
    head = ["name", "row", "sheet", *_FIGURES, "distance_from_mean", "matched_by", "seconds", "warnings", "file"]
    rows = [
        [outcome.subject.name, *_cells(outcome, shapes, number_of.get(outcome.subject.name)), outcome.subject.file]
        for outcome in shapes.outcomes
    ]
    write_csv(path, [head, *rows])


def _cells(outcome: Outcome, shapes: RegisteredShapes, number: int | None) -> list[Any]:
    """The cells between a shape's name and its file."""
    if outcome.figures is None:
        return [None, number, *[None] * (len(_FIGURES) + 3), f"not registered: {outcome.error}"]
    row, figures = shapes.row_of[outcome.subject.name], asdict(outcome.figures)
    known = (figures[name] for name in _FIGURES)
    values = [each if each is None or isinstance(each, bool) else f"{each:.6g}" for each in known]
    distance = f"{shapes.distances[row]:.6g}"
    told = outcome.matched_by, f"{outcome.seconds:.2f}", "; ".join(outcome.warnings)
    return [row, number, *values, distance, *told]


def write_sheet(path: Path, shapes: RegisteredShapes) -> None:
    """Draw the template and all shapes, numbered, the worst first."""
    base = stand_upright(shapes.template, shapes.settings.template_up)
    tiles = [Tile("template", (shapes.template.name,), base.points, base.faces, shapes.colours)]
    for number, outcome in enumerate(shapes.worst_first, start=1):
        title = f"{number}. {outcome.subject.name}"
        tiles.append(_tile(title, outcome, shapes) if number <= MOST_SHOWN else Tile(title))
    write_png(path, contact_sheet(tiles))


def _tile(title: str, outcome: Outcome, shapes: RegisteredShapes) -> Tile:
    figures = outcome.figures
    if figures is None:
        return Tile(title, ("", "not registered"), alarming=True)
    points = shapes.points[shapes.row_of[outcome.subject.name]]
    shape = stand_upright(Shape(points), shapes.settings.shapes_up)
    flipped = "" if figures.flipped_triangles is None else f", {100 * figures.flipped_triangles:.1f} % flipped"
    lines = [f"confidence {figures.confidence:.2f}{flipped}", *(["see warnings"] if outcome.warnings else [])]
    alarming = bool(outcome.warnings)
    return Tile(title, tuple(lines), shape.points, shapes.template.faces, shapes.colours, alarming=alarming)
