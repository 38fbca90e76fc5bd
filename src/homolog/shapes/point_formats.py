"""Reading text tables of points, NumPy arrays and PCD."""

from __future__ import annotations

import math
import re
import zipfile
from io import BytesIO
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np

from homolog.core.errors import needs_extra
from homolog.shapes.parsing import (
    CUT_OFF,
    Arrays,
    UnreadableError,
    check_claim,
    content_lines,
    number_rows,
    read_text,
    shorten,
)

_POINT_KEYS = ("points", "vertices")
# Coordinates hardly compress; an archive that grows more than this is made to fill the memory.
_MOST_COMPRESSION = 200
_ALWAYS_ALLOWED = 64 * 2**20
# LZF writes at least three bytes for 264.
_MOST_LZF = 100
# Other names of coordinates than x, y and z, in lower case: pos_x, x_coord, x [mm], x_mm, and ParaView's Points:0.
_AXIS = re.compile(
    r"points[:_](?P<number>[012])|(?:(?:pos|position|points?|coord|coordinate)[ _.:-]?)?(?P<axis>[xyz])"
    r"(?:[ _.:-]?(?:pos|position|coord|coordinate))?(?:_(?:mm|cm|m)|[ _]*[\[(][^])]*[])])?"
)


def read_table(path: Path) -> Arrays:
    """Read a text file with one point a line, separated by commas, semicolons, tabs or blanks.

    ``#`` starts a comment. A first row of words, or a comment before the first row, names the columns: those of x, y
    and z are taken, in whatever case, with a unit in brackets, or as in ``pos_x``. Without names, or where there are
    only three columns, the first three are.

    Raises:
        UnreadableError: if more than three columns have names, and x, y and z are not among them.
    """
    table = read_table_lines(path)
    if not table.lines:
        return Arrays(np.zeros((0, 3)))
    return Arrays(number_rows(table.lines, table.columns, delimiter=table.delimiter))


class TableLines(NamedTuple):
    """The rows of a table of points, without comments and names, and where in a row the coordinates are.

    ``axes`` are the names of these: "xyz", or of the others that were asked for those that the table has.
    """

    lines: list[str]
    columns: list[int]
    delimiter: str | None
    axes: str = "xyz"


def read_table_lines(path: Path, *, other_axes: tuple[str, ...] = ()) -> TableLines:
    """Read a table of points as ``read_table`` does, up to its numbers.

    Args:
        path: the file.
        other_axes: other names that the columns may have in its first row, such as "ras", a letter each.
    """
    text = read_text(path)
    lines = content_lines(text)
    if not lines:
        raise UnreadableError("it holds no points")
    names = [] if _is_numbers(lines[0]) else _names(lines.pop(0))
    if not lines:
        return TableLines([], [0, 1, 2], None)
    for axes in other_axes:
        if all(names.count(axis) == 1 for axis in axes):
            return TableLines(lines, [names.index(axis) for axis in axes], _delimiter(lines[0]), axes)
    columns = _xyz_columns(names or _commented_names(text, lines[0]))
    return TableLines(lines, columns, _delimiter(lines[0]))


def _delimiter(line: str) -> str | None:
    """What separates the cells of a line; None for blanks."""
    return next((mark for mark in ";,\t" if mark in line), None)


def _cells(line: str) -> list[str]:
    return [cell.strip(" \"'") for cell in line.split(_delimiter(line))]


def _is_numbers(line: str) -> bool:
    """Whether a row holds a number at all; a row of words is a header."""
    for cell in _cells(line):
        try:
            float(cell)
        except ValueError:
            continue
        return True
    return False


def _names(header: str) -> list[str]:
    """The names of columns, in lower case; a unit in brackets stays with its name, and CloudCompare's // goes."""
    return [name.lower() for name in _cells(re.sub(r"\s+(?=[\[(])", "", header.lstrip("/ ")))]


def _commented_names(text: str, first_row: str) -> list[str]:
    """The names in the comment before the first row, where they are often kept; a remark names no columns."""
    before = text.partition(first_row)[0].strip().splitlines()
    comment = re.sub(r"^\w+:\s+", "", before[-1].lstrip("# ")) if before else ""
    names, n_columns = _names(comment), len(_cells(first_row))
    named = len(names) == n_columns or (len(names) < n_columns and _axes(names) is not None)
    return names if named and not _is_numbers(comment) else []


def _xyz_columns(names: list[str]) -> list[int]:
    columns = _axes(names)
    if columns is None and len(names) > 3:
        found = shorten(", ".join(names), 100)
        raise UnreadableError(
            f"its columns are named {found}; name those of the coordinates x, y, z, or keep only them"
        )
    return columns or [0, 1, 2]


def _axes(names: list[str]) -> list[int] | None:
    """The columns of x, y and z, by their bare names before any others; None where they cannot be told."""
    for axes in (names, [_axis(name) for name in names]):
        if all(axes.count(axis) == 1 for axis in "xyz"):
            return [axes.index(axis) for axis in "xyz"]
    return None


def _axis(name: str) -> str:
    found = _AXIS.fullmatch(name)
    if found is None:
        return ""
    return found["axis"] or "xyz"[int(found["number"])]


