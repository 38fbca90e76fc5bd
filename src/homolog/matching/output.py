"""What a match leaves on disk: the maps, two coloured shapes, and a report."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, replace
from pathlib import Path, PurePath
from typing import Any, get_args

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from homolog.core.errors import ArgumentError, DataError
from homolog.core.files import all_or_nothing, expanded, made_folder, write_json
from homolog.core.progress import Timings
from homolog.matching.correspondence import Correspondence, Route
from homolog.matching.settings import Side
from homolog.shapes import Shape, drawable, read_shape, write_shape

RESULT_FILES = ("correspondence.npz", "source.ply", "target.ply", "report.json")
"""What a match writes into its folder."""

# What has no counterpart, or cannot be coloured, is grey.
_NO_COLOUR = (160, 160, 160)


def write_result(
    folder: str | Path,
    source: Shape,
    target: Shape,
    correspondence: Correspondence,
    report: dict[str, Any],
    *,
    timings: Timings | None = None,
) -> list[Path]:
    """Write ``correspondence.npz``, ``source.ply``, ``target.ply`` and ``report.json`` into a folder, made if need be.

    The shapes are as given, point by point, coloured so that the same colour means the same point; so that any program
    opens them, faces that repair drops are left out, and points without a position lie at the mean of the others. The
    four files land together once all are written; on an error or an interrupt an earlier result stays as it was. Other
    files are left alone.

    Args:
        folder: where to.
        source: as it was given.
        target: likewise.
        correspondence: between the two.
        report: what ``report.json`` is to say.
        timings: what was done before; the report tells of these steps, and of the writing of the other three files as
            one more, "write".

    Raises:
        ArgumentError: if the folder cannot be made or written to, or the correspondence is that of other shapes.
    """
    for name, shape, points in (
        ("source", source, correspondence.source_to_target),
        ("target", target, correspondence.target_to_source),
    ):
        if shape.n_points != len(points):
            raise ArgumentError(f"{name} has {shape.n_points} points, but the correspondence is of {len(points)}")
    folder = made_folder(folder)
    paths = [folder / name for name in RESULT_FILES]
    with all_or_nothing():
        with (timings or Timings()).measure("write"):
            source_colours, target_colours = matched_colours(source, correspondence)
            correspondence.save(paths[0])
            write_shape(paths[1], drawable(source), colours=source_colours)
            write_shape(paths[2], drawable(target), colours=target_colours)
        told = {} if timings is None else {"timings": [asdict(step) for step in timings.finished]}
        write_json(paths[3], report | told)
    return paths


@dataclass(frozen=True, eq=False)
class MatchResult:
    """What ``write_result`` left in a folder.

    Args:
        source: the points as given, and the faces that programs can use.
        target: likewise.
        found: the maps between them.
        report: what ``report.json`` says.
    """

    source: Shape
    target: Shape
    found: Correspondence
    report: dict[str, Any]

    def inverse(self) -> MatchResult:
        """The same with source and target exchanged; the report stays as it is."""
        return MatchResult(self.target, self.source, self.found.inverse(), self.report)


def read_result(folder: str | Path) -> MatchResult:
    """Read a match from the folder that ``write_result`` or ``homolog match`` wrote it to.

    Raises:
        DataError: if one of its files is missing, damaged, or does not fit the others.
        ShapeError: if a shape cannot be read.
    """
    place = expanded(folder)
    for name in RESULT_FILES:
        if not (place / name).is_file():
            raise DataError(f"{folder} has no {name}, so that it is no result; give a folder that homolog match wrote")
    report = _read_report(place / "report.json")
    source, target = (_read_side(place, report, side) for side in get_args(Side))
    found = Correspondence.load(
        place / "correspondence.npz", route=report["route"], warnings=tuple(report.get("warnings", ()))
    )
    _check_fit(place, source, target, found)
    return MatchResult(source, target, found, report)


def _read_side(place: Path, report: dict[str, Any], side: Side) -> Shape:
    """One of the result's shapes, by the name of the file that was matched where the report tells it."""
    shape = read_shape(place / f"{side}.ply")
    return replace(shape, name=matched_name(report, side, otherwise=shape.name))


def matched_name(report: dict[str, Any], side: Side, *, otherwise: str) -> str:
    """The name of the file that was matched, where the report of a match tells it."""
    given = report.get("inputs", {}).get(side, {}).get("file", otherwise)
    return PurePath(given).name


def _read_report(path: Path) -> dict[str, Any]:
    try:
        report = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise DataError(f"{path} cannot be read as the report of a match ({error}); match again") from None
    if not isinstance(report, dict) or report.get("route") not in get_args(Route):
        raise DataError(f"{path} is not the report of a match; match again")
    return report


def _check_fit(place: Path, source: Shape, target: Shape, found: Correspondence) -> None:
    for name, shape, other, points, confidence in (
        ("source", source, target, found.source_to_target, found.source_confidence),
        ("target", target, source, found.target_to_source, found.target_confidence),
    ):
        if (
            len(points) != shape.n_points
            or len(confidence) != shape.n_points
            or points.min() < -1
            or points.max() >= other.n_points
        ):
            raise DataError(f"{place}: correspondence.npz does not fit {name}.ply; match again")


def matched_colours(
    source: Shape, correspondence: Correspondence
) -> tuple[UInt8[np.ndarray, "n_source 3"], UInt8[np.ndarray, "n_target 3"]]:
    """Colours by the source's position, and the same on the target by its map to the source; grey without a match.

    A source point that is some target point's match has its colour even where it has no counterpart of its own.
    """
    has_match = correspondence.source_to_target >= 0
    has_match[correspondence.target_to_source[correspondence.target_to_source >= 0]] = True
    by_position = position_colours(source.points, spanned_by=has_match)
    source_colours = np.where(has_match[:, None], by_position, _grey())
    return source_colours, _carried(by_position, correspondence.target_to_source)


def position_colours(
    points: Float[np.ndarray, "n 3"], *, spanned_by: Bool[np.ndarray, " n"] | None = None
) -> UInt8[np.ndarray, "n 3"]:
    """Smooth colours from positions: the bounding box becomes the colour cube, a little lightened.

    Args:
        points: those that are not finite become grey.
        spanned_by: the points whose bounding box counts, if there are any; all by default. Stray ones would leave one
            colour for the rest.
    """
    finite = np.isfinite(points).all(axis=1)
    colours = np.full(points.shape, _NO_COLOUR, dtype=np.uint8)
    counted = finite if spanned_by is None or not (finite & spanned_by).any() else finite & spanned_by
    low, high = points[counted].min(axis=0), points[counted].max(axis=0)
    share = (points[finite] - low) / np.where(high > low, high - low, 1.0)
    colours[finite] = np.round(40 + 215 * share.clip(0, 1))
    return colours


def _carried(
    colours: UInt8[np.ndarray, "n_source 3"], target_to_source: Int[np.ndarray, " n_target"]
) -> UInt8[np.ndarray, "n_target 3"]:
    return np.where(target_to_source[:, None] >= 0, colours[target_to_source], _grey())


def _grey() -> UInt8[np.ndarray, " 3"]:
    return np.array(_NO_COLOUR, dtype=np.uint8)
