"""Bounds on memory: of arrays between all points of two shapes, and of what a file expands to.

An n_y x n_x array is made only if it fits. And how a process keeps freed memory.
"""

from __future__ import annotations

import ctypes
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from homolog.core.arguments import is_number
from homolog.core.errors import ArgumentError, bad_value

_MEBIBYTE = 2**20
_bound = 1024.0

# A file may expand to so many megabytes, or to so many times its own size.
_EXPANSION_MB = "200"
_EXPANSION = 20

# Rows are worked on in tiles of about this size even where more would fit: a tile then stays in the processor's cache
# between the product that makes it and the reductions that read it.
_TILE_BYTES = 4 * _MEBIBYTE
# But of at least so many rows, the first number that the bound allows.
_ENOUGH_ROWS = (128, 16)


def set_working_memory(mebibytes: float) -> None:
    """Bound the temporary memory of products between all points of one shape and all of another.

    Args:
        mebibytes: the bound, above 0; 1024 by default, 256 to 8192 are sensible. Results do not depend on it beyond
            rounding; speed does.

    Raises:
        ArgumentError: if it is not a positive number.

    Examples:
        >>> import homolog
        >>> homolog.set_working_memory(512)
        >>> homolog.get_working_memory()
        512.0
        >>> homolog.set_working_memory(1024)

    See Also:
        ``working_memory`` sets it for a ``with`` block.
    """
    if not (is_number(mebibytes) and mebibytes > 0):
        raise bad_value("working memory", mebibytes, "a positive number of mebibytes")
    global _bound
    _bound = float(mebibytes)


def get_working_memory() -> float:
    """The working-memory bound in mebibytes; see ``set_working_memory``.

    Examples:
        >>> import homolog
        >>> homolog.get_working_memory()
        1024.0
    """
    return _bound


@contextmanager
def working_memory(mebibytes: float) -> Iterator[None]:
    """Set the working-memory bound within a ``with`` block, for all threads of the process.

    Args:
        mebibytes: the bound, above 0.

    Examples:
        >>> import homolog
        >>> with homolog.working_memory(64):
        ...     homolog.get_working_memory()
        64.0
        >>> homolog.get_working_memory()
        1024.0
    """
    before = get_working_memory()
    set_working_memory(mebibytes)
    try:
        yield
    finally:
        set_working_memory(before)


def fits(n_bytes: float) -> bool:
    """Whether an array of so many bytes fits the bound."""
    return n_bytes <= get_working_memory() * _MEBIBYTE


def row_tiles(n_rows: int, bytes_per_row: float) -> Iterator[slice]:
    """Slices that cut ``n_rows`` into tiles of at least a row, within the bound and small enough for the cache."""
    budget = min(_TILE_BYTES, get_working_memory() * _MEBIBYTE)
    height = max(1, int(budget // max(bytes_per_row, 1)))
    # Few rows make a matrix product slow, which weighs more than the cache where rows are long.
    affordable = (rows for rows in _ENOUGH_ROWS if fits(rows * bytes_per_row))
    height = max(height, next(affordable, 1))
    for start in range(0, n_rows, height):
        yield slice(start, min(start + height, n_rows))


def most_expanded(size: int) -> int:
    """The number of bytes that a file of ``size`` bytes may expand to when it is read.

    It is 20 times the size, or 200 MB if that is more; the environment variable ``HOMOLOG_EXPANSION_MB`` changes these.

    Raises:
        ArgumentError: if ``HOMOLOG_EXPANSION_MB`` is not a number.
    """
    given = os.environ.get("HOMOLOG_EXPANSION_MB", _EXPANSION_MB)
    try:
        return max(int(float(given) * _MEBIBYTE), _EXPANSION * size)
    except (ValueError, OverflowError):  # the latter from an infinite one
        raise ArgumentError(f"HOMOLOG_EXPANSION_MB is {given!r}, but must be a number of megabytes") from None


def expansion_fault(n_bytes: int, size: int) -> str:
    """Why a file of ``size`` bytes is not expanded to ``n_bytes``; nothing if it may be."""
    if n_bytes <= most_expanded(size):
        return ""
    needed = f"its {size} bytes would take {n_bytes / _MEBIBYTE:.4g} MB when read"
    return f"{needed}; if that is right, set HOMOLOG_EXPANSION_MB"


# Of the C library of Linux: from what size on freed memory at the heap's end is given back to the system, and from what
# size on an array has memory of its own, given back at once; the latter at most 32 MiB.
_MALLOPT_TRIM_THRESHOLD, _MALLOPT_MMAP_THRESHOLD = -1, -3


def keep_freed_memory() -> None:
    """Have this process keep the memory that it frees, for what comes next; it never shrinks then.

    The steps of a training free and need the same memory over and over, and the system hands it out in small pieces
    that it clears one by one. Does nothing where the C library is another than Linux's usual one.
    """
    with suppress(AttributeError, OSError, TypeError):
        library = ctypes.CDLL(None)
        library.mallopt(_MALLOPT_TRIM_THRESHOLD, 2**31 - 1)
        library.mallopt(_MALLOPT_MMAP_THRESHOLD, 32 * _MEBIBYTE)
