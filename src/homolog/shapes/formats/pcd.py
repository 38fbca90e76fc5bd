"""PCD, the format of the Point Cloud Library: text, binary or compressed."""

from __future__ import annotations

import re
from io import BytesIO
from pathlib import Path
from typing import Any, cast

import numpy as np

from homolog.core.files import read_bytes
from homolog.shapes.formats.parsing import CUT_OFF, Arrays, UnreadableError, check_claim, left_out
from homolog.shapes.formats.text_lines import mark_length
from homolog.shapes.shape import Shape

# LZF writes at least three bytes for 264.
_MOST_LZF = 100
_LONGEST_HEAD = 100_000
# A number of more digits is larger than any file.
_DIGITS = 20


def read(path: Path) -> Arrays:
    """Read the fields x, y and z of a PCD file: text, binary or compressed."""
    from pypcd4.pypcd4 import PointCloud

    content = read_bytes(path)
    content = content[mark_length(content[:4]) :]
    n_points, over = _check_pcd(content)
    cloud = PointCloud.from_fileobj(cast(Any, BytesIO(content)))
    if missing := {"x", "y", "z"}.difference(cloud.fields):
        raise UnreadableError(f"it has no field {', '.join(sorted(missing))}")
    points = np.empty((cloud.pc_data.size, 3))
    for column, axis in enumerate("xyz"):
        points[:, column] = cloud.pc_data[axis]
    if len(points) != n_points:
        raise UnreadableError(f"{n_points} points are announced, but {len(points)} found; {CUT_OFF}")
    notes = (left_out("bytes after the last point", over, "the header announces no more"),) if over > 0 else ()
    return Arrays(points, notes=notes)


def _check_pcd(content: bytes) -> tuple[int, int]:
    """The number of points announced, once the file can hold them, and the bytes of a binary one that follow them."""
    head = re.match(rb".*?^DATA[ \t]+(\w+)[^\n]*\n", content[:_LONGEST_HEAD], re.DOTALL | re.MULTILINE)
    words = [line.split() for line in head[0].splitlines()] if head else []
    entries = {name: values for name, *values in filter(None, words) if all(map(bytes.isdigit, values)) and values}
    if head is None or not {b"SIZE", b"POINTS"} <= entries.keys():
        raise UnreadableError("it has no header from FIELDS and SIZE to POINTS and DATA")
    n_points, size = _number(entries[b"POINTS"][0]), len(content) - head.end()
    sizes = [_number(size) for size in entries[b"SIZE"]]
    counts = [_number(count) for count in entries.get(b"COUNT", [])] or [1] * len(sizes)
    bytes_per_point = sum(size * count for size, count in zip(sizes, counts, strict=True))
    check_claim(sum(counts), "values of a point", 1, size)
    over = 0
    if head[1] == b"binary":
        check_claim(n_points, "points", bytes_per_point, size)
        over = len(content[head.end() + n_points * bytes_per_point :].rstrip(b"\r\n"))
    elif head[1] == b"ascii":
        check_claim(n_points * sum(counts), "values", 2, size + 1)
    else:
        check_claim(n_points * bytes_per_point, "bytes", 1, _MOST_LZF * size)
        check_claim(int.from_bytes(content[head.end() + 4 : head.end() + 8], "little"), "bytes", 1, _MOST_LZF * size)
    return n_points, over


def _number(digits: bytes) -> int:
    """A count, or one that is too large in any case."""
    return int(digits[:_DIGITS])


def write(path: Path, shape: Shape) -> None:
    """Write the points as fields x, y and z in double precision."""
    from pypcd4.pypcd4 import PointCloud

    PointCloud.from_points(shape.points, ("x", "y", "z"), (np.float64,) * 3).save(path)
