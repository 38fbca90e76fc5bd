"""Text tables of points: XYZ, TXT and CSV."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from homolog.core.messages import shorten
from homolog.core.reasons import reason_of
from homolog.shapes.finding import Finding
from homolog.shapes.formats.parsing import CUT_OFF, Arrays, UnreadableError, left_out
from homolog.shapes.formats.text_lines import GrowingArray, batches, n_lines, number_rows, text_blocks, text_lines
from homolog.shapes.formats.text_rows import write_rows
from homolog.shapes.shape import Shape

# Other names of coordinates than x, y and z, in lower case: pos_x, x_coord, x [mm], x_mm, and ParaView's Points:0.
_AXIS = re.compile(
    r"points[:_](?P<number>[012])|(?:(?:pos|position|points?|coord|coordinate)[ _.:-]?)?(?P<axis>[xyz])"
    r"(?:[ _.:-]?(?:pos|position|coord|coordinate))?(?:_(?:mm|cm|m)|[ _]*[\[(][^])]*[])])?"
)


# Numbers with decimal commas, with nothing but blanks between them.
_DECIMAL_COMMAS = re.compile(r"(?=.*\d,\d)(?:[-+]?\d+(?:,\d+)?(?:e[-+]?\d+)?(?:\s+|$)){2,}", re.IGNORECASE)
# A cell without a number.
_MISSING = re.compile(r"(?<![^,;|\t])[ ]*(?:(?:NA|N/A|null|none)[ ]*)?(?=[,;|\t]|$)", re.IGNORECASE)
# First lines that tell what the columns are, and the most digits of a number of a row.
_HEAD, _DIGITS = 8, 18
# Fewer words than coordinates are a title.
_FEWEST_NAMES = 3
_BLANKS_BEFORE_QUOTES = re.compile(r'(?<=[,;|\t]) +(?=")')
# What some programs write before a table, to say what separates its cells.
_SEPARATOR = re.compile(r"sep=.?", re.IGNORECASE)


def read(path: Path) -> Arrays:
    """Read a text file with one point a line, separated by commas, semicolons, tabs, ``|`` or blanks.

    ``#`` starts a comment. Numbers may have decimal commas where something else separates them. A row whose coordinates
    are empty, or say NA, is a point of NaN.

    A first line that holds the number of points is passed over, and so is the line of words behind it in chemists' XYZ,
    and before it one that says what separates cells (``sep=;``). A first row of words, or a comment before the first
    row, names the columns: those of x, y and z are taken, in whatever case, with a unit in brackets, or as in
    ``pos_x``. Without names, or where there are only three columns, the first three are, with a note on other names; a
    column of names or row numbers before them is left out.

    Raises:
        UnreadableError: if there are fewer than three columns, or more than three have names, and x, y and z are not
            among them.
    """
    table = read_table_lines(path)
    return Arrays(table.points(), notes=table.notes)


def _readable(line: str, columns: list[int]) -> str:
    """A row as NumPy reads it: quotes right behind what separates cells, and NaN where there are no coordinates.

    Where only some are missing it stays, and is refused.
    """
    line = _BLANKS_BEFORE_QUOTES.sub("", line) if '"' in line else line
    if not _MISSING.search(line):
        return line
    cells = _cells(line)
    missing = len(cells) > max(columns) and all(_MISSING.fullmatch(cells[column]) for column in columns)
    return _MISSING.sub("nan", line) if missing else line


@dataclass(frozen=True)
class TextRows:
    """The rows of a table, which are read from its file as often as they are gone through.

    Args:
        path: the file.
        skip: the lines before the first row, without comments and empty ones.
        decimal_commas: whether commas stand for decimal points.
    """

    path: Path
    skip: int
    decimal_commas: bool = False

    def __iter__(self) -> Iterator[str]:
        lines = islice(text_lines(self.path), self.skip, None)
        return (line.replace(",", ".") for line in lines) if self.decimal_commas else lines

    def as_written(self) -> list[str]:
        """The rows with their decimal commas."""
        return list(replace(self, decimal_commas=False))


class TableLines(NamedTuple):
    """The rows of a table of points, without comments and names, and where in a row the coordinates are.

    Args:
        lines: the rows.
        columns: those of the coordinates.
        delimiter: what separates cells; None for blanks.
        axes: the names of the columns: "xyz", or of the others that were asked for those that the table has.
        notes: what was left out.
    """

    lines: TextRows
    columns: list[int]
    delimiter: str | None
    axes: str = "xyz"
    notes: tuple[Finding, ...] = ()

    def points(self) -> Float[np.ndarray, "n 3"]:
        """The coordinates of all rows; NaN in a row that has none."""
        lines = iter(self.lines) if self.delimiter is None else (_readable(line, self.columns) for line in self.lines)
        return number_rows(lines, self.columns, delimiter=self.delimiter)


def read_table_lines(path: Path, *, other_axes: tuple[str, ...] = ()) -> TableLines:
    """Read a table of points as ``read`` does, up to its numbers.

    Args:
        path: the file.
        other_axes: other names that the columns may have in its first row, such as "ras", a letter each.
    """
    text, head = next(text_blocks(path), ""), list(islice(text_lines(path), _HEAD))
    lines = head[1:] if head and _SEPARATOR.fullmatch(head[0]) else head[:]
    lines, has_elements = _without_count(text, lines, path, len(head) - len(lines))
    if not lines:
        raise UnreadableError("it holds no points")
    names = _names(lines.pop(0)) if _is_header(lines) else []
    rows = TextRows(path, len(head) - len(lines))
    if not lines:
        return TableLines(rows, [0, 1, 2], None)
    delimiter, cells = _delimiter(lines[0]), _cells(lines[0])
    rows = replace(rows, decimal_commas=delimiter != ",")
    # A table with one name too few has row numbers or names before its columns, as R writes them.
    names = ["", *names] if names and len(names) + 1 == len(cells) and cells[-1] else names
    for axes in other_axes:
        if all(names.count(axis) == 1 for axis in axes):
            return TableLines(rows, [names.index(axis) for axis in axes], delimiter, axes)
    _check_width(names, lines[0], cells)
    names = names if len(names) >= _FEWEST_NAMES else _commented_names(text, lines[0])
    if not names and len(cells) > 3 and _starts_with_index(rows, repeated=has_elements):
        note = left_out("first column", 1, "it names or numbers the rows")
        return TableLines(rows, [1, 2, 3], delimiter, notes=(note, *_other_columns(cells[1:], "the next three")))
    columns = _xyz_columns(names)
    notes = _other_columns(cells, ", ".join(names[column] for column in columns) if names else "the first three")
    return TableLines(rows, columns, delimiter, notes=(*notes, *_other_names(names, columns)))


def _check_width(names: list[str], row: str, cells: list[str]) -> None:
    """Refuse a table of fewer columns than coordinates, by their names or by its first row."""
    named, n_cells = list(filter(None, names)), len(list(filter(None, cells)))
    missing = [axis for axis in "xyz" if axis not in map(_axis, named)]
    numbered = len(cells) == _FEWEST_NAMES and names[:1] == [""] and missing == ["z"]  # row numbers, x and y
    if max(len(names), len(cells)) >= _FEWEST_NAMES and not numbered:
        return
    if 0 < len(missing) < _FEWEST_NAMES:
        lacks = (
            f"{'an' if missing == ['x'] else 'a'} {missing[0]} is missing"
            if len(missing) == 1
            else f"{' and '.join(missing)} are missing"
        )
        raise UnreadableError(f"its columns are named {shorten(', '.join(named), 100)}; {lacks}; add what is missing")
    if n_cells == 1:
        raise UnreadableError(
            f"the line {shorten(row)!r} is one value, but x, y and z are needed, separated by commas, semicolons, "
            "tabs, | or blanks"
        )
    found = f"its first row {shorten(row)!r} has {n_cells} values"
    raise UnreadableError(f"{found}, but three columns are needed, x, y and z; add what is missing")


def _other_columns(cells: list[str], taken: str) -> tuple[Finding, ...]:
    """A note on the columns beside the coordinates, if there are some, which says what was taken instead."""
    count = sum(map(bool, cells)) - 3
    why = f"the coordinates are {taken}; if they are not, name their columns x, y and z in a first row"
    return (left_out("other columns", count, why),) if count > 0 else ()


def _other_names(names: list[str], columns: list[int]) -> tuple[Finding, ...]:
    """A note on columns that are taken for x, y and z though they have other names, which numbers are not."""
    if not names or _axes(names) is not None or all(names[column].isdecimal() for column in columns):
        return ()
    taken = shorten(", ".join(names[column] for column in columns), 100)
    return (
        Finding(
            "columns of other names",
            3,
            "note",
            f"{taken} are taken as x, y and z; if they are something else, convert them",
        ),
    )


def _without_count(text: str, lines: list[str], path: Path, skip: int) -> tuple[list[str], bool]:
    """The lines without a first one that holds the number of points, and a comment that may follow it.

    Args:
        text: the beginning of the file.
        lines: its first lines.
        path: the file.
        skip: lines before these.

    Returns:
        The lines, and whether there was such a comment, so that rows may begin with elements.
    """
    if not lines or not re.fullmatch(r"\d+", lines[0]):
        return lines, False
    count, rows, n_rows = int(lines[0]), lines[1:], n_lines(TextRows(path, skip + 1))
    behind = text.partition(lines[0])[2].splitlines()[1:2]
    # Chemists' second line is a comment whatever it holds, be it nothing, or numbers before rows that begin with words.
    is_comment = bool(behind) and n_rows > 1 and behind[0].strip() == rows[0]
    if is_comment and n_rows == count + 1 and (not _is_number(_cells(rows[1])[0]) or not _is_numbers(rows[0])):
        # Names of columns are no comment.
        return (rows, False) if _axes(_names(rows[0])) is not None else (rows[1:], True)
    if n_rows != count and not (n_rows == count + 1 and not _is_numbers(rows[0])):
        mend = CUT_OFF if n_rows < count else "correct that number, or keep one of several clouds"
        raise UnreadableError(f"its first line announces {count} points, but {n_rows} lines follow; {mend}")
    return rows, n_rows == count and behind == [""]


def _is_header(lines: list[str]) -> bool:
    """Whether the first row names the columns: by words, or by their numbers from 0, as pandas writes them."""
    cells = _cells(lines[0])
    numbered = [cell for cell in cells if cell] == [str(number) for number in range(len(cells) - (not cells[0]))]
    if numbered and len(cells) > 2 and len(lines) > 1:
        return not cells[0] or "." in lines[1]
    return not _is_numbers(lines[0])


def _starts_with_index(lines: Iterable[str], *, repeated: bool) -> bool:
    """Whether the first cells of all rows are words, or whole numbers that number the rows.

    They do if they count them from 0 or 1. In any other order they do where no two are equal and the three behind them
    have decimal places, as points have; ``repeated`` lets them be equal, as the numbers of chemical elements are.
    """
    first = _cells(next(iter(lines)))[0]
    if not first.isdecimal():
        return not _is_number(first)
    numbers, counted, decimal = GrowingArray(np.int64), first in ("0", "1"), True
    for batch in batches(lines):
        rows = [_cells(line) for line in batch]
        if not all(row[0].isdecimal() and len(row[0]) <= _DIGITS for row in rows):
            return False
        batch_numbers = np.array([int(row[0]) for row in rows])
        counted = counted and bool((batch_numbers == np.arange(len(rows)) + len(numbers) + int(first)).all())
        decimal = decimal and all("." in cell for row in rows for cell in row[1:4])
        if not (counted or decimal):
            return False
        numbers.append(batch_numbers)
    return counted or repeated or len(np.unique(numbers.rows(1))) == len(numbers)


def _delimiter(line: str) -> str | None:
    """What separates the cells of a line; None for blanks. A single ``|`` may be a part of a name."""
    marks = ";\t" if _DECIMAL_COMMAS.fullmatch(line) else ";|,\t" if line.count("|") > 1 else ";,\t|"
    return next((mark for mark in marks if mark in line), None)


def _cells(line: str) -> list[str]:
    """The cells of a line, without the quotes around them."""
    return [cell.strip(" \"'") for cell in row_cells(line, _delimiter(line))]


def row_cells(line: str, delimiter: str | None) -> list[str]:
    """The cells of a line; a delimiter within double quotes is part of a cell.

    Raises:
        UnreadableError: if it is no row of a table.
    """
    try:
        rows = csv.reader([line], delimiter=delimiter or " ", skipinitialspace=True)
        return line.split() if delimiter is None else next(rows)
    except csv.Error as error:
        raise UnreadableError(
            f"the line {shorten(line)!r} is no row of a table ({reason_of(error)}); correct or remove it"
        ) from None


def _is_numbers(line: str) -> bool:
    """Whether a row holds a number at all; a row of words is a header."""
    return any(_is_number(cell) for cell in _cells(line))


def _is_number(cell: str) -> bool:
    try:
        float(cell.replace(",", "."))
    except ValueError:
        return False
    return True


def _names(header: str) -> list[str]:
    """The names of columns, in lower case; a unit in brackets stays with its name, and CloudCompare's // goes."""
    return [name.lower() for name in _cells(re.sub(r"(?<!\s)\s+(?=[\[(])", "", header.lstrip("/ ")))]


