"""Landmark files: tables of x, y and z, and 3D Slicer's .mrk.json and .fcsv; written in the format they were read."""

from __future__ import annotations

import csv
import io
import json
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from homolog.core.arguments import is_number
from homolog.core.choices import System
from homolog.core.errors import DataError
from homolog.core.files import atomic_path, expanded, parse_json, read_text
from homolog.core.messages import shorten
from homolog.core.reasons import reason_of
from homolog.core.records import check_plain
from homolog.shapes.formats.parsing import UnreadableError
from homolog.shapes.formats.tables import read_table_lines
from homolog.shapes.formats.text_lines import number_rows

LANDMARK_SUFFIXES = (".mrk.json", ".fcsv", ".csv", ".txt", ".xyz")
"""The suffixes of the files that ``read_landmarks`` reads."""

_LPS_TO_RAS = np.array([-1.0, -1.0, 1.0])  # and back
# Older .fcsv files have numbers for the systems.
_FCSV_LABEL = 11
# Beyond it floating-point numbers end.
_LARGEST = 1e300
_SYSTEMS: dict[str, System] = {"0": "RAS", "1": "LPS", "RAS": "RAS", "LPS": "LPS"}


@dataclass(frozen=True, eq=False)
class Landmarks:
    """Landmarks of a file.

    Args:
        points: positions in the file's coordinates; NaN for a landmark that the file leaves undefined (p, 3).
        system: the coordinate system that the file states; None if it does not.
        write: writes the same file with other positions; a position that is NaN is written as undefined.
        names: of the landmarks; empty where the file names none, or several alike.
    """

    points: Float[np.ndarray, "p 3"]
    system: System | None
    write: Callable[[Path, Float[np.ndarray, "p 3"]], None]
    names: tuple[str, ...] = ()

    def points_in(self, system: System) -> Float[np.ndarray, "p 3"]:
        """Positions in a coordinate system; unchanged where the file does not state its own."""
        return self.points if self.system in (None, system) else self.points * _LPS_TO_RAS

    def write_from(self, path: Path, points: Float[np.ndarray, "p 3"], system: System) -> None:
        """Write the same file with other positions, given in a coordinate system."""
        self.write(path, points if self.system in (None, system) else points * _LPS_TO_RAS)


def read_landmarks(path: str | Path) -> Landmarks:
    """Read landmarks; the suffix tells the format.

    Raises:
        DataError: if the file is missing, damaged, or in coordinates of a volume's voxels.

    Examples:
        >>> landmarks = read_landmarks("template.mrk.json")  # doctest: +SKIP
        >>> landmarks.points, landmarks.system  # doctest: +SKIP
    """
    file = expanded(path)
    reader = next((reader for suffix, reader in _READERS.items() if file.name.lower().endswith(suffix)), None)
    if reader is None:
        allowed = ", ".join(LANDMARK_SUFFIXES)
        raise DataError(f"{path} has the suffix {file.suffix!r}, but landmarks must have one of {allowed}")
    try:
        return reader(file)
    except (OSError, UnreadableError, UnicodeDecodeError) as error:
        raise DataError(f"{path} cannot be read as landmarks: {reason_of(error, 400)}") from None


def _read_markups(path: Path) -> Landmarks:
    text = read_text(path, encoding="utf-8-sig")
    content = _markups_content(text)
    # Of what the file defines, the points of all lists, one after the other.
    points = np.array([_position(point) for point in _control_points(content)]).reshape(-1, 3)
    systems = {str(markup.get("coordinateSystem", "LPS")) for markup in content["markups"]}
    if len(systems) > 1 or not systems <= _SYSTEMS.keys():
        found = shorten(", ".join(sorted(systems)))
        raise UnreadableError(f"its coordinate systems are {found}; save it in LPS or in RAS")

    def write(output: Path, points: Float[np.ndarray, "p 3"]) -> None:
        changed = _markups_content(text)
        for markup in changed["markups"]:
            markup.pop("measurements", None)  # lengths and areas on the other shape
        for point, position in zip(_control_points(changed), points.tolist(), strict=True):
            exists = bool(np.isfinite(position).all())
            point["position"] = position if exists else [0.0, 0.0, 0.0]
            point["positionStatus"] = point.get("positionStatus", "defined") if exists else "undefined"
        with atomic_path(output) as temporary:
            temporary.write_text(json.dumps(changed, indent=4) + "\n", encoding="utf-8", newline="\n")

    names = _distinct(str(point.get("label", "")) for point in _control_points(content))
    return Landmarks(points, _SYSTEMS[systems.pop()] if systems else "LPS", write, names)


def _markups_content(text: str) -> dict[str, Any]:
    try:
        content = parse_json(text)
        check_plain(content)
        json.dumps(content, indent=4)  # as it will be written
    except (ValueError, RecursionError) as error:
        raise UnreadableError(f"{reason_of(error, 100)}; save it again") from None
    markups = content.get("markups") if isinstance(content, dict) else None
    if not isinstance(markups, list) or not markups or not all(isinstance(markup, dict) for markup in markups):
        raise UnreadableError("it has no list 'markups', as Slicer writes it; save it again")
    return dict(content)


