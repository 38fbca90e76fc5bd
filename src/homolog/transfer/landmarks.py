"""Landmark files: tables, 3D Slicer's .mrk.json and .fcsv, scalismo's .json; written in the format they were read."""

from __future__ import annotations

import csv
import io
import json
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
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
from homolog.shapes.formats.tables import read_table_lines, row_cells
from homolog.shapes.formats.text_lines import number_rows

LANDMARK_SUFFIXES = (".mrk.json", ".json", ".fcsv", ".csv", ".txt", ".xyz")
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
        names: as the file has them; numbers from 1 where it has none.
        suffix: of the file, which tells the format.
    """

    points: Float[np.ndarray, "p 3"]
    system: System | None
    write: Callable[[Path, Float[np.ndarray, "p 3"]], None]
    names: tuple[str, ...] = ()
    suffix: str = ""

    def points_in(self, system: System) -> Float[np.ndarray, "p 3"]:
        """Positions in a coordinate system; unchanged where the file does not state its own."""
        return self.points if self.system in (None, system) else self.points * _LPS_TO_RAS

    def write_from(self, path: Path, points: Float[np.ndarray, "p 3"], system: System) -> None:
        """Write the same file with other positions, given in a coordinate system."""
        self.write(path, points if self.system in (None, system) else points * _LPS_TO_RAS)


def system_of(space: str | None, axes: System | None = None) -> System:
    """The coordinate system of a shape: the one that was given, or that its file names, or LPS."""
    return axes or ("RAS" if space == "RAS" else "LPS")


def read_landmarks(path: str | Path) -> Landmarks:
    """Read landmarks; the suffix tells the format.

    Raises:
        DataError: if the file is missing, damaged, or in coordinates of a volume's voxels.

    Examples:
        >>> landmarks = read_landmarks("template.mrk.json")  # doctest: +SKIP
        >>> landmarks.points, landmarks.system  # doctest: +SKIP
    """
    file = expanded(path)
    suffix = next((suffix for suffix in _READERS if file.name.lower().endswith(suffix)), None)
    if suffix is None:
        allowed = ", ".join(LANDMARK_SUFFIXES)
        raise DataError(f"{path} has the suffix {file.suffix!r}, but landmarks must have one of {allowed}")
    try:
        found = _READERS[suffix](file)
    except (OSError, UnreadableError, UnicodeDecodeError) as error:
        raise DataError(f"{path} cannot be read as landmarks: {reason_of(error, 400)}") from None
    names = tuple(name or str(number) for number, name in enumerate(found.names, 1))
    return replace(found, names=names, suffix=suffix)


def _read_markups(path: Path) -> Landmarks:
    text = read_text(path)
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

    names = tuple(str(point.get("label") or point.get("id") or "") for point in _control_points(content))
    return Landmarks(points, _SYSTEMS[systems.pop()] if systems else "LPS", write, names)


def _json_content(text: str) -> Any:
    try:
        content = parse_json(text)
        check_plain(content)
        json.dumps(content, indent=4)  # as it will be written
    except (ValueError, RecursionError) as error:
        raise UnreadableError(f"{reason_of(error, 100)}; save it again") from None
    return content


def _markups_content(text: str) -> dict[str, Any]:
    content = _json_content(text)
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
    return _three_numbers(position)


def _three_numbers(position: Any) -> list[float]:
    numbers = [x for x in position if is_number(x) and abs(x) < _LARGEST] if isinstance(position, list) else []
    if len(numbers) != 3 or len(position) != 3:
        raise UnreadableError(f"the position {shorten(position)} should be three numbers; save it again")
    return [float(x) for x in position]


def _read_scalismo(path: Path) -> Landmarks:
    """A list of landmarks with ``id`` and ``coordinates``, as scalismo writes it.

    What else it says of a landmark stays, but for its uncertainty, whose directions are those of the other shape. A
    landmark without a position is left out.
    """
    text = read_text(path)
    points = np.array([_three_numbers(each["coordinates"]) for each in _scalismo_content(text)]).reshape(-1, 3)

    def write(output: Path, points: Float[np.ndarray, "p 3"]) -> None:
        moved = [
            {**{key: value for key, value in each.items() if key != "uncertainty"}, "coordinates": position}
            for each, position in zip(_scalismo_content(text), points.tolist(), strict=True)
            if np.isfinite(position).all()
        ]
        with atomic_path(output) as temporary:
            temporary.write_text(json.dumps(moved, indent=1) + "\n", encoding="utf-8", newline="\n")

    return Landmarks(points, None, write, tuple(str(each["id"]) for each in _scalismo_content(text)))


def _scalismo_content(text: str) -> list[dict[str, Any]]:
    content = _json_content(text)
    is_known = isinstance(content, list) and all(
        isinstance(each, dict) and isinstance(each.get("id"), str) and "coordinates" in each for each in content
    )
    if not is_known:
        raise UnreadableError(
            "it is no list of landmarks with 'id' and 'coordinates', as scalismo writes it; the files of 3D Slicer are "
            "called .mrk.json"
        )
    if not content:
        raise UnreadableError("it holds no landmarks")
    return list(content)


def _read_fcsv(path: Path) -> Landmarks:
    lines = read_text(path).splitlines()
    rows = [number for number, line in enumerate(lines) if line.strip() and not line.startswith("#")]
    if not rows:
        raise UnreadableError("it holds no landmarks")
    points = number_rows([lines[number] for number in rows], (1, 2, 3), delimiter=",")
    system = _fcsv_system(lines)

    def write(output: Path, points: Float[np.ndarray, "p 3"]) -> None:
        changed = dict(zip(rows, points, strict=True))
        kept = list[str]()
        for number, line in enumerate(lines):
            if number not in changed:
                kept.append(line)
            elif np.isfinite(changed[number]).all():
                cells = line.split(",", 4)
                kept.append(",".join([cells[0], *(repr(float(x)) for x in changed[number]), *cells[4:]]))
        with atomic_path(output) as temporary:
            temporary.write_text("\n".join(kept) + "\n", encoding="utf-8", newline="\n")

    labels = _fcsv_label_column(lines)
    cells = [row_cells(lines[number], ",") for number in rows]
    names = tuple((row[labels] if labels < len(row) else "") or row[0] for row in cells)
    tells_apart = len(set(names)) == len(names)
    return Landmarks(points, system, write, names if tells_apart else tuple(row[0] for row in cells))


def _fcsv_label_column(lines: list[str]) -> int:
    """The column of the labels, which the header names; the twelfth one where it does not."""
    header = (line.partition("=")[2] for line in lines if re.match(r"#\s*columns\s*=", line))
    names = [name.strip() for name in next(header, "").split(",")]
    return names.index("label") if "label" in names else _FCSV_LABEL


def _fcsv_system(lines: list[str]) -> System:
    """The coordinate system of the header; files that do not state one are in RAS, as the oldest are."""
    header = "\n".join(line for line in lines if line.startswith("#"))
    found = re.search(r"^#\s*CoordinateSystem\s*=\s*(\S+)", header, re.MULTILINE)
    name = found[1].upper() if found else "RAS"
    if name not in _SYSTEMS:
        raise UnreadableError(f"its coordinate system is {shorten(name)}; save it in LPS or in RAS")
    return _SYSTEMS[name]


def _read_table(path: Path) -> Landmarks:
    # Slicer's own tables name their columns by the system.
    table = read_table_lines(path, other_axes=("lps", "ras"))
    lines_of_rows = table.lines.as_written()
    text = read_text(path, errors="replace")
    cells = [row_cells(line, table.delimiter) for line in lines_of_rows]  # what cannot be written again is refused now
    if _begins_with_names(text, cells):
        table = table._replace(columns=[1, 2, 3])
    points = table.points()
    if not len(points):
        raise UnreadableError("it holds no landmarks")

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

    names = tuple(next((cell for n, cell in enumerate(row) if n not in table.columns), "") for row in cells)
    return Landmarks(points, _SYSTEMS.get(table.axes.upper()), write, names)


def _begins_with_names(text: str, cells: list[list[str]]) -> bool:
    """Whether a table without names of columns has four, as scalismo writes it: a landmark's name and three numbers."""
    first = next((line for line in text.splitlines() if line.strip() and not line.startswith("#")), "")
    return all(len(row) == 4 for row in cells) and bool(cells) and row_cells(first, ",") == cells[0]


def _table_row(line: str, position: Float[np.ndarray, " 3"], columns: list[int], delimiter: str | None) -> str:
    cells = row_cells(line, delimiter)
    for column, value in zip(columns, position, strict=True):
        number = repr(float(value))
        cells[column] = number.replace(".", ",") if "," in cells[column] else number
    if delimiter is None:
        return " ".join(cells)
    written = io.StringIO()
    csv.writer(written, delimiter=delimiter, lineterminator="").writerow(cells)
    return written.getvalue()


_READERS: dict[str, Callable[[Path], Landmarks]] = {
    ".mrk.json": _read_markups,
    ".json": _read_scalismo,
    ".fcsv": _read_fcsv,
    ".csv": _read_table,
    ".txt": _read_table,
    ".xyz": _read_table,
}
