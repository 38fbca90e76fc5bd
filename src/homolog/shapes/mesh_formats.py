"""Reading OFF, OBJ and STL.

These are read here and not by a library because a point's index must stay what it is in the file: the
readers at hand split points at texture seams, drop unused ones, or refuse a file for one bad face.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from homolog.shapes.equal_rows import first_of_equal_rows
from homolog.shapes.parsing import (
    CUT_OFF,
    Arrays,
    UnreadableError,
    check_claim,
    content_lines,
    fan_triangles,
    number_rows,
    polygon_corners,
    polygon_rows,
    read_text,
    shorten,
)

# Some files have the counts on the line of the keyword, with or without a blank.
_OFF_HEADER = re.compile(r"(?:ST)?C?N?OFF\b|(?:ST)?C?N?OFF(?=\d)")
_STL_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def read_off(path: Path) -> Arrays:
    """Read an OFF file; colours, normals and texture coordinates are passed over."""
    text = read_text(path)
    lines = content_lines(text)
    header = _OFF_HEADER.match(lines[0]) if lines else None
    if header is None:
        raise UnreadableError("it does not start with OFF")
    lines[0] = lines[0][header.end() :].strip()
    lines = lines if lines[0] else lines[1:]
    n_points, n_faces = number_rows(lines[:1], (0, 1), np.int64)[0].tolist() if lines else (0, 0)
    check_claim(n_points, "points", 6, len(text))
    check_claim(n_faces, "faces", 2, len(text))
    if len(lines) < 1 + n_points + n_faces:
        raise UnreadableError(f"{n_points} points and {n_faces} faces are announced, but lines are missing; {CUT_OFF}")
    points = number_rows(lines[1 : 1 + n_points], (0, 1, 2))
    faces = lines[1 + n_points : 1 + n_points + n_faces]
    return Arrays(points, polygon_rows(faces) if faces else None)


def read_obj(path: Path) -> Arrays:
    """Read points and faces of an OBJ file, in file order; no other file is opened."""
    lines = content_lines(read_text(path).replace("\\\r\n", " ").replace("\\\n", " "))
    keys = [line.split(None, 1)[0] for line in lines]
    points = number_rows([line for line, key in zip(lines, keys, strict=True) if key == "v"], (1, 2, 3))
    if not len(points):
        raise UnreadableError("it holds no points (lines that start with 'v')")
    polygons = [line for line, key in zip(lines, keys, strict=True) if key == "f"]
    return Arrays(points, _obj_faces(polygons, keys) if polygons else None)


def _obj_faces(polygons: list[str], keys: list[str]) -> Int[np.ndarray, "m 3"]:
    # A corner is point/texture/normal; only the point matters.
    lines = re.sub(r"/\S*", "", "\n".join(polygons)).split("\n")
    sizes = np.array([len(line.split()) - 1 for line in lines])
    if sizes.min() < 3:
        short = shorten(polygons[int(sizes.argmin())])
        raise UnreadableError(f"the face {short!r} has fewer than three corners; {CUT_OFF}")
    index = polygon_corners(lines, sizes, 1)
    return fan_triangles(sizes, _obj_index(index, sizes, keys))


def _obj_index(index: Int[np.ndarray, " c"], sizes: Int[np.ndarray, " m"], keys: list[str]) -> Int[np.ndarray, " c"]:
    """Turn OBJ's counting, from 1 or backward from the face's own line, into indices; -1 if there is none."""
    from_start = np.where(index > 0, index - 1, -1)
    if index.min() >= 0:
        return from_start
    key = np.array(keys)
    points_before = np.repeat(np.cumsum(key == "v")[key == "f"], sizes)
    return np.where(index < 0, np.maximum(points_before + index, -1), from_start)


def read_stl(path: Path) -> Arrays:
    """Read an STL file and weld its separate triangles: points that are exactly equal become one.

    The points are numbered as they first appear in the file.
    """
    content = path.read_bytes()
    n_facets = int.from_bytes(content[80:84], "little") if len(content) >= 84 else -1
    if len(content) == 84 + n_facets * _STL_FACET.itemsize:
        corners = np.frombuffer(content, _STL_FACET, offset=84)["corners"].reshape(-1, 3).astype(np.float64)
    elif content.lstrip()[:5].lower() == b"solid":
        corners = _stl_text_corners(read_text(path))
    else:
        raise UnreadableError(f"its {len(content)} bytes do not fit the {n_facets} triangles announced; {CUT_OFF}")
    return weld(corners)


def _stl_text_corners(text: str) -> Float[np.ndarray, "c 3"]:
    lines = content_lines(text.lower())
    corners = number_rows([line for line in lines if line.startswith("vertex")], (1, 2, 3))
    n_facets = sum(line.startswith("facet") for line in lines)
    if not lines[-1].startswith("endsolid") or len(corners) != 3 * n_facets:
        raise UnreadableError(f"its last triangle or its end is missing; {CUT_OFF}")
    return corners


def weld(corners: Float[np.ndarray, "c 3"]) -> Arrays:
    """Make a mesh of separate triangles, one point per position, numbered by first appearance."""
    first = first_of_equal_rows(corners)
    kept = np.flatnonzero(first == np.arange(len(corners)))
    number = np.zeros(len(corners), dtype=np.int64)
    number[kept] = np.arange(len(kept))
    return Arrays(corners[kept], number[first].reshape(-1, 3))