def _control_points(content: dict[str, Any]) -> list[dict[str, Any]]:
    lists = [markup.get("controlPoints", []) for markup in content["markups"]]
    points = [point for listed in lists if isinstance(listed, list) for point in listed]
    if not points or not all(isinstance(point, dict) for point in points):
        raise UnreadableError("it has no control points")
    return points


def _position(point: dict[str, Any]) -> list[float]:
    position = point.get("position")
    if point.get("positionStatus", "defined") == "undefined" or position is None:
        return [np.nan] * 3
    numbers = [x for x in position if is_number(x) and abs(x) < _LARGEST] if isinstance(position, list) else []
    if len(numbers) != 3 or len(position) != 3:
        raise UnreadableError(f"the position {shorten(position)} should be three numbers; save it again")
    return [float(x) for x in position]


def _read_fcsv(path: Path) -> Landmarks:
    lines = read_text(path, encoding="utf-8-sig").splitlines()
    rows = [number for number, line in enumerate(lines) if line.strip() and not line.startswith("#")]
    if not rows:
        raise UnreadableError("it holds no landmarks")
    points = number_rows([lines[number] for number in rows], (1, 2, 3), delimiter=",")
    system = _fcsv_system(lines)

    def write(output: Path, points: Float[np.ndarray, "p 3"]) -> None:
        changed = dict(zip(rows, points, strict=True))
        kept = [
            _fcsv_row(line, changed[number]) if number in changed else line
            for number, line in enumerate(lines)
            if number not in changed or np.isfinite(changed[number]).all()
        ]
        with atomic_path(output) as temporary:
            temporary.write_text("\n".join(kept) + "\n", encoding="utf-8", newline="\n")

    names = _distinct(_label_of(lines[number]) for number in rows)
    return Landmarks(points, system, write, names)


def _fcsv_system(lines: list[str]) -> System:
    """The coordinate system of the header; files that do not state one are in RAS, as the oldest are."""
    header = "\n".join(line for line in lines if line.startswith("#"))
    found = re.search(r"^#\s*CoordinateSystem\s*=\s*(\S+)", header, re.MULTILINE)
    name = found[1].upper() if found else "RAS"
    if name not in _SYSTEMS:
        raise UnreadableError(f"its coordinate system is {shorten(name)}; save it in LPS or in RAS")
    return _SYSTEMS[name]


def _label_of(line: str) -> str:
    """The label of a row, the twelfth of its columns."""
    cells = next(csv.reader([line]))
    return cells[_FCSV_LABEL].strip() if len(cells) > _FCSV_LABEL else ""


def _fcsv_row(line: str, position: Float[np.ndarray, " 3"]) -> str:
    cells = line.split(",", 4)
    return ",".join([cells[0], *(repr(float(x)) for x in position), *cells[4:]])


def _read_table(path: Path) -> Landmarks:
    # Slicer's own tables name their columns by the system.
    table = read_table_lines(path, other_axes=("lps", "ras"))
    lines_of_rows = list(table.lines)
    points = number_rows(lines_of_rows, table.columns, delimiter=table.delimiter)
    if not len(points):
        raise UnreadableError("it holds no landmarks")
    text = read_text(path, encoding="utf-8-sig", errors="replace")

    def write(output: Path, points: Float[np.ndarray, "p 3"]) -> None:
        rows = iter(points)
        left = list(lines_of_rows)
        lines = list[str]()
        for line in text.splitlines():
            # Rows come in order; what lies between them are names, comments and empty lines.
            is_row = bool(left) and line.partition("#")[0].strip() == left[0]
            lines.append(_table_row(left.pop(0), next(rows), table.columns, table.delimiter) if is_row else line)
        with atomic_path(output) as temporary:
            temporary.write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")

    names = _names_of_rows(lines_of_rows, table.columns, table.delimiter)
    return Landmarks(points, _SYSTEMS.get(table.axes.upper()), write, names)


def _names_of_rows(rows: list[str], columns: list[int], delimiter: str | None) -> tuple[str, ...]:
    """The first column of words of a table, where it tells all rows apart."""
    cells = [_cells_of(row, delimiter) for row in rows]
    width = min(map(len, cells))
    others = (tuple(row[column].strip() for row in cells) for column in range(width) if column not in columns)
    named = (_distinct(column) for column in others if not any(map(_is_number, column)))
    return next((names for names in named if names), ())


def _cells_of(row: str, delimiter: str | None) -> list[str]:
    return row.split() if delimiter is None else next(csv.reader([row], delimiter=delimiter, skipinitialspace=True))


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _distinct(names: Iterable[str]) -> tuple[str, ...]:
    """Names that tell landmarks apart; empty where one is missing, or occurs twice."""
    found = tuple(names)
    return found if all(found) and len(set(found)) == len(found) else ()


def _table_row(line: str, position: Float[np.ndarray, " 3"], columns: list[int], delimiter: str | None) -> str:
    cells = _cells_of(line, delimiter)
    for column, value in zip(columns, position, strict=True):
        cells[column] = repr(float(value))
    if delimiter is None:
        return " ".join(cells)
    written = io.StringIO()
    csv.writer(written, delimiter=delimiter, lineterminator="").writerow(cells)
    return written.getvalue()


_READERS: dict[str, Callable[[Path], Landmarks]] = {
    ".mrk.json": _read_markups,
    ".fcsv": _read_fcsv,
    ".csv": _read_table,
    ".txt": _read_table,
    ".xyz": _read_table,
}