def read_npy(path: Path) -> Arrays:
    """Read an array of points, shape (n, 3), from an NPY file; no code in it is run."""
    content = path.read_bytes()
    return Arrays(_columns(_array(BytesIO(content), len(content), "its array"), "its array"))


def read_npz(path: Path) -> Arrays:
    """Read ``points`` (or ``vertices``) and perhaps ``faces`` from an NPZ file; no code in it is run."""
    try:
        archive = zipfile.ZipFile(path)
    except zipfile.BadZipFile:
        raise UnreadableError(f"it is no archive of arrays; {CUT_OFF}") from None
    with archive:
        members = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
        key = next((key for key in _POINT_KEYS if key in members), None)
        if key is None:
            found = ", ".join(sorted(members)[:8]) or "nothing"
            raise UnreadableError(f"it holds {found}, but an array 'points' (and perhaps 'faces') is needed")
        points = _columns(_member(archive, members[key]), key)
        faces = _member(archive, members["faces"]) if "faces" in members else None
    return Arrays(points, None if faces is None or not len(faces) else _columns(faces, "faces"))


def _member(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> np.ndarray:
    if info.file_size > max(_MOST_COMPRESSION * info.compress_size, _ALWAYS_ALLOWED):
        raise UnreadableError(
            f"{info.filename} would grow from {info.compress_size} to {info.file_size} bytes; save it again"
        )
    try:
        with archive.open(info) as stream:
            return _array(stream, info.file_size, info.filename)
    except zipfile.BadZipFile:
        raise UnreadableError(f"its {info.filename} is damaged; {CUT_OFF}") from None


def _array(stream: IO[bytes], available: int, what: str) -> np.ndarray:
    """An array of real numbers, whose header is checked before its numbers are read."""
    version = _magic(stream, what)
    read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, in_columns, dtype = read_header(stream)
    if dtype.kind not in "biuf":
        raise UnreadableError(f"{what} holds values of type {dtype}, but real numbers are needed")
    count = math.prod(shape)
    check_claim(count, "numbers", dtype.itemsize, available)
    content = stream.read(count * dtype.itemsize)
    if len(content) < count * dtype.itemsize:
        raise UnreadableError(f"{what} ends too early; {CUT_OFF}")
    return np.frombuffer(content, dtype).reshape(shape, order="F" if in_columns else "C")


def _magic(stream: IO[bytes], what: str) -> tuple[int, int]:
    try:
        return np.lib.format.read_magic(stream)
    except ValueError:
        raise UnreadableError(f"{what} is no NumPy array") from None


def _columns(array: np.ndarray, what: str) -> np.ndarray:
    lying = array.ndim == 2 and array.shape[0] == 3 < array.shape[1]  # points as columns; no shape has only three
    if array.ndim != 2 or array.shape[1] < 3 or lying:
        raise UnreadableError(f"{what} has shape {array.shape}, but must have shape (n, 3)")
    return array[:, :3]


def read_pcd(path: Path) -> Arrays:
    """Read the fields x, y and z of a PCD file: text, binary or compressed."""
    cloud_class = pcd_class()
    content = path.read_bytes()
    n_points = _check_pcd(content)
    cloud = cloud_class.from_fileobj(BytesIO(content))
    if missing := {"x", "y", "z"}.difference(cloud.fields):
        raise UnreadableError(f"it has no field {', '.join(sorted(missing))}")
    points = np.stack([np.atleast_1d(cloud.pc_data[axis]).astype(np.float64) for axis in "xyz"], axis=1)
    if len(points) != n_points:
        raise UnreadableError(f"{n_points} points are announced, but {len(points)} found; {CUT_OFF}")
    return Arrays(points)


def pcd_class() -> Any:
    """The class of point clouds of the package that reads and writes PCD."""
    with needs_extra("reading and writing PCD files", "pcd"):
        from pypcd4.pypcd4 import PointCloud
    return PointCloud


def _check_pcd(content: bytes) -> int:
    """The number of points announced, once the file can hold them."""
    head = re.match(rb".*?^DATA[ \t]+(\w+)[^\n]*\n", content[:100_000], re.DOTALL | re.MULTILINE)
    entries = dict(re.findall(rb"^([A-Z]+)[ \t]+([\d \t]+?)\s*$", head[0], re.MULTILINE)) if head else {}
    if head is None or not {b"SIZE", b"POINTS"} <= entries.keys():
        raise UnreadableError("it has no header from FIELDS and SIZE to POINTS and DATA")
    n_points, body = int(entries[b"POINTS"]), content[head.end() :]
    bytes_per_point = sum(int(size) for size in entries[b"SIZE"].split())
    if head[1] == b"binary":
        check_claim(n_points, "points", bytes_per_point, len(body))
    elif head[1] == b"ascii":
        check_claim(n_points, "points", 2, len(body) + 1)
    else:
        check_claim(n_points * bytes_per_point, "bytes", 1, _MOST_LZF * len(body))
        check_claim(int.from_bytes(body[4:8], "little"), "bytes", 1, _MOST_LZF * len(body))
    return n_points
