"""The formats of shapes: which there are, and how a new one is added."""

from __future__ import annotations

import logging
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, Literal

from homolog.core.errors import ArgumentError, bad_value, needs_extra
from homolog.core.plugins import described, fault, offered
from homolog.shapes.shape import Shape

_log = logging.getLogger(__name__)

ENTRY_POINTS = "homolog.formats"
"""The group of entry points whose functions, called without arguments, register formats."""


@dataclass(frozen=True)
class Format:
    """How files with one suffix are read and written.

    Args:
        suffix: with its dot, in lower case.
        read: gives points, or points and faces, or ``Arrays``, of a path.
        write: writes a shape to a path; None if it cannot be written.
        clouds_only: whether it holds points alone.
        meshes_only: whether it cannot hold points without faces.
        extra: the extra of Homolog that brings what reading and writing import.
        in_folders: what a file with this suffix is in a folder of shapes: a mesh, a cloud, or nothing, where such files
            mostly hold something else.
        write_values: writes a shape with colours and numbers of its points, if it can hold these.
        read_rest: reads skinned meshes at rest, where ``read`` poses them.
        files_beside: the other files that a file's shape is read from, in order.
        compressed: how its files are compressed as a whole, such as ``"zip"``; None if they are not.
    """

    suffix: str
    read: Callable[[Path], Any]
    write: Callable[[Path, Shape], None] | None = None
    clouds_only: bool = False
    meshes_only: bool = False
    extra: str | None = None
    in_folders: Literal["mesh", "cloud", "nothing"] = "mesh"
    write_values: Callable[..., None] | None = None
    read_rest: Callable[[Path], Any] | None = None
    files_beside: Callable[[Path], tuple[Path, ...]] | None = None
    compressed: Literal["zip", "in any way"] | None = None


_FORMATS: dict[str, Format] = {}


def register_format(
    suffix: str,
    *,
    read: Callable[[Path], Any],
    write: Callable[[Path, Shape], None] | None = None,
    clouds_only: bool = False,
    extra: str | None = None,
) -> None:
    """Add a file format, so that ``read_shape``, ``write_shape``, datasets and all commands know it.

    A format that is registered under a suffix of Homolog's own takes its place. An installed package can register its
    formats in every run: name a function in its entry-point group ``homolog.formats``; it is called once, without
    arguments, and calls this one.

    Args:
        suffix: what names of files end with, such as ``".tri"``, in whatever case.
        read: takes a path and returns points (n, 3), or points and faces (m, 3) with indices from 0, in the order of
            the file. Whatever it raises becomes one line that names the file.
        write: takes a path and a ``Shape``, and makes the file; None if the format cannot be written.
        clouds_only: whether the format holds points alone, so that no mesh is written to it.
        extra: the extra of Homolog that brings what ``read`` and ``write`` import, such as ``"vtk"``; where an import
            fails the error names it.

    Raises:
        ArgumentError: if the suffix is no dot and letters or digits.

    Examples:
        >>> import tempfile, numpy as np, homolog
        >>> from pathlib import Path
        >>> def read(path):
        ...     values = np.fromfile(path, "<f4")
        ...     return values.reshape(-1, 3)
        >>> def write(path, shape):
        ...     shape.points.astype("<f4").tofile(path)
        >>> homolog.shapes.register_format(".raw3", read=read, write=write, clouds_only=True)
        >>> body = homolog.shapes.demo_shapes()[0]
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     homolog.write_shape(Path(folder) / "body.raw3", body.as_cloud())
        ...     homolog.read_shape(Path(folder) / "body.raw3")
        Shape('body.raw3': cloud, 4918 points)
    """
    if len(suffix) < 2 or suffix[0] != "." or not suffix[1:].isalnum():
        raise bad_value("suffix", suffix, "a dot and letters or digits, such as '.tri'")
    for name, function in {"read": read, "write": write}.items():
        if not callable(function) and (name == "read" or function is not None):
            raise ArgumentError(f"{name} is {function!r}, but must be a function")
    kind: Literal["mesh", "cloud"] = "cloud" if clouds_only else "mesh"
    form = Format(suffix.lower(), read, write, clouds_only=clouds_only, extra=extra, in_folders=kind)
    add(replace(form, compressed="in any way"))  # of which nothing is known


def add(*formats: Format) -> None:
    """Add formats; one with the suffix of an earlier one takes its place."""
    _FORMATS.update({one.suffix: one for one in formats})


def formats() -> dict[str, Format]:
    """All formats by their suffixes, those of installed packages included."""
    _load_installed()
    return dict(_FORMATS)


@cache
def _load_installed() -> None:
    for point in offered(ENTRY_POINTS).values():
        try:
            point.load()()
        except Exception as error:  # noqa: PERF203  # a fault of another package must not stop this one
            _log.warning("the formats of %s are left out (%s)", described(point), fault(error))


def imports_of(form: Format) -> AbstractContextManager[None]:
    """Around reading or writing: where an import fails, the error names the extra that brings it."""
    suffix = form.suffix[1:].upper()
    return nullcontext() if form.extra is None else needs_extra(f"Reading and writing {suffix} files", form.extra)


def readable_suffixes() -> tuple[str, ...]:
    """The suffixes of the files that ``read_shape`` reads."""
    return tuple(formats())


def writable_suffixes() -> tuple[str, ...]:
    """The suffixes of the files that ``write_shape`` writes."""
    return tuple(suffix for suffix, one in formats().items() if one.write is not None)


def folder_suffixes(*, clouds: bool) -> tuple[str, ...]:
    """The suffixes by which meshes, and perhaps clouds, are found in a folder of shapes."""
    wanted = ("mesh", "cloud") if clouds else ("mesh",)
    return tuple(suffix for suffix, one in formats().items() if one.in_folders in wanted)
