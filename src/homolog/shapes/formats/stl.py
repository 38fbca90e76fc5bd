"""STL, text and binary: separate triangles, whose equal corners become one point."""

from __future__ import annotations

import re
from itertools import compress
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from homolog.core.files import opened, read_bytes
from homolog.shapes.equal_rows import first_of_equal_rows
from homolog.shapes.finding import Finding
from homolog.shapes.formats.parsing import CUT_OFF, Arrays, UnreadableError, left_out, space_of
from homolog.shapes.formats.text_lines import GrowingArray, batches, encoding_of, number_rows, text_lines
from homolog.shapes.shape import Shape
from homolog.shapes.topology import face_vectors

_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
# The title and the number of triangles.
_HEAD = 84
# Bytes read to tell what a file is, and at a time.
_LONGEST_HEAD, _BLOCK = 2**16, 2**20
# What programs write that do not know the number of triangles when they begin.
_UNKNOWN_COUNTS = (0, 2**32 - 1)


def read(path: Path) -> Arrays:
    """Read an STL file and weld its separate triangles: points that are exactly equal become one.

    The points are numbered as they first appear in the file.
    """
    head, size = read_bytes(path, first=_LONGEST_HEAD), path.stat().st_size
    announced = int.from_bytes(head[80:_HEAD], "little") if size >= _HEAD else -1
    exact = size == _HEAD + announced * _FACET.itemsize
    encoding = encoding_of(head)
    titled = head.decode(encoding, errors="replace").lstrip()[:5].lower() == "solid"
    if not exact and titled and (encoding != "utf-8-sig" or _is_text(path)):
        corners, notes = _text_corners(path), tuple[Finding, ...]()
    else:
        corners, notes = _binary_corners(read_bytes(path), announced)
    points, faces = _weld(corners)
    return Arrays(points, faces, notes, space_of(head[:1000]))


def _is_text(path: Path) -> bool:
    """Whether zeros, if there are any, are but at the end of a file."""
    ended = False
    with opened(path) as file:
        while block := file.read(_BLOCK):
            text = block.rstrip(b"\0")
            if (ended and text) or b"\0" in text:
                return False
            ended = len(text) < len(block)
    return True


def _binary_corners(content: bytes, announced: int) -> tuple[Float[np.ndarray, "c 3"], tuple[Finding, ...]]:
    held, over = divmod(max(len(content) - _HEAD, 0), _FACET.itemsize)
    count = held if announced in _UNKNOWN_COUNTS else announced
    if not 0 < count == held:
        too_many = len(content) - _HEAD - count * _FACET.itemsize
        found = f"has {too_many} bytes too many for" if 0 < count < held else f"of {len(content)} bytes cannot hold"
        raise UnreadableError(f"the file {found} the {announced} triangles that its header announces; {CUT_OFF}")
    corners = np.frombuffer(content, _FACET, count, offset=_HEAD)["corners"].reshape(-1, 3).astype(np.float64)
    notes = [left_out("bytes after the last triangle", over, "all triangles that the header announces are read")]
    return corners, tuple(notes if over else ())


def _text_corners(path: Path) -> Float[np.ndarray, "c 3"]:
    """The corners of all facets; each must be complete and have three, but the line ``endsolid`` may be missing."""
    corners, begun, ended = GrowingArray(np.float64), 0, 0
    for batch in batches(text_lines(path, padded=True)):
        lines = [re.sub(r"^end\s+", "end", line.lower()) for line in batch]
        are_vertices = [line.startswith("vertex") for line in lines]
        vertices_before = len(corners) // 3 + np.cumsum(are_vertices)[[line.startswith("endfacet") for line in lines]]
        _check_facets(vertices_before, ended)
        corners.append(number_rows(compress(lines, are_vertices), (1, 2, 3)))
        begun += sum(line.startswith("facet") for line in lines)
        ended += len(vertices_before)
    if not len(corners) == 9 * begun == 9 * ended or not begun:
        raise UnreadableError(f"its last triangle is missing, or not complete; {CUT_OFF}")
    return corners.rows(3)


def _check_facets(vertices_before: Int[np.ndarray, " m"], n_before: int) -> None:
    """Refuse facets that are no triangles.

    Args:
        vertices_before: the vertices from the beginning of the file to the end of each of some facets.
        n_before: the facets before these, all triangles.
    """
    surplus = vertices_before - 3 * np.arange(n_before + 1, n_before + 1 + len(vertices_before))
    if surplus.any():
        which = int(np.flatnonzero(surplus)[0])
        raise UnreadableError(
            f"its facet {n_before + which + 1} has {3 + surplus[which]} vertices, but a facet of STL must have three; "
            "export it as triangles, or as OBJ or PLY"
        )


def _weld(corners: Float[np.ndarray, "c 3"]) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, "m 3"]]:
    """Make a mesh of separate triangles, one point per position, numbered by first appearance."""
    first = first_of_equal_rows(corners)
    kept = np.flatnonzero(first == np.arange(len(corners)))
    number = np.zeros(len(corners), dtype=np.int64)
    number[kept] = np.arange(len(kept))
    return corners[kept], number[first].reshape(-1, 3)


def write(path: Path, shape: Shape) -> None:
    """Write a mesh as binary STL, in single precision."""
    assert shape.faces is not None
    facets = np.zeros(shape.n_faces, _FACET)
    facets["corners"] = shape.points[shape.faces]
    normals = face_vectors(shape.points[shape.faces])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    facets["normal"] = np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0)
    path.write_bytes(b"homolog".ljust(80) + np.uint32(shape.n_faces).tobytes() + facets.tobytes())
