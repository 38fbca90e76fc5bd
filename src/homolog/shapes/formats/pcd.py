"""PCD, the format of the Point Cloud Library: text, binary or compressed."""

from __future__ import annotations

import re
from io import BytesIO
from pathlib import Path
from typing import Any, cast

import numpy as np

from homolog.shapes.formats.parsing import CUT_OFF, Arrays, UnreadableError, check_claim
from homolog.shapes.shape import Shape

# LZF writes at least three bytes for 264.
_MOST_LZF = 100


def read(path: Path) -> Arrays:
    """Read the fields x, y and z of a PCD file: text, binary or compressed."""
    from pypcd4.pypcd4 import PointCloud

    content = path.read_bytes()
    n_points = _check_pcd(content)
    cloud = PointCloud.from_fileobj(cast(Any, BytesIO(content)))
    if missing := {"x", "y", "z"}.difference(cloud.fields):
        raise UnreadableError(f"it has no field {', '.join(sorted(missing))}")
    points = np.stack([np.atleast_1d(cloud.pc_data[axis]).astype(np.float64) for axis in "xyz"], axis=1)
    if len(points) != n_points:
        raise UnreadableError(f"{n_points} points are announced, but {len(points)} found; {CUT_OFF}")
    return Arrays(points)


def _check_pcd(content: bytes) -> int:
    """The number of points announced, once the file can hold them."""
    head = re.match(rb".*?^DATA[ \t]+(\w+)[^\n]*\n", content[:100_000], re.DOTALL | re.MULTILINE)
    entries = dict(re.findall(rb"^([A-Z]+)[ \t]+([\d \t]+?)\s*$", head[0], re.MULTILINE)) if head else {}
    if head is None or not {b"SIZE", b"POINTS"} <= entries.keys():
        raise UnreadableError("it has no header from FIELDS and SIZE to POINTS and DATA")
    n_points, body = int(entries[b"POINTS"]), content[head.end() :]
    sizes = [int(size) for size in entries[b"SIZE"].split()]
    counts = [int(count) for count in entries.get(b"COUNT", b"").split()] or [1] * len(sizes)
    bytes_per_point = sum(size * count for size, count in zip(sizes, counts, strict=True))
    if head[1] == b"binary":
        check_claim(n_points, "points", bytes_per_point, len(body))
    elif head[1] == b"ascii":
        check_claim(n_points * sum(counts), "values", 2, len(body) + 1)
    else:
        check_claim(n_points * bytes_per_point, "bytes", 1, _MOST_LZF * len(body))
        check_claim(int.from_bytes(body[4:8], "little"), "bytes", 1, _MOST_LZF * len(body))
    return n_points


def write(path: Path, shape: Shape) -> None:
    """Write the points as fields x, y and z in double precision."""
    from pypcd4.pypcd4 import PointCloud

    PointCloud.from_points(shape.points, ("x", "y", "z"), (np.float64,) * 3).save(path)
