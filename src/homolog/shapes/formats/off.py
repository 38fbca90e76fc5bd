"""OFF, with Geomview's variants: colours, normals, texture coordinates and a fourth coordinate."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from itertools import chain, islice
from pathlib import Path

import numpy as np

from homolog.core.files import read_bytes
from homolog.core.messages import shorten
from homolog.shapes.formats.parsing import (
    CUT_OFF,
    Arrays,
    UnreadableError,
    check_claim,
    polygon_faces,
    refuse_further_lines,
)
from homolog.shapes.formats.text_lines import n_lines, number_rows, polygon_rows, text_lines
from homolog.shapes.formats.text_rows import write_rows
from homolog.shapes.shape import Shape

# No number of corners has more digits.
_DIGITS = 12
# More lines than a header has, and the bytes in which its keyword is looked for.
_HEAD, _HEAD_BYTES = 8, 2**16
# Some files have the counts on the line of the keyword, with or without a blank.
_HEADER = re.compile(r"(?P<extra>(?:ST)?C?N?)(?P<four>4)?(?P<many>n)?(?:OFF|off)(?:\b|(?=\d))")
_BINARY = re.compile(rb"\s*(?:#[^\n]*\n\s*)*\w*OFF\s+BINARY", re.IGNORECASE)


def read(path: Path) -> Arrays:
    """Read an OFF file; colours, normals and texture coordinates are passed over.

    The keyword may be missing, the counts may stand on one line or on several, and the number of edges may be missing.
    Line breaks mean nothing where points have no further numbers. Points of 4OFF are divided by their fourth
    coordinate, and those of nOFF must have three.
    """
    if _BINARY.match(read_bytes(path, first=_HEAD_BYTES)):
        raise UnreadableError("it is a binary OFF; export it as text, or as PLY")
    head = list(islice(text_lines(path), _HEAD))
    four, plain = _take_keyword(head)
    n_points, n_faces = _take_counts(head)
    size, width = path.stat().st_size, 4 if four else 3
    check_claim(n_points, "points", 6, size)
    check_claim(n_faces, "faces", 2, size)
    n_over = n_lines(_behind(path, head)) - n_points - n_faces
    free = bool(plain and n_over and _fits(path, head, n_points, n_faces, width))
    if n_over < 0 and not free:
        raise UnreadableError(
            f"its header announces {n_points} points and {n_faces} faces, but its lines do not hold these; {CUT_OFF}"
        )
    refuse_further_lines(0 if free else n_over, f"{n_points} points, {n_faces} faces")
    lines = _behind(path, head)
    lines = _rows(_words(lines), n_points, n_faces, width) if free else lines
    points = number_rows(islice(lines, n_points), range(width))
    if four:
        with np.errstate(all="ignore"):
            points = points[:, :3] / points[:, 3:]
    return Arrays(points, polygon_faces(points, *polygon_rows(islice(lines, n_faces))) if n_faces else None)


def _behind(path: Path, head: list[str]) -> Iterator[str]:
    """The lines of a file without its header, which has been taken off its first lines."""
    return chain(head, islice(text_lines(path), _HEAD, None))


def _take_keyword(lines: list[str]) -> tuple[bool, bool]:
    """Take the keyword off the lines; says whether points have four coordinates, and nothing beside them."""
    header = _HEADER.match(lines[0]) if lines else None
    if header is None:
        if not lines or re.fullmatch(r"\d+\s+\d+\s+\d+", lines[0]) is None:
            found = f"{shorten(lines[0], 20)!r}" if lines else "nothing"
            raise UnreadableError(f"it does not start with OFF, COFF, NOFF, STOFF or 4OFF, but with {found}")
        return False, True
    lines[0] = lines[0][header.end() :].strip()
    if not lines[0]:
        del lines[0]
    if header["many"]:
        _take_dimension(lines)
    return header["four"] is not None, not header["extra"]


def _take_dimension(lines: list[str]) -> None:
    """Take the number of coordinates off the lines, which stands before the counts of nOFF; it must be three."""
    found, _, rest = lines.pop(0).partition(" ") if lines else ("nothing", "", "")
    if found != "3":
        raise UnreadableError(f"its points have {shorten(found, 10)} coordinates, but three are needed")
    if rest:
        lines.insert(0, rest)


def _words(lines: Iterable[str]) -> Iterator[str]:
    return (word[0] for line in lines for word in re.finditer(r"\S+", line))


def _rows(words: Iterator[str], n_points: int, n_faces: int, width: int) -> Iterator[str]:
    """A line a point and a line a face, of numbers whose line breaks mean nothing; ends where they do not fit.

    Colours of faces cannot be told from the next face, so that there must be none.
    """
    for _ in range(n_points):
        yield " ".join(islice(words, width))
    for size in islice(words, n_faces):
        if not size.isdecimal() or len(size) > _DIGITS:
            return
        corners = list(islice(words, int(size)))
        if len(corners) < int(size):
            return
        yield " ".join([size, *corners])


def _fits(path: Path, head: list[str], n_points: int, n_faces: int, width: int) -> bool:
    """Whether numbers whose line breaks mean nothing are as many as are announced."""
    words = _words(_behind(path, head))
    n_rows = n_lines(_rows(words, n_points, n_faces, width))
    return n_rows == n_points + n_faces and next(words, None) is None


def _take_counts(lines: list[str]) -> tuple[int, int]:
    """Take the numbers of points and faces off the lines, on one line or on several."""
    words = list[str]()
    # A line of one number is no point, so that it belongs to the counts.
    while lines and len(words) < 3 and (len(words) < 2 or len(lines[0].split()) == 1):
        words += lines.pop(0).split()
    n_points, n_faces = number_rows([" ".join(words)], (0, 1), np.int64)[0].tolist() if words else (0, 0)
    return n_points, n_faces


def write(path: Path, shape: Shape) -> None:
    """Write an OFF file whose numbers read back bit by bit."""
    faces = np.zeros((0, 3), np.int64) if shape.faces is None else shape.faces
    head = f"OFF\n{shape.n_points} {shape.n_faces} 0\n"
    write_rows(path, [("%r %r %r\n", shape.points), ("3 %d %d %d\n", faces)], head)
