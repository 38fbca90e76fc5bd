"""The folder of the operator cache and its bound, without what reads its entries."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from numbers import Real
from pathlib import Path
from typing import TypeVar

import platformdirs

from homolog.core.errors import ArgumentError, bad_value
from homolog.core.files import expanded

SUFFIX = ".safetensors"
"""Of every entry."""

_GIBIBYTE = 2**30
# Seconds after which a file that was never written to its end is one that a killed process left.
_ABANDONED = 24 * 3600

C = TypeVar("C", bound="CacheFolder")


def cache_folder() -> Path:
    """Where operators are kept: the environment variable ``HOMOLOG_CACHE``, or the platform's cache folder."""
    chosen = os.environ.get("HOMOLOG_CACHE")
    return expanded(chosen) if chosen else Path(platformdirs.user_cache_dir("homolog"))


@dataclass(frozen=True)
class CacheFolder:
    """A folder of files that is bounded: when it outgrows that, the files not used for longest are removed.

    Args:
        folder: where to keep entries; made on first use.
        max_bytes: bound on the folder's size.
    """

    folder: Path
    max_bytes: int = 10 * _GIBIBYTE

    def __post_init__(self) -> None:
        object.__setattr__(self, "folder", expanded(self.folder))
        most: object = self.max_bytes
        if not isinstance(most, Real) or float(most) < 0:
            raise bad_value("max_bytes", most, "a number of bytes of at least 0")

    @classmethod
    def default(cls: type[C]) -> C:
        """The cache in the default folder; ``HOMOLOG_CACHE_GB`` changes its bound of 10 GB.

        Raises:
            ArgumentError: if ``HOMOLOG_CACHE_GB`` is not a number.
        """
        given = os.environ.get("HOMOLOG_CACHE_GB", "10")
        try:
            max_bytes = int(float(given) * _GIBIBYTE)
        except (ValueError, OverflowError):  # the latter from an infinite one
            raise ArgumentError(f"HOMOLOG_CACHE_GB is {given!r}, but must be a number of gigabytes") from None
        return cls(cache_folder(), max_bytes=max_bytes)

    def size(self) -> tuple[int, int]:
        """Number of entries and their bytes."""
        sizes = [size for _, size, _ in self._files(temporary=False)]
        return len(sizes), sum(sizes)

    def make_room(self) -> None:
        """Remove the entries that were not used for longest, until the folder is within its bound."""
        entries = sorted(self._files(temporary=False))
        excess = sum(size for _, size, _ in entries) - self.max_bytes
        self._clear_abandoned()
        for _, size, path in entries:
            if excess <= 0:
                return
            with suppress(OSError):
                path.unlink()
            excess -= size

    def _clear_abandoned(self) -> None:
        for used, _, path in self._files(temporary=True):
            if used < time.time() - _ABANDONED:
                with suppress(OSError):
                    path.unlink()

    def _files(self, *, temporary: bool) -> Iterator[tuple[float, int, Path]]:
        """Time of last use, bytes and path of each entry, or of each file that ``atomic_path`` is writing.

        Names of the latter begin with a dot. Another process may remove some meanwhile.
        """
        for path in self.folder.glob("*" + SUFFIX) if self.folder.is_dir() else ():
            if path.name.startswith(".") == temporary:
                with suppress(OSError):
                    status = path.stat()
                    yield status.st_mtime, status.st_size, path
