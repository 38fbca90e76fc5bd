"""The temporary folder of a server, and removing those of servers that were killed."""

from __future__ import annotations

import os
import shutil
import stat
import sys
import tempfile
from contextlib import suppress
from pathlib import Path

from filelock import FileLock

_PREFIX = "homolog-serve-"
_LOCK, _MARK, _KEPT = "lock", "removed-if-not-locked", "matches"


class ServerFolder:
    """A temporary folder, removed at the end of a ``with`` block.

    A server that is killed leaves its folder, and the system lets go of the lock in it: the next one made removes it.
    """

    def __init__(self) -> None:
        _remove_abandoned()
        self._temporary = tempfile.TemporaryDirectory(prefix=_PREFIX, ignore_cleanup_errors=True)
        root = Path(self._temporary.name)
        self._lock = _lock_of(root)
        with suppress(OSError, NotImplementedError):  # a disk without locks: no server will think it left
            self._lock.acquire()
            (root / _MARK).touch()  # not before it is locked: what is marked and not locked is no one's
        self.path = root / _KEPT
        self.path.mkdir(mode=0o700)

    def __enter__(self) -> Path:
        return self.path

    def __exit__(self, *_: object) -> None:
        self._lock.release()  # some systems remove no file that is open
        self._temporary.cleanup()


def _remove_abandoned() -> None:
    """Remove the folders of this user's servers that were killed."""
    for folder in Path(tempfile.gettempdir()).glob(f"{_PREFIX}*"):
        with suppress(OSError, NotImplementedError):
            if _is_own(folder) and _is_abandoned(folder):
                shutil.rmtree(folder, ignore_errors=True)


def _is_own(folder: Path) -> bool:
    """Whether a server of this user made it; a link that someone laid is none."""
    found = folder.lstat()
    own = sys.platform == "win32" or found.st_uid == os.getuid()
    return own and stat.S_ISDIR(found.st_mode) and (folder / _MARK).is_file()


def _is_abandoned(folder: Path) -> bool:
    """Whether no one holds it; no one ever will again, as each server makes its own."""
    try:
        with _lock_of(folder):
            return True
    except TimeoutError:
        return False


def _lock_of(folder: Path) -> FileLock:
    # Servers end in other threads than they began in.
    return FileLock(folder / _LOCK, blocking=False, thread_local=False)