def _commented_names(text: str, first_row: str) -> list[str]:
    """The names in the comment before the first row, where they are often kept; a remark names no columns."""
    before = text.partition(first_row)[0].strip().splitlines()
    comment = re.sub(r"^\w+:\s+", "", before[-1].lstrip("# ")) if before else ""
    names, n_columns = _names(comment), len(_cells(first_row))
    named = len(names) == n_columns or (len(names) < n_columns and _axes(names) is not None)
    return names if len(names) >= _FEWEST_NAMES and named and not _is_numbers(comment) else []


def _xyz_columns(names: list[str]) -> list[int]:
    columns = _axes(names)
    if columns is None and len(names) == 4 and not names[0]:
        return [1, 2, 3]  # an index, and three columns
    if columns is None and len(names) > 3:
        found = shorten(", ".join(names), 100)
        raise UnreadableError(
            f"its columns are named {found}; name those of the coordinates x, y, z, or keep only them"
        )
    return columns or [0, 1, 2]


def _axes(names: list[str]) -> list[int] | None:
    """The columns of x, y and z, by their bare names before any others; None where they cannot be told."""
    for axes in (names, [_axis(name) for name in names]):
        if all(axes.count(axis) == 1 for axis in "xyz"):
            return [axes.index(axis) for axis in "xyz"]
    return None


def _axis(name: str) -> str:
    found = _AXIS.fullmatch(name)
    if found is None:
        return ""
    return found["axis"] or "xyz"[int(found["number"])]


def write_blanks(path: Path, shape: Shape) -> None:
    """Write a line of three numbers a point, with blanks between them."""
    write_rows(path, [("%r %r %r\n", shape.points)])


def write_csv(path: Path, shape: Shape) -> None:
    """Write a table with the columns x, y and z, with commas between them."""
    write_rows(path, [("%r,%r,%r\n", shape.points)], "x,y,z\n")
