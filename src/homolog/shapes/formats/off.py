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
)
from homolog.shapes.formats.text_rows import write_rows
from homolog.shapes.shape import Shape

# Some files have the counts on the line of the keyword, with or without a blank.
_HEADER = re.compile(r"(?:ST)?C?N?(?P<four>4)?OFF(?:\b|(?=\d))")


def read(path: Path) -> Arrays:
    """Read an OFF file; colours, normals and texture coordinates are passed over.

    The keyword may be missing, the counts may stand on one line or on three, and the number of edges may be missing.
    Points of 4OFF are divided by their fourth coordinate.
    """
    if read_bytes(path).startswith(b"OFF BINARY"):
        raise UnreadableError("it is a binary OFF; export it as text, or as PLY")
    text = read_text(path)
    lines = content_lines(text)
    four = _take_keyword(lines)
    n_points, n_faces = _take_counts(lines)
    check_claim(n_points, "points", 6, len(text))
    check_claim(n_faces, "faces", 2, len(text))
    if len(lines) < n_points + n_faces:
        raise UnreadableError(f"{n_points} points and {n_faces} faces are announced, but lines are missing; {CUT_OFF}")
    points = number_rows(lines[:n_points], range(4) if four else range(3))
    if four:
        with np.errstate(all="ignore"):
            points = points[:, :3] / points[:, 3:]
    faces = lines[n_points : n_points + n_faces]
    return Arrays(points, polygon_faces(points, *polygon_rows(faces)) if faces else None)


def _take_keyword(lines: list[str]) -> bool:
    """Take the keyword off the lines; says whether points have four coordinates."""
    header = _HEADER.match(lines[0]) if lines else None
    if header is None:
        if not lines or re.fullmatch(r"\d+\s+\d+\s+\d+", lines[0]) is None:
            found = f"{shorten(lines[0], 20)!r}" if lines else "nothing"
            raise UnreadableError(f"it does not start with OFF, COFF, NOFF, STOFF or 4OFF, but with {found}")
        return False
    lines[0] = lines[0][header.end() :].strip()
    if not lines[0]:
        del lines[0]
    return header["four"] is not None


def _take_counts(lines: list[str]) -> tuple[int, int]:
    """Take the numbers of points and faces off the lines, be they on one line or each on its own."""
    n_lines = 3 if lines and len(lines[0].split()) == 1 else 1
    words = " ".join(lines[:n_lines])
    del lines[:n_lines]
    n_points, n_faces = number_rows([words], (0, 1), np.int64)[0].tolist() if words else (0, 0)
    return n_points, n_faces


def write(path: Path, shape: Shape) -> None:
    """Write an OFF file whose numbers read back bit by bit."""
    faces = np.zeros((0, 3), np.int64) if shape.faces is None else shape.faces
    head = f"OFF\n{shape.n_points} {shape.n_faces} 0\n"
    write_rows(path, [("%r %r %r\n", shape.points), ("3 %d %d %d\n", faces)], head)
