"""NumPy's files: NPY with points, NPZ with points and perhaps faces; no code in them is run."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from homolog.core.array_files import ArrayFileError, open_npz
from homolog.core.array_files import read_npy as read_array
from homolog.core.messages import shorten
from homolog.shapes.finding import Finding
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
# How NumPy calls an array that is saved without a name.
_UNNAMED = "arr_0"
# Three rows of more numbers than this are faces as columns, and not three polygons.
_MOST_CORNERS = 8
# No shape has so many points, and below it floating-point numbers are exact.
_TOO_LARGE = 2**53


def read_npy(path: Path) -> Arrays:
    """Read an array of points, shape (n, 3), from an NPY file; no code in it is run."""
    with _as_unreadable():
        array = read_array(path)
    return Arrays(_columns(array, "its array"), notes=_other_columns(array))


def read_npz(path: Path) -> Arrays:
    """Read points and perhaps faces from an NPZ file, by any of their usual names; others are named in a note.

    Points that stand alone need no name.
    """
    with _as_unreadable(), open_npz(path) as archive:
        names = archive.names
        point_key = _UNNAMED if names == [_UNNAMED] else _key(names, _POINT_KEYS)
        face_key = _key(names, _FACE_KEYS)
        if point_key is None:
            raise UnreadableError(
                f"it holds {_listed(names) or 'nothing'}, but an array of points is needed, named one of "
                f"{', '.join(_POINT_KEYS)}; faces are named one of {', '.join(_FACE_KEYS)}"
            )
        stored = archive[point_key]
        points = _columns(stored, point_key)
        faces = None if face_key is None else archive[face_key]
    notes = (*_other_columns(stored), *_other_arrays(names, point_key, face_key))
    return Arrays(points, None if faces is None or not faces.size else _triangles(points, faces), notes)


def _listed(names: Iterable[str]) -> str:
    """The first of some names."""
    return shorten(", ".join(sorted(names)[:8]), 100)


def _other_arrays(names: Iterable[str], point_key: str, face_key: str | None) -> tuple[Finding, ...]:
    """Notes on the arrays that are passed over: those of a kind of which another was chosen, and all else."""
    left, notes = {*names} - {point_key, face_key}, list[Finding]()
    for kind, keys, chosen in (("points", _POINT_KEYS, point_key), ("faces", _FACE_KEYS, face_key)):
        if rivals := [name for name in left if name.lower() in keys]:
            why = f"the {kind} are those of {chosen}, not of {_listed(rivals)}; remove the arrays that are not meant"
            notes.append(left_out(f"other arrays of {kind}", len(rivals), why))
            left -= {*rivals}
    if left:
        notes.append(left_out("arrays", len(left), f"{_listed(left)} are not points or faces"))
    return tuple(notes)


def _other_columns(array: np.ndarray) -> tuple[Finding, ...]:
    """A note on the columns beside the coordinates, if there are some."""
    count = array.shape[1] - 3
    why = "the coordinates are the first three; if they are not, save those three alone"
    return (left_out("other columns", count, why),) if count > 0 else ()


@contextmanager
def _as_unreadable() -> Iterator[None]:
    try:
        yield
    except ArrayFileError as error:
        # A reason that says itself what to do is not about damage.
        raise UnreadableError(str(error) if "; " in str(error) else f"{error}; {CUT_OFF}") from None


def _triangles(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Faces of three corners as they are, and those of more triangulated."""
    lying = faces.ndim == 2 and faces.shape[0] == 3 and faces.shape[1] > _MOST_CORNERS
    whole = faces.dtype.kind in "iu" or (faces.dtype.kind == "f" and bool((np.abs(faces) < _TOO_LARGE).all()))
    if faces.ndim == 2 and faces.shape[1] > 3 and not lying and whole:
        corners = faces.astype(np.int64)
        if np.array_equal(corners, faces):
            return polygon_faces(points.astype(np.float64), np.full(len(faces), faces.shape[1]), corners.ravel())
    return _columns(faces, "faces", at_most=3)


def _key(members: Iterable[str], names: tuple[str, ...]) -> str | None:
    """The first of some names that is there, in whatever case."""
    lower = {key.lower(): key for key in sorted(members)}  # of two spellings the small letters
    return next((lower[name] for name in names if name in lower), None)


def _columns(array: np.ndarray, what: str, *, at_most: int | None = None) -> np.ndarray:
    lying = array.ndim == 2 and array.shape[0] == 3 < array.shape[1]  # points as columns; no shape has only three
    if array.dtype.kind == "b":
        raise UnreadableError(f"{what} holds truth values, but real numbers are needed; save it as numbers")
    if array.dtype.kind not in "iuf":
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
