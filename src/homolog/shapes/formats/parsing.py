"""What the readers of all formats share: the arrays they give, how they fail, and the triangles of polygons."""

from __future__ import annotations

import re
from typing import Literal, NamedTuple, cast

import numpy as np
from jaxtyping import Float, Int

from homolog.core.messages import shown
from homolog.shapes.finding import Finding
from homolog.shapes.polygons import triangulate

Space = Literal["RAS", "LPS"]
"""Anatomical axes: x to the right, y to the front and z up, or x to the left, y to the back and z up."""

# Polygons whose triangles are found at a time.
_POLYGONS = 2**14
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
    if (sizes == 3).all():
        return corners.reshape(-1, 3)
    n_triangles, n_corners = (np.append(0, np.cumsum(counts)) for counts in (np.maximum(sizes - 2, 0), sizes))
    faces = np.empty((int(n_triangles[-1]), 3), dtype=np.int64)
    for first in range(0, len(sizes), _POLYGONS):
        last = min(first + _POLYGONS, len(sizes))
        some = corners[n_corners[first] : n_corners[last]]
        faces[n_triangles[first] : n_triangles[last]] = some[triangulate(points, sizes[first:last], some)]
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
