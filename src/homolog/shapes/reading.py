"""Reading a shape from a file of any supported format.

Indices always mean the user's own file: point i of the shape is the i-th point of the file. Nothing is
merged, reordered or dropped, with one exception: STL knows only separate triangles, whose equal corners
become one point.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from os import PathLike
from pathlib import Path

import numpy as np

from homolog.core.arguments import check_kind
from homolog.core.errors import HomologError, ShapeError
from homolog.core.files import expanded, sha256
from homolog.shapes.gltf_format import buffer_files, read_glb, read_gltf
from homolog.shapes.mesh_formats import read_obj, read_off, read_stl
from homolog.shapes.parsing import Arrays, UnreadableError, shorten
from homolog.shapes.ply_format import read_ply
from homolog.shapes.point_formats import read_npy, read_npz, read_pcd, read_table
from homolog.shapes.shape import FEWEST_POINTS, Shape
from homolog.shapes.vtk_formats import read_vtk, read_vtp, read_vtu

_READERS: dict[str, Callable[[Path], Arrays]] = {
    ".off": read_off,
    ".obj": read_obj,
    ".ply": read_ply,
    ".stl": read_stl,
    ".glb": read_glb,
    ".gltf": read_gltf,
    ".vtk": read_vtk,
    ".vtp": read_vtp,
    ".vtu": read_vtu,
    ".xyz": read_table,
    ".txt": read_table,
    ".csv": read_table,
    ".npy": read_npy,
    ".npz": read_npz,
    ".pcd": read_pcd,
}
READABLE: tuple[str, ...] = tuple(_READERS)
"""The suffixes of the files that ``read_shape`` reads."""

VOLUMES: tuple[str, ...] = (".mhd", ".mha", ".nii", ".nii.gz", ".nrrd", ".nhdr")
"""The suffixes of volumes, which are no shapes as yet; ``homolog.volumes`` makes surfaces of them."""


def read_shape(path: str | Path) -> Shape:
    """Read a mesh or a point cloud; the suffix says which format, whatever its case.

    Args:
        path: a file with one of the suffixes in ``READABLE``; ``~`` is expanded.

    Returns:
        The shape, named like the file, with its points in file order and polygons split into triangles. A
        file without faces is a point cloud. Points that are NaN and faces that do not fit are kept for
        ``repair``.

    Raises:
        ArgumentError: if ``path`` is no path.
        ShapeError: if the file cannot be used; one line with the file, the reason, and what to do.
        MissingExtraError: if reading this format needs a package that is not installed.
    """
    check_kind("path", path, PathLike, str)
    file = _checked(path)
    check_suffix(path)
    with _in_one_line(path), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        arrays = _READERS[file.suffix.lower()](file)
        _check_content(arrays)
        return Shape(*arrays, name=file.name)


def check_suffix(path: str | Path) -> None:
    """Refuse a name that is none of a shape's file, without a look at the file.

    Raises:
        ShapeError: if its suffix is not in ``READABLE``.
    """
    name = Path(path).name
    if (suffix := Path(path).suffix).lower() in READABLE:
        return
    if name.lower().endswith(VOLUMES):
        raise ShapeError(f"{path} is a volume; make a surface of its mask first, with homolog volume surface")
    found = f"the suffix {suffix!r}" if suffix else "no suffix"
    raise ShapeError(f"{path} has {found}, but must have one of {', '.join(READABLE)}")


def read_hashed_shape(path: str | Path) -> tuple[Shape, str]:
    """A shape, and the hash of the very bytes that it was read from, be they in one file or in several.

    Raises:
        ShapeError: as ``read_shape`` does, and if the file changes while it is read.
    """
    before = sha256(*files_of_shape(path))
    shape = read_shape(path)
    digest = sha256(*files_of_shape(path))
    if digest != before:
        raise ShapeError(f"{path} changed while it was read; try again once it is complete")
    return shape, digest


def files_of_shape(path: str | Path) -> tuple[Path, ...]:
    """The files that ``read_shape`` reads: the file itself, and then those that hold the buffers of a glTF, in order.

    Raises:
        ShapeError: if the file cannot be used.
    """
    file = _checked(path)
    if file.suffix.lower() not in (".glb", ".gltf"):
        return (file,)
    with _in_one_line(path):
        return (file, *buffer_files(file))


@contextmanager
def _in_one_line(path: str | Path) -> Iterator[None]:
    """Turn whatever is wrong with a file's content into one line about it."""
    try:
        yield
    except HomologError:
        raise
    except Exception as error:
        raise ShapeError(f"{path} could not be read as {Path(path).suffix[1:].upper()}: {_reason(error)}") from error


def _checked(path: str | Path) -> Path:
    """A file that is there and not empty."""
    file = expanded(path)
    try:
        fault = _fault(file)
    except (OSError, ValueError) as error:
        raise ShapeError(f"{file} cannot be opened: {_reason(error)}") from error
    if fault:
        raise ShapeError(f"{file} {fault}")
    return file


def _fault(file: Path) -> str:
    """What is wrong with a file before a look into it, if anything."""
    if not file.exists():
        return "does not exist; check the path"
    if file.is_dir():
        return "is a folder; give a file in it"
    if not file.is_file():
        return "is not an ordinary file; copy its content to one"
    return "" if file.stat().st_size else "is empty; export it again"


def _reason(error: Exception) -> str:
    if isinstance(error, UnreadableError):
        return str(error)
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    if isinstance(error, MemoryError):
        return "it does not fit into memory; reduce it first"
    said = shorten(error, 100)
    return f"it is damaged or not of this format ({type(error).__name__}{': ' if said else ''}{said})"


def _check_content(arrays: Arrays) -> None:
    """Refuse what no repair can make a shape of."""
    points, faces = arrays
    finite = points[np.isfinite(points).all(axis=1)]
    if len(finite) < FEWEST_POINTS:
        raise UnreadableError(f"it has {len(finite)} usable points, but at least {FEWEST_POINTS} are needed")
    if np.all(finite == finite[0]):
        raise UnreadableError("all its points are equal; export it again")
    if faces is not None and not np.any(np.all((faces >= 0) & (faces < len(points)), axis=1)):
        raise UnreadableError("none of its faces refers to its points; export it again")
