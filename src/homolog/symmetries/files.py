"""A symmetry on disk: a table of points, shapes in the colours of their asymmetry, and figures."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from homolog.core.errors import DataError
from homolog.core.files import expanded, read_text, write_csv, write_json, written_together
from homolog.core.reasons import reason_of
from homolog.core.versions import versions
from homolog.matching import Match, given_files
from homolog.pairs import SIDES
from homolog.shapes import Shape, drawable, write_shape
from homolog.symmetries.finding import Symmetry
from homolog.viewing import Layer, Scene, heat_layer, scene_of

POINTS, ASYMMETRY, STRETCH, MIRRORED, REPORT = (
    "points.csv",
    "asymmetry.ply",
    "stretch.ply",
    "mirrored.ply",
    "symmetry.json",
)
SYMMETRY_FILES = (POINTS, ASYMMETRY, STRETCH, MIRRORED, REPORT)
"""What a symmetry writes into its folder."""

_COLUMNS = ("point", "partner", "confidence", "asymmetry", "stretch", "x", "y", "z")


def write_symmetry(folder: str | Path, found: Symmetry) -> list[Path]:
    """Write a symmetry into a folder, whole or not at all.

    ``points.csv`` has a row per point of the file: its number from 0, its partner's (-1 for none), the confidence, the
    asymmetry, the stretch, and where the partner lies (x, y, z). ``asymmetry.ply`` and ``stretch.ply`` are the shape in
    a heat map of these. ``mirrored.ply`` is the shape reflected in its plane, its points numbered as in its file.
    ``symmetry.json`` has the plane, all figures, and the report of the match with the mirror image.

    Returns:
        The files that were written.

    Raises:
        ArgumentError: if the folder cannot be written to, or a file in it is an input.
    """
    shape, layers = drawable(found.shape), heat_layers(found)
    with written_together(folder, SYMMETRY_FILES, given_files(found.match)) as paths:
        write_csv(paths[0], [_COLUMNS, *_rows(found)])
        for path, layer in zip(paths[1:3], layers, strict=True):
            write_shape(path, shape, colours=layer.colours["source"])
        write_shape(paths[3], drawable(found.mirrored))
        report = {**found.figures(), "versions": versions(), "match": dict(found.match.report)}
        write_json(paths[4], {"warnings": list(found.warnings), "method": found.match.method, **report})
    return paths


def read_partner_positions(folder: str | Path, shape: Shape) -> Float[np.ndarray, "n 3"]:
    """Where the mirror partner of each point of a shape lies, from a folder that ``write_symmetry`` wrote of it.

    Args:
        folder: that folder.
        shape: as it was read.

    Returns:
        Positions in the shape's coordinates; NaN without a partner (n, 3).

    Raises:
        DataError: if there is no such table, it is damaged, or is that of another shape.
    """
    path = expanded(folder) / POINTS
    try:
        rows = list(csv.DictReader(read_text(path).splitlines()))
        values = np.array([[float(row[axis] or "nan") for axis in "xyz"] for row in rows]).reshape(-1, 3)
    except OSError as error:
        raise DataError(f"{path} cannot be read ({reason_of(error)}); give a folder of homolog symmetry") from None
    except (UnicodeDecodeError, KeyError, TypeError, ValueError, csv.Error):
        raise DataError(f"{path} is no table of mirror partners; run homolog symmetry again") from None
    if len(values) != shape.n_points or np.isinf(values).any():
        raise DataError(
            f"{path} has the partners of {len(values)} points, but {shape.name} has {shape.n_points} points; "
            f"run homolog symmetry on {shape.name}"
        )
    return values


def heat_layers(found: Symmetry) -> tuple[Layer, Layer]:
    """The asymmetry and the stretch of each point as colours."""
    stretch = 100 * (np.exp(np.abs(np.log(found.stretch))) - 1)
    return (
        heat_layer(
            "Asymmetry",
            "How far each point lies from its partner's mirror image. Grey: no partner.",
            dict.fromkeys(SIDES, found.asymmetry),
            "units of the file",
        ),
        heat_layer(
            "Stretch",
            "How much longer or shorter the surface is around the partner. Grey: no partner.",
            dict.fromkeys(SIDES, stretch),
            "%",
        ),
    )


def scene_of_symmetry(found: Symmetry) -> Scene:
    """The shape twice: the same colour marks a point and its partner; and both heat maps."""
    report = {**found.match.report, "warnings": list(found.warnings)}
    shape, partner, trust = found.shape, found.partner, found.confidence
    match = Match(shape, shape, partner, partner, trust, trust, found.match.method, report=report)
    return replace(scene_of(match, heat_layers(found)), guide=None)  # no landmarks guide it


def _rows(found: Symmetry) -> Iterator[Sequence[Any]]:
    """A row per point; numbers that are not known are empty."""
    columns = (found.confidence, found.asymmetry, found.stretch, *found.positions.T)
    numbers = np.stack([np.asarray(column, dtype=float) for column in columns], axis=1).tolist()
    for point, (partner, row) in enumerate(zip(found.partner.tolist(), numbers, strict=True)):
        yield point, partner, *(value if np.isfinite(value) else None for value in row)
