"""NumPy's files, NPY and NPZ: headers are checked before their numbers are read, and no code in them is run."""

from __future__ import annotations

import lzma
import math
import os
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

import numpy as np
from jaxtyping import Shaped

from homolog.core.files import opened
from homolog.core.memory import expansion_fault
from homolog.core.messages import shorten
from homolog.core.reasons import reason_of

_SUFFIX = ".npy"
# As often an array is held at a time while it is checked.
_HELD = 2
# The methods of compression that NumPy writes; of others no bound is known.
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
_READ_HEADER = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}


class ArrayFileError(ValueError):
    """A file is not as NumPy writes it; the message is the reason, without the file's name."""


def read_npy(path: str | Path) -> Shaped[np.ndarray, ...]:
    """Read the array of an NPY file.

    Raises:
        ArrayFileError: if it is damaged, or holds something else than numbers, truth values or text.
        OSError: if it cannot be read.
    """
    with opened(path) as file:
        return _array(file, os.fstat(file.fileno()).st_size, "its array")


class ArrayArchive:
    """The arrays of an NPZ file, which are read one by one."""

    def __init__(self, archive: zipfile.ZipFile, size: int) -> None:
        self._archive, self._size = archive, size
        self._members = {info.filename.removesuffix(_SUFFIX): info for info in archive.infolist()}

    @property
    def names(self) -> list[str]:
        """The names of the arrays."""
        return list(self._members)

    def __getitem__(self, name: str) -> Shaped[np.ndarray, ...]:
        """Read an array, unless it would expand to too much.

        Raises:
            ArrayFileError: as ``read_npy`` does.
        """
        info = self._members[name]
        what = shorten(info.filename)
        if fault := expansion_fault(_HELD * info.file_size, self._size):
            raise ArrayFileError(f"{what} is too large; {fault}")
        if info.compress_type not in _METHODS:
            raise ArrayFileError(f"{what} is compressed in a way that NumPy does not write; save it again")
        with _damage(what), self._archive.open(info) as stream:
            return _array(stream, info.file_size, what)


@contextmanager
def open_npz(path: str | Path) -> Iterator[ArrayArchive]:
    """Open an NPZ file.

    Raises:
        ArrayFileError: if it is no archive, or damaged.
        OSError: if it cannot be read.

    Examples:
        >>> import numpy as np
        >>> np.savez("arrays.npz", first=np.arange(3))
        >>> with open_npz("arrays.npz") as stored:
        ...     stored["first"]
        array([0, 1, 2])
    """
    with opened(path) as file:
        size = os.fstat(file.fileno()).st_size
        with _damage("archive"):
            archive = zipfile.ZipFile(file)
        with archive:
            yield ArrayArchive(archive, size)


@contextmanager
def _damage(what: str) -> Iterator[None]:
    """What the library of archives says of a damaged one, as one error."""
    try:
        yield
    except ArrayFileError:
        raise
    except zipfile.BadZipFile:
        damaged = "it is no archive of arrays" if what == "archive" else f"its {what} is damaged"
        raise ArrayFileError(damaged) from None
    except (RuntimeError, ValueError, EOFError, zlib.error, lzma.LZMAError) as error:
        raise ArrayFileError(f"its {what} is damaged ({reason_of(error, 80)})") from None


def _array(stream: IO[bytes], available: int, what: str) -> Shaped[np.ndarray, ...]:
    """An array whose header is checked before its numbers are read."""
    try:
        version = np.lib.format.read_magic(stream)
    except ValueError:
        raise ArrayFileError(f"{what} is no NumPy array") from None
    try:
        shape, in_columns, dtype = _READ_HEADER.get(version, np.lib.format.read_array_header_2_0)(stream)
        lengths = [int(length) for length in shape]
    except Exception:  # what Python's parser says of damaged text helps nobody
        raise ArrayFileError(f"{what} has a damaged header") from None
    if dtype.hasobject:
        raise ArrayFileError(f"{what} holds values of type object, but real numbers are needed; save it as numbers")
    count = math.prod(lengths)
    if min(lengths, default=0) < 0 or count * dtype.itemsize > available:
        raise ArrayFileError(
            f"{what}: the header announces {shorten(count, 30)} numbers, but the file has only {available} bytes"
        )
    content = stream.read(count * dtype.itemsize)
    if len(content) < count * dtype.itemsize:
        raise ArrayFileError(f"{what} ends too early")
    try:
        return np.frombuffer(content, dtype, count).reshape(lengths, order="F" if in_columns else "C")
    except ValueError:
        raise ArrayFileError(f"{what} has a damaged header") from None
