"""NumPy's files: NPY with points, NPZ with points and perhaps faces; no code in them is run."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from homolog.core.array_files import ArrayFileError, open_npz
from homolog.core.array_files import read_npy as read_array
from homolog.core.messages import shorten
from homolog.shapes.formats.parsing import (
    CUT_OFF,
    Arrays,
    UnreadableError,
    left_out,
    polygon_faces,
)
from homolog.shapes.shape import Shape

# The names of arrays, in lower case, the first that is there.
_POINT_KEYS = ("points", "vertices", "verts", "v", "xyz", "pos", "positions", "coords", "coordinates", "pts", "pc")
_FACE_KEYS = ("faces", "triangles", "tris", "f", "face", "triangle", "tri", "polygons", "polys", "cells")
# Three rows of more numbers than this are faces as columns, and not three polygons.
_MOST_CORNERS = 8
# No shape has so many points, and below it floating-point numbers are exact.
_TOO_LARGE = 2**53


def read_npy(path: Path) -> Arrays:
    """Read an array of points, shape (n, 3), from an NPY file; no code in it is run."""
    with _as_unreadable():
        array = read_array(path)
    return Arrays(_columns(array, "its array"))


def read_npz(path: Path) -> Arrays:
    """Read points and perhaps faces from an NPZ file, by any of their usual names; others are named in a note."""
    with _as_unreadable(), open_npz(path) as archive:
        # An array that stands alone needs no name.
        point_key = next(iter(archive.names)) if len(archive.names) == 1 else _key(archive.names, _POINT_KEYS)
        face_key = _key(archive.names, _FACE_KEYS)
        face_key = None if face_key == point_key else face_key
        others = sorted({*archive.names} - {point_key, face_key})
        if point_key is None:
            found = shorten(", ".join(sorted(archive.names)[:8]) or "nothing", 100)
            raise UnreadableError(f"it holds {found}, but an array 'points' (and perhaps 'faces') is needed")
        points = _columns(archive[point_key], point_key)
        faces = None if face_key is None else archive[face_key]
    notes = (
        [left_out("arrays", len(others), f"{shorten(', '.join(others[:8]), 100)} are not points or faces")]
        if others
        else []
    )
    return Arrays(points, None if faces is None or not faces.size else _triangles(points, faces), tuple(notes))


@contextmanager
def _as_unreadable() -> Iterator[None]:
    try:
        yield
    except ArrayFileError as error:
        # A reason that says itself what to do is not about damage.
        raise UnreadableError(str(error) if "; " in str(error) else f"{error}; {CUT_OFF}") from None


def _triangles(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Faces of three corners as they are, and those of more triangulated."""
    if faces.dtype.kind == "b":
        raise UnreadableError("faces holds truth values, but must hold indices of points")
    lying = faces.ndim == 2 and faces.shape[0] == 3 and faces.shape[1] > _MOST_CORNERS
    whole = faces.dtype.kind in "iu" or (faces.dtype.kind == "f" and bool((np.abs(faces) < _TOO_LARGE).all()))
    if faces.ndim == 2 and faces.shape[1] > 3 and not lying and whole:
        corners = faces.astype(np.int64)
        if np.array_equal(corners, faces):
            return polygon_faces(points.astype(np.float64), np.full(len(faces), faces.shape[1]), corners.ravel())
    return _columns(faces, "faces", at_most=3)


def _key(members: Iterable[str], names: tuple[str, ...]) -> str | None:
    """The first of some names that is there, in whatever case."""
    lower = {key.lower(): key for key in members}
    return next((lower[name] for name in names if name in lower), None)


def _columns(array: np.ndarray, what: str, *, at_most: int | None = None) -> np.ndarray:
    lying = array.ndim == 2 and array.shape[0] == 3 < array.shape[1]  # points as columns; no shape has only three
    if array.dtype.kind not in "biuf":
        raise UnreadableError(f"{what} holds values of type {shorten(array.dtype)}, but real numbers are needed")
    if array.ndim != 2 or array.shape[1] < 3 or array.shape[1] > (at_most or array.shape[1]) or lying:
        raise UnreadableError(f"{what} has shape {shorten(array.shape)}, but must have shape (n, 3)")
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
