"""OBJ: points and faces, and the lines that textures are read from."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from homolog.core.files import read_bytes
from homolog.core.messages import shorten
from homolog.shapes.finding import Finding
from homolog.shapes.formats.parsing import (
    CUT_OFF,
    Arrays,
    UnreadableError,
    left_out,
    lines_left_out,
    polygon_faces,
    space_of,
)
from homolog.shapes.formats.text_lines import GrowingArray, Polygons, batches, number_rows, polygon_corners, text_blocks
from homolog.shapes.formats.text_rows import write_rows
from homolog.shapes.shape import Shape

# Statements of curves and surfaces that are no polygons, those of older versions included.
_FREE_FORMS = ("curv", "curv2", "surf", "bzp", "bsp", "cdc", "cdp", "res")
# Statements whose words are names, in which a # is no comment.
_NAMES = ("usemtl", "mtllib", "newmtl", "map_", "g", "o")
# The end of a line that goes on, which no comment does; some programs write blanks behind the backslash.
_GOES_ON = re.compile(r"^(?![ \t]*#)(.*)\\[ \t]*\n", re.MULTILINE)


class ObjMesh(NamedTuple):
    """The points and polygons of an OBJ file.

    Args:
        points: in file order.
        sizes: corners of each polygon.
        corners: indices of points from 0, one polygon after the other; -1 where a number leads nowhere.
    """

    points: Float[np.ndarray, "n 3"]
    sizes: Int[np.ndarray, " m"]
    corners: Int[np.ndarray, " c"]


def read(path: Path) -> Arrays:
    """Read points and faces of an OBJ file, in file order; no other file is opened."""
    keys = Counter[str]()
    mesh = parse_obj(_counted(obj_statements(path), keys))
    faces = polygon_faces(*mesh) if len(mesh.sizes) else None
    return Arrays(mesh.points, faces, _notes(keys), space_of(read_bytes(path, first=1000)))


def _counted(statements: Iterable[tuple[str, str]], keys: Counter[str]) -> Iterator[tuple[str, str]]:
    for statement in statements:
        keys[statement[0]] += 1
        yield statement


def _notes(keys: Counter[str]) -> tuple[Finding, ...]:
    n_free = sum(keys[key] for key in _FREE_FORMS)
    free = left_out("free-form curves and surfaces", n_free, "export them as polygons if they are part of the shape")
    return (*lines_left_out(keys["l"]), *((free,) if n_free else ()))


def obj_statements(path: Path) -> Iterator[tuple[str, str]]:
    """The statements of an OBJ or MTL file: keywords in lower case, and what follows them.

    Lines that end with a backslash, and perhaps blanks, go on; comments do not, and are left out. A ``#`` within names
    is part of them. ``fo``, as older programs write it, is ``f``.
    """
    for block in text_blocks(path):
        for line in (_GOES_ON.sub(r"\1 ", block) if "\\" in block else block).splitlines():
            words = line.split(None, 1)
            if not words or words[0].startswith("#"):
                continue
            key = "f" if words[0].lower() == "fo" else words[0].lower()
            rest = words[1] if len(words) > 1 else ""
            yield key, rest.strip() if key.startswith(_NAMES) else rest.partition("#")[0].strip()


def parse_obj(statements: Iterable[tuple[str, str]]) -> ObjMesh:
    """The points and polygons among the statements of an OBJ file."""
    points, sizes, corners = GrowingArray(np.float64), GrowingArray(np.int64), GrowingArray(np.int64)
    for batch in batches(statements):
        n_before = len(points) // 3
        points.append(number_rows((f"v {rest}" for key, rest in batch if key == "v"), (1, 2, 3)))
        if polygons := [rest for key, rest in batch if key == "f"]:
            of_each, numbers = _polygons(polygons)
            sizes.append(of_each)
            corners.append(_indices(numbers, of_each, [key for key, _ in batch], n_before))
    if not len(points):
        raise UnreadableError("it holds no points (lines that start with 'v')")
    return ObjMesh(points.rows(3), sizes.rows(1)[:, 0], corners.rows(1)[:, 0])


def _polygons(polygons: list[str]) -> Polygons:
    """The polygons of what stands behind ``f``, in OBJ's counting."""
    # A corner is point/texture/normal; only the point matters.
    lines = re.sub(r"/\S*", "", "\n".join(polygons)).split("\n")
    sizes = np.array([len(line.split()) for line in lines])
    if sizes.min() < 3:
        short = shorten("f " + polygons[int(sizes.argmin())])
        raise UnreadableError(f"the face {short!r} has fewer than three corners; {CUT_OFF}")
    numbers = polygon_corners(lines, sizes, 0)
    if not numbers.all():
        face = int(np.searchsorted(np.cumsum(sizes), np.argmin(np.abs(numbers)), side="right"))
        raise UnreadableError(
            f"the face {shorten('f ' + polygons[face])!r} names point 0, but OBJ counts points from 1; "
            "if all its faces count from 0, add 1 to their indices"
        )
    return sizes, numbers


def _indices(
    numbers: Int[np.ndarray, " c"], sizes: Int[np.ndarray, " m"], keys: list[str], n_before: int
) -> Int[np.ndarray, " c"]:
    """Turn OBJ's counting, from 1 or backward from the face's own line, into indices; -1 if there is none.

    Args:
        numbers: of the corners.
        sizes: corners of each polygon.
        keys: of the statements that the polygons are among.
        n_before: points before these statements.
    """
    from_start = np.where(numbers > 0, numbers - 1, -1)
    if numbers.min() >= 0:
        return from_start
    key = np.array(keys)
    points_before = n_before + np.repeat(np.cumsum(key == "v")[key == "f"], sizes)
    return np.where(numbers < 0, np.maximum(points_before + numbers, -1), from_start)


def write(path: Path, shape: Shape) -> None:
    """Write an OBJ file whose numbers read back bit by bit."""
    faces = np.zeros((0, 3), np.int64) if shape.faces is None else shape.faces
    write_rows(path, [("v %r %r %r\n", shape.points), ("f %d %d %d\n", faces + 1)])
