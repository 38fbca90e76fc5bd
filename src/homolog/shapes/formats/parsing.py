"""What the readers of all formats share: the arrays they give, how they fail, rows of numbers, polygons."""

from __future__ import annotations

import codecs
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Literal, NamedTuple, NoReturn, cast

import numpy as np
from jaxtyping import Float, Int

from homolog.core.files import read_bytes
from homolog.core.messages import shorten, shown
from homolog.shapes.finding import Finding
from homolog.shapes.polygons import triangulate

Space = Literal["RAS", "LPS"]
"""Anatomical axes: x to the right, y to the front and z up, or x to the left, y to the back and z up."""

# As 3D Slicer writes it into the comments and titles of meshes.
_SPACE = re.compile(rb"SPACE=(RAS|LPS)\b")


class Arrays(NamedTuple):
    """What a reader gives.

    Args:
        points: in file order.
        faces: triangles of point indices from 0; None for a point cloud.
        notes: what the reader left out or decided, which ``check`` reports.
        space: the anatomical axes that the file names.
    """

    points: Float[np.ndarray, "n 3"]
    faces: Int[np.ndarray, "m 3"] | None = None
    notes: tuple[Finding, ...] = ()
    space: Space | None = None


def left_out(what: str, count: int, why: str) -> Finding:
    """A note on what a reader passed over."""
    return Finding(what, count, "note", f"left out; {why}")


def lines_left_out(count: int) -> tuple[Finding, ...]:
    """A note on the lines of a file, if it has some."""
    return (left_out("lines", count, "a shape has points and triangles"),) if count else ()


def space_of(head: bytes) -> Space | None:
    """The anatomical axes that the comments of a file name, as 3D Slicer writes them."""
    found = _SPACE.search(head)
    return cast(Space, found[1].decode()) if found else None


def polygon_faces(
    points: Float[np.ndarray, "n 3"], sizes: Int[np.ndarray, " m"], corners: Int[np.ndarray, " c"]
) -> Int[np.ndarray, "t 3"]:
    """The triangles of polygons, as indices of points."""
    faces: np.ndarray = corners[triangulate(points, sizes, corners)]
    return faces


class UnreadableError(Exception):
    """The content of a file is not as its format says; the message is the reason, without the file's name."""


CUT_OFF = "the file is cut off or damaged; export it again"


def refuse_further_lines(count: int, announced: str) -> None:
    """Refuse a text that goes on after all that its header announces: what is more would be lost.

    Args:
        count: the lines that follow.
        announced: what the header announces, such as ``"4 points, 2 faces"``.
    """
    if count > 0:
        follow = "1 line follows" if count == 1 else f"{count} lines follow"
        raise UnreadableError(
            f"{follow} the elements that its header announces ({announced}); correct its counts, or remove those lines"
        )


def check_claim(count: int, what: str, smallest: int, available: int) -> None:
    """Refuse a header that announces more than the file can hold, before anything is allocated.

    Args:
        count: how many the header announces.
        what: what is counted, such as ``"points"``.
        smallest: the fewest bytes that one of them takes.
        available: bytes in the file.
    """
    if count < 0:
        raise UnreadableError(f"the header announces {shown(count)} {what}; {CUT_OFF}")
    if count * smallest > available:
        found = f"the file has only {available} bytes"
        raise UnreadableError(f"the header announces {shown(count)} {what}, but {found}; {CUT_OFF}")


def read_text(path: Path) -> str:
    """Read a text file, refusing binary content; UTF-16 by its byte order mark."""
    content = read_bytes(path)
    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return content.decode("utf-16", errors="replace")
    if b"\0" in content:
        raise UnreadableError("it holds binary data where text is expected; check the suffix")
    return content.decode("utf-8-sig", errors="replace")


def content_lines(text: str) -> list[str]:
    """The lines of a text without ``#`` comments, surrounding blanks and empty lines."""
    if "#" in text:
        stripped = (line.partition("#")[0].strip() for line in text.splitlines())
    else:
        stripped = (line.strip() for line in text.splitlines())
    return [line for line in stripped if line]


def number_rows(
    lines: Sequence[str], columns: Sequence[int], dtype: type = np.float64, delimiter: str | None = None
) -> np.ndarray:
    """Read the given columns of lines of numbers; a line that does not hold them is quoted in the error."""
    if not lines:
        return np.zeros((0, len(columns)), dtype=dtype)
    try:
        return np.loadtxt(
            lines, dtype=dtype, delimiter=delimiter, usecols=columns, ndmin=2, comments=None, quotechar='"'
        )
    except (ValueError, OverflowError):
        _blame_line(lines, columns, dtype, delimiter)


def _blame_line(lines: Sequence[str], columns: Sequence[int], dtype: type, delimiter: str | None) -> NoReturn:
    kind = "whole numbers" if dtype is np.int64 else "numbers"
    for line in lines:
        cells = line.split(delimiter)
        if len(cells) <= max(columns):
            raise UnreadableError(f"the line {shorten(line)!r} has {len(cells)} values, too few; {CUT_OFF}")
        try:
            [dtype(cells[column].strip('" ')) for column in columns]
        except (ValueError, OverflowError):
            raise UnreadableError(f"the line {shorten(line)!r} should hold {kind}; correct or remove it") from None
    raise UnreadableError(f"its lines do not all hold {kind}")


Polygons = tuple[Int[np.ndarray, " m"], Int[np.ndarray, " c"]]
"""The corners of each polygon, counted, and all corners, one polygon after the other."""


def polygon_rows(lines: list[str], column: int = 0) -> Polygons:
    """Polygons of lines that hold, from ``column`` on, a number of corners and then as many corners."""
    sizes = number_rows(lines, (column,), np.int64)[:, 0]
    if sizes.min() < 0:
        raise UnreadableError("a face has a negative number of corners")
    check_claim(int(sizes.max()), "corners of one face", 2, max(map(len, lines)))
    return sizes, polygon_corners(lines, sizes, column + 1)


def polygon_corners(lines: list[str], sizes: Int[np.ndarray, " m"], column: int) -> Int[np.ndarray, " c"]:
    """The corners of all polygons, of which each line holds as many as ``sizes`` says, from ``column`` on."""
    corners = np.zeros(int(sizes.sum()), dtype=np.int64)
    starts = np.cumsum(sizes) - sizes
    for size in np.unique(sizes[sizes > 0]).tolist():
        (rows,) = np.nonzero(sizes == size)
        some = lines if len(rows) == len(lines) else [lines[i] for i in rows]
        of_size = number_rows(some, range(column, column + size), np.int64)
        corners[starts[rows][:, None] + np.arange(size)] = of_size
    return corners
