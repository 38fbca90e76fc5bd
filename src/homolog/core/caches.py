"""The folder of the operator cache and its bound, without what reads its entries."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from itertools import chain
from numbers import Real
from pathlib import Path
from typing import TypeVar

import platformdirs

from homolog.core.errors import ArgumentError, bad_value
from homolog.core.files import expanded

SUFFIX = ".safetensors"
"""Of every entry."""

_GIBIBYTE = 2**30
# Listing a folder of many entries takes seconds: it is done once a process has written this share of the bound.
_SHARE_UNSEEN = 0.01
# Bytes that this process has written into a folder since it listed it.
_unseen: dict[Path, int] = {}
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

    Entries lie in 256 folders, by the first two digits of their names, which are hexadecimal: where an entry lies
    follows from its name alone, and no folder holds too many.

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

    def entry(self, name: str) -> Path:
        """Where the entry of a name lies, if it is there."""
        return self.folder / name[:2] / (name + SUFFIX)

    def size(self) -> tuple[int, int]:
        """Number of entries and their bytes."""
        count = total = 0
        for _, size, _ in self._files(temporary=False):
            count, total = count + 1, total + size
        return count, total

    def make_room_for(self, written: Path) -> None:
        """``make_room``, if this process has written much since it last did, this entry included.

        Every process may so exceed the bound by a hundredth.
        """
        new = _unseen[self.folder] + written.stat().st_size if self.folder in _unseen else None
        if new is not None and new < _SHARE_UNSEEN * self.max_bytes:
            _unseen[self.folder] = new
        else:
            self.make_room()
            _unseen[self.folder] = 0

    def make_room(self) -> None:
        """Remove the entries that were not used for longest, until the folder is within its bound."""
        excess = self.size()[1] - self.max_bytes
        self._clear_abandoned()
        if excess <= 0:  # then nothing of each entry needs to be remembered
            return
        for _, size, path in sorted(self._files(temporary=False)):
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
        folders = (self.folder, *self.folder.glob("[0-9a-f]" * 2))  # earlier versions had them in the folder itself
        for path in chain.from_iterable(folder.glob("*" + SUFFIX) for folder in folders if folder.is_dir()):
            if path.name.startswith(".") == temporary:
                with suppress(OSError):
                    status = path.stat()
                    yield status.st_mtime, status.st_size, path
