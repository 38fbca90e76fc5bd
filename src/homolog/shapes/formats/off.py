"""OFF, with Geomview's variants: colours, normals, texture coordinates and a fourth coordinate."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from homolog.core.files import read_bytes
from homolog.core.messages import shorten
from homolog.shapes.formats.parsing import (
    CUT_OFF,
    Arrays,
    UnreadableError,
    check_claim,
    content_lines,
    number_rows,
    polygon_faces,
    polygon_rows,
    read_text,
    refuse_further_lines,
)
from homolog.shapes.formats.text_rows import write_rows
from homolog.shapes.shape import Shape

# Some files have the counts on the line of the keyword, with or without a blank.
_HEADER = re.compile(r"(?P<extra>(?:ST)?C?N?)(?P<four>4)?(?P<many>n)?(?:OFF|off)(?:\b|(?=\d))")
_BINARY = re.compile(rb"\s*(?:#[^\n]*\n\s*)*\w*OFF\s+BINARY", re.IGNORECASE)


def read(path: Path) -> Arrays:
    """Read an OFF file; colours, normals and texture coordinates are passed over.

    The keyword may be missing, the counts may stand on one line or on several, and the number of edges may be missing.
    Line breaks mean nothing where points have no further numbers. Points of 4OFF are divided by their fourth
    coordinate, and those of nOFF must have three.
    """
    if _BINARY.match(read_bytes(path)):
        raise UnreadableError("it is a binary OFF; export it as text, or as PLY")
    text = read_text(path)
    lines = content_lines(text)
    four, plain = _take_keyword(lines)
    n_points, n_faces = _take_counts(lines)
    check_claim(n_points, "points", 6, len(text))
    check_claim(n_faces, "faces", 2, len(text))
    if plain and len(lines) != n_points + n_faces:
        lines = _rows(lines, n_points, n_faces, 4 if four else 3)
    if len(lines) < n_points + n_faces:
        raise UnreadableError(
            f"its header announces {n_points} points and {n_faces} faces, but its lines do not hold these; {CUT_OFF}"
        )
    refuse_further_lines(len(lines) - n_points - n_faces, f"{n_points} points, {n_faces} faces")
    points = number_rows(lines[:n_points], range(4) if four else range(3))
    if four:
        with np.errstate(all="ignore"):
            points = points[:, :3] / points[:, 3:]
    faces = lines[n_points:]
    return Arrays(points, polygon_faces(points, *polygon_rows(faces)) if faces else None)


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


def _rows(lines: list[str], n_points: int, n_faces: int, width: int) -> list[str]:
    """A line a point and a line a face, of numbers whose line breaks mean nothing; the same lines if they do not fit.

    Colours of faces cannot be told from the next face, so that there must be none.
    """
    words = " ".join(lines).split()
    rows = [" ".join(words[first : first + width]) for first in range(0, width * n_points, width)]
    place = width * n_points
    for _ in range(n_faces):
        if place >= len(words) or not words[place].isdecimal():
            return lines
        end = place + 1 + min(int(words[place]), len(words))
        rows.append(" ".join(words[place:end]))
        place = end
    return rows if place == len(words) else lines


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
