"""Shapes in correspondence that need not be in memory: an array, a file, or anything that gives some rows at a time."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Protocol

import numpy as np
from jaxtyping import Bool, Float

# Bytes of the shapes that are in memory at a time, beside what is computed of them.
_BLOCK_BYTES = 8 * 2**20


class Rows(Protocol):
    """Shapes (s, n, 3), as an array has them: a NumPy array is one."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Numbers of shapes and points, and 3."""

    def __len__(self) -> int:
        """The number of shapes."""

    def __getitem__(self, key: slice, /) -> np.ndarray:
        """Some shapes in memory."""


def blocks(rows: Rows) -> Iterator[slice]:
    """Slices of shapes that follow each other and together are all, few enough each to be in memory.

    Examples:
        >>> list(blocks(np.zeros((3, 5, 3))))
        [slice(0, 3, None)]
    """
    size = max(1, _BLOCK_BYTES // max(1, 8 * int(np.prod(rows.shape[1:]))))
    for begin in range(0, len(rows), size):
        yield slice(begin, min(begin + size, len(rows)))


class PointRows:
    """Some of the points of shapes, read when they are asked for.

    Args:
        rows: the shapes (s, n, 3).
        kept: which points (n,).
    """

    def __init__(self, rows: Rows, kept: Bool[np.ndarray, " n"]) -> None:
        self._rows, self._kept = rows, kept
        self.shape = (len(rows), int(kept.sum()), 3)

    def __len__(self) -> int:
        return int(self.shape[0])

    def __getitem__(self, key: slice) -> Float[np.ndarray, "s m 3"]:
        """Some shapes."""
        return np.asarray(self._rows[key][:, self._kept])


class FileRows:
    """Shapes in an NPY file, read when they are asked for.

    Args:
        path: of an array (s, n, 3).
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.shape = tuple(np.load(path, mmap_mode="r", allow_pickle=False).shape)

    def __len__(self) -> int:
        return int(self.shape[0])

    def __getitem__(self, key: slice | int) -> Float[np.ndarray, "... n 3"]:
        """Some shapes, or one."""
        # Mapped anew each time: pages of a map that were read count as this process's memory.
        return np.array(np.load(self._path, mmap_mode="r", allow_pickle=False)[key])

    def __iter__(self) -> Iterator[Float[np.ndarray, "n 3"]]:
        return (self[number] for number in range(len(self)))
