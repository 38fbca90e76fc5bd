"""NumPy's files: NPY with points, NPZ with points and perhaps faces; no code in them is run."""

from __future__ import annotations

import math
import zipfile
from collections.abc import Iterable
from io import BytesIO
from pathlib import Path
from typing import IO

import numpy as np

from homolog.core.messages import shorten
from homolog.shapes.formats.parsing import (
    CUT_OFF,
    Arrays,
    UnreadableError,
    check_claim,
    left_out,
    polygon_faces,
)
from homolog.shapes.shape import Shape

# The names of arrays, in lower case, the first that is there.
_POINT_KEYS = ("points", "vertices", "verts", "v", "xyz")
_FACE_KEYS = ("faces", "triangles", "tris", "f")
# Coordinates hardly compress; an archive that grows more than this is made to fill the memory.
_MOST_COMPRESSION = 200
_ALWAYS_ALLOWED = 64 * 2**20


def read_npy(path: Path) -> Arrays:
    """Read an array of points, shape (n, 3), from an NPY file; no code in it is run."""
    content = path.read_bytes()
    return Arrays(_columns(_array(BytesIO(content), len(content), "its array"), "its array"))


def read_npz(path: Path) -> Arrays:
    """Read points and perhaps faces from an NPZ file, by any of their usual names; others are named in a note."""
    try:
        archive = zipfile.ZipFile(path)
    except zipfile.BadZipFile:
        raise UnreadableError(f"it is no archive of arrays; {CUT_OFF}") from None
    with archive:
        members = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
        point_key, face_key = _key(members, _POINT_KEYS), _key(members, _FACE_KEYS)
        others = sorted(members.keys() - {point_key, face_key})
        if point_key is None:
            found = shorten(", ".join(sorted(members)[:8]) or "nothing", 100)
            raise UnreadableError(f"it holds {found}, but an array 'points' (and perhaps 'faces') is needed")
        points = _columns(_member(archive, members[point_key]), point_key)
        faces = None if face_key is None else _member(archive, members[face_key])
    notes = (
        [left_out("arrays", len(others), f"{shorten(', '.join(others[:8]), 100)} are not points or faces")]
        if others
        else []
    )
    return Arrays(points, None if faces is None or not len(faces) else _triangles(points, faces), tuple(notes))


def _triangles(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Faces of three corners as they are, and those of more triangulated."""
    if faces.ndim == 2 and faces.shape[1] > 3 and faces.dtype.kind in "iu":
        corners = faces.astype(np.int64).ravel()
        return polygon_faces(points.astype(np.float64), np.full(len(faces), faces.shape[1]), corners)
    return _columns(faces, "faces", at_most=3)


def _key(members: Iterable[str], names: tuple[str, ...]) -> str | None:
    """The first of some names that is there, in whatever case."""
    lower = {key.lower(): key for key in members}
    return next((lower[name] for name in names if name in lower), None)


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


def _columns(array: np.ndarray, what: str, *, at_most: int | None = None) -> np.ndarray:
    lying = array.ndim == 2 and array.shape[0] == 3 < array.shape[1]  # points as columns; no shape has only three
    if array.ndim != 2 or array.shape[1] < 3 or array.shape[1] > (at_most or array.shape[1]) or lying:
        raise UnreadableError(f"{what} has shape {array.shape}, but must have shape (n, 3)")
    return array[:, :3]


def write_npy(path: Path, shape: Shape) -> None:
    """Write the points as an array."""
    with path.open("wb") as file:
        np.save(file, shape.points, allow_pickle=False)


def write_npz(path: Path, shape: Shape) -> None:
    """Write the arrays points and, of a mesh, faces."""
    arrays = {"points": shape.points} if shape.faces is None else {"points": shape.points, "faces": shape.faces}
    with path.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **arrays)
