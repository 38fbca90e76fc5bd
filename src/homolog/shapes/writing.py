"""Writing a shape to a file of any format that can hold it."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from jaxtyping import UInt8

from homolog.core.arguments import check_kind
from homolog.core.errors import ArgumentError, ShapeError
from homolog.core.files import atomic_path
from homolog.shapes.point_formats import pcd_class
from homolog.shapes.shape import Shape
from homolog.shapes.vtk_formats import write_vtk, write_vtp, write_vtu

# Only partly typed.
_TRIMESH: Any = trimesh

Colours = UInt8[np.ndarray, "n 3"]


def write_shape(path: str | Path, shape: Shape, *, colours: Colours | None = None) -> None:
    """Write a shape; the suffix says in which format.

    Coordinates keep double precision, except in STL and GLB, which hold single precision. The file appears
    only once it is complete. STL has no points of its own: those no face uses are lost, and reading numbers
    the rest anew.

    Args:
        path: a file with one of the suffixes in ``WRITABLE``; ``~`` is expanded, an existing file is
            replaced.
        shape: what to write. Formats of points alone take no mesh: write ``shape.as_cloud()``. STL takes no
            cloud.
        colours: red, green and blue of each point, 0 to 255, shape (n, 3); PLY only.

    Raises:
        ShapeError: if the format cannot hold the shape.
        ArgumentError: if it is no ``Shape``, the suffix is unknown, the colours do not fit, or the folder cannot be
            written to.
        MissingExtraError: if writing this format needs a package that is not installed.
    """
    check_kind("path", path, PathLike, str)
    check_kind("shape", shape, Shape)
    suffix = Path(path).suffix.lower()
    if suffix not in _WRITERS:
        raise ArgumentError(
            f"{path} has the suffix {suffix!r}, but must have one of {', '.join(WRITABLE)} to be written"
        )
    if suffix in _POINTS_ONLY and shape.faces is not None:
        raise ShapeError(f"{path} cannot hold the faces of {shape.name}; choose .ply, or write shape.as_cloud()")
    if suffix == ".stl" and shape.faces is None:
        raise ShapeError(f"{path} cannot hold {shape.name}, a point cloud; choose .ply")
    if colours is not None:
        _check_colours(path, suffix, shape, colours)
    with atomic_path(path) as temporary:
        if colours is None:
            _WRITERS[suffix](temporary, shape)
        else:
            _write_ply(temporary, shape, colours)


def _check_colours(path: str | Path, suffix: str, shape: Shape, colours: Colours) -> None:
    if suffix != ".ply":
        raise ArgumentError(f"{path} cannot hold colours; choose the suffix .ply")
    if np.shape(colours) != (shape.n_points, 3) or np.asarray(colours).dtype != np.uint8:
        found = f"{np.asarray(colours).dtype} of shape {np.shape(colours)}"
        raise ArgumentError(f"colours are {found}, but must be uint8 of shape ({shape.n_points}, 3)")


def _write_lines(path: Path, parts: Iterable[tuple[str, np.ndarray]], head: str = "") -> None:
    """Write rows of numbers by a pattern; ``%r`` gives the shortest text that reads back the same number."""
    with path.open("w", encoding="ascii", newline="\n") as file:
        file.write(head)
        for pattern, rows in parts:
            file.writelines(pattern % tuple(row) for row in rows.tolist())


def _faces(shape: Shape) -> np.ndarray:
    return np.zeros((0, 3), np.int64) if shape.faces is None else shape.faces


def _write_off(path: Path, shape: Shape) -> None:
    head = f"OFF\n{shape.n_points} {shape.n_faces} 0\n"
    _write_lines(path, [("%r %r %r\n", shape.points), ("3 %d %d %d\n", _faces(shape))], head)


def _write_obj(path: Path, shape: Shape) -> None:
    _write_lines(path, [("v %r %r %r\n", shape.points), ("f %d %d %d\n", _faces(shape) + 1)])


def _write_ply(path: Path, shape: Shape, colours: Colours | None = None) -> None:
    names = ["x", "y", "z"] if colours is None else ["x", "y", "z", "red", "green", "blue"]
    types = ["double"] * 3 + ["uchar"] * (len(names) - 3)
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {shape.n_points}"]
    head += [f"property {type_} {name}" for type_, name in zip(types, names, strict=True)]
    if shape.faces is not None:
        head += [f"element face {shape.n_faces}", "property list uchar int vertex_indices"]
    points = np.zeros(shape.n_points, [("xyz", "<f8", 3), ("rgb", "u1", len(names) - 3)])
    points["xyz"] = shape.points
    points["rgb"] = 0 if colours is None else colours
    faces = np.zeros(shape.n_faces, [("size", "u1"), ("corners", "<i4", 3)])
    faces["size"], faces["corners"] = 3, _faces(shape)
    path.write_bytes("\n".join([*head, "end_header\n"]).encode() + points.tobytes() + faces.tobytes())


def _write_trimesh(kind: str) -> Callable[[Path, Shape], None]:
    def write(path: Path, shape: Shape) -> None:
        if shape.faces is None:
            geometry: Any = _TRIMESH.PointCloud(shape.points)
        else:
            geometry = _TRIMESH.Trimesh(shape.points, shape.faces, process=False, validate=False)
        path.write_bytes(
            _TRIMESH.Scene(geometry).export(file_type=kind) if kind == "glb" else geometry.export(file_type=kind)
        )

    return write


def _write_table(pattern: str, head: str = "") -> Callable[[Path, Shape], None]:
    return lambda path, shape: _write_lines(path, [(pattern, shape.points)], head)


def _write_npy(path: Path, shape: Shape) -> None:
    with path.open("wb") as file:
        np.save(file, shape.points, allow_pickle=False)


def _write_npz(path: Path, shape: Shape) -> None:
    arrays = {"points": shape.points} if shape.faces is None else {"points": shape.points, "faces": shape.faces}
    with path.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **arrays)


def _write_pcd(path: Path, shape: Shape) -> None:
    pcd_class().from_points(shape.points, ("x", "y", "z"), (np.float64,) * 3).save(path)


_WRITERS: dict[str, Callable[[Path, Shape], None]] = {
    ".off": _write_off,
    ".obj": _write_obj,
    ".ply": _write_ply,
    ".stl": _write_trimesh("stl"),
    ".glb": _write_trimesh("glb"),
    ".vtk": write_vtk,
    ".vtp": write_vtp,
    ".vtu": write_vtu,
    ".xyz": _write_table("%r %r %r\n"),
    ".txt": _write_table("%r %r %r\n"),
    ".csv": _write_table("%r,%r,%r\n", "x,y,z\n"),
    ".npy": _write_npy,
    ".npz": _write_npz,
    ".pcd": _write_pcd,
}
WRITABLE: tuple[str, ...] = tuple(_WRITERS)
"""The suffixes of the files that ``write_shape`` writes."""

_POINTS_ONLY = (".xyz", ".txt", ".csv", ".npy", ".pcd")
