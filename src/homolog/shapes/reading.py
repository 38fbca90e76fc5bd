"""Reading a shape from a file of any supported format.

Indices always mean the user's own file: point i of the shape is the i-th point of the file. Nothing is
merged, reordered or dropped, with one exception: STL knows only separate triangles, whose equal corners
become one point.
"""

from __future__ import annotations

import errno
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from os import PathLike
from pathlib import Path
from typing import Any, get_args

import numpy as np

from homolog.core.arguments import check_choice, check_kind
from homolog.core.errors import HomologError, MissingExtraError, ShapeError
from homolog.core.files import expanded, read_bytes, sha256
from homolog.core.reasons import reason_of
from homolog.shapes.formats import Format, formats, imports_of, readable_suffixes
from homolog.shapes.formats.gltf import Pose
from homolog.shapes.formats.parsing import Arrays, UnreadableError
from homolog.shapes.shape import FEWEST_POINTS, Owned, Shape, counts_from_one

VOLUMES: tuple[str, ...] = (".mhd", ".mha", ".nii", ".nii.gz", ".nrrd", ".nhdr")
"""The suffixes of volumes, which are no shapes as yet; ``homolog.volumes`` makes surfaces of them."""


# What compressed files begin with.
_COMPRESSIONS = {
    b"\x1f\x8b": "gzip",
    b"PK\3\4": "zip",
    b"\xfd7zXZ\0": "xz",
    **{b"BZh%d1AY&SY" % level: "bzip2" for level in range(1, 10)},
    b"\x28\xb5\x2f\xfd": "zstd",
    b"7z\xbc\xaf\x27\x1c": "7z",
}


def read_shape(path: str | Path, *, pose: Pose = "posed") -> Shape:
    """Read a mesh or a point cloud; the suffix says which format, whatever its case.

    Args:
        path: a file with one of the suffixes in ``readable_suffixes()``; ``~`` is expanded.
        pose: skinned meshes of glTF as the joints pose them in the file, which is what viewers show, or at ``"rest"``,
            as they were bound. Other formats have no joints.

    Returns:
        The shape, named like the file, with its points in file order and polygons split into triangles. A
        file without faces is a point cloud. Points that are NaN and faces that do not fit are kept for
        ``repair``. What was left out of the file stands in ``notes``, and ``check`` reports it.

    Raises:
        ArgumentError: if ``path`` is no path, or ``pose`` is no pose.
        ShapeError: if the file cannot be used; one line with the file, the reason, and what to do.
        MissingExtraError: if reading this format needs a package that is not installed.

    Examples:
        >>> import homolog
        >>> from pathlib import Path
        >>> folder = Path(homolog.__file__).parent / "demo_data" / "off"
        >>> homolog.read_shape(folder / "amber.off")
        Shape('amber.off': mesh, 4918 points, 9832 faces)
    """
    check_kind("path", path, PathLike, str)
    check_choice("pose", pose, get_args(Pose))
    file = _checked(path)
    check_suffix(path)
    form = formats()[file.suffix.lower()]
    read = form.read_rest if pose == "rest" and form.read_rest is not None else form.read
    with _in_one_line(path), _compression_told(file, form), warnings.catch_warnings(), imports_of(form):
        warnings.simplefilter("ignore")
        shape = _shape(read(file), file.name)
        _check_content(shape)
        return shape


def _shape(found: Any, name: str) -> Shape:
    """A shape of what a reader gave, be it of a format of one's own: points alone, or points and faces."""
    arrays = Arrays(*found) if isinstance(found, tuple) else Arrays(found)
    points: Any = arrays.points
    faces: Any = arrays.faces
    if isinstance(found, Arrays):  # of Homolog's own readers, which keep nothing
        points, faces = Owned(points), None if faces is None else Owned(faces)
    try:
        return Shape(points, faces, name=name, notes=arrays.notes, space=arrays.space, allow_broken=True)
    except ShapeError as error:  # the path is named where all other faults of a file are told
        raise UnreadableError(str(error).removeprefix(f"{name}: ")) from None


def check_suffix(path: str | Path) -> None:
    """Refuse a name that is none of a shape's file, without a look at the file.

    Raises:
        ShapeError: if its suffix is not in ``readable_suffixes()``.
    """
    name = Path(path).name
    if (suffix := Path(path).suffix).lower() in readable_suffixes():
        return
    if name.lower().endswith(VOLUMES):
        raise ShapeError(f"{path} is a volume; make a surface of its mask first, with homolog volume surface")
    found = f"the suffix {suffix!r}" if suffix else "no suffix"
    raise ShapeError(f"{path} has {found}, but must have one of {', '.join(readable_suffixes())}")


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
    form = formats().get(file.suffix.lower())
    if form is None or form.files_beside is None:
        return (file,)
    with _in_one_line(path), _compression_told(file, form):
        return (file, *form.files_beside(file))


@contextmanager
def _in_one_line(path: str | Path) -> Iterator[None]:
    """Turn whatever is wrong with a file's content into one line about it."""
    try:
        yield
    except HomologError:
        raise
    except Exception as error:
        raise ShapeError(f"{path} could not be read as {Path(path).suffix[1:].upper()}: {_reason(error)}") from error


@contextmanager
def _compression_told(file: Path, form: Format) -> Iterator[None]:
    """Say of a file that cannot be read that it is compressed, if it is, and its format is not."""
    try:
        yield
    except MissingExtraError:
        raise
    except Exception:
        head = read_bytes(file, first=max(map(len, _COMPRESSIONS)))
        found = next((name for start, name in _COMPRESSIONS.items() if head.startswith(start)), None)
        if found is None or form.compressed in (found, "in any way"):
            raise
        raise UnreadableError(f"it is compressed ({found}); unpack it first") from None


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
    try:
        file.stat()
    except (FileNotFoundError, NotADirectoryError):
        return "is a link to nothing; check the path" if file.is_symlink() else "does not exist; check the path"
    except OSError as error:
        if error.errno == errno.ELOOP:
            return "is a link that leads to itself; give the path of a file"
        raise
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
    return f"it is damaged or not of this format ({reason_of(error, 100)})"


def _check_content(shape: Shape) -> None:
    """Refuse what no repair can make a shape of."""
    points, faces = shape.points, shape.faces
    finite = np.isfinite(points).all(axis=1)
    if np.count_nonzero(finite) < FEWEST_POINTS:
        found = np.count_nonzero(finite)
        raise UnreadableError(f"it has {found} usable points, but at least {FEWEST_POINTS} are needed")
    if np.all((points == points[finite.argmax()]).all(axis=1) | ~finite):
        raise UnreadableError("all its points are equal; export it again")
    if faces is not None and not np.any(np.all((faces >= 0) & (faces < len(points)), axis=1)):
        raise UnreadableError("none of its faces refers to its points; export it again")
    if faces is not None and counts_from_one(faces, len(points)):
        raise UnreadableError("its faces seem to count points from 1; subtract 1 from their indices")
