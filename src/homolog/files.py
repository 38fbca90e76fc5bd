"""Writing files so that a half-written one is never left behind."""

from __future__ import annotations

import hashlib
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from homolog.errors import ArgumentError


@contextmanager
def atomic_path(path: str | Path) -> Iterator[Path]:
    """Give a temporary path beside ``path`` that takes its place when the block ends well.

    On an error or an interrupt the temporary file is removed and ``path`` stays as it was.

    Args:
        path: the file to write; ``~`` is expanded, and a link is followed, not replaced.

    Yields:
        A path in the same folder with the same suffix. The block must create the file.

    Raises:
        ArgumentError: if the folder does not exist, or ``path`` is a folder.
    """
    target = Path(path).expanduser().resolve()
    if not target.parent.is_dir():
        raise ArgumentError(f"{path} cannot be written: the folder {target.parent} does not exist; create it first")
    if target.is_dir():
        raise ArgumentError(f"{path} cannot be written: it is a folder; give a file name")
    temporary = target.with_name(f".{secrets.token_hex(6)}{target.suffix}")
    try:
        yield temporary
        temporary.replace(target)
    except OSError as error:
        raise ArgumentError(f"{path} cannot be written: {error.strerror or error}") from error
    finally:
        temporary.unlink(missing_ok=True)


def sha256(path: str | Path) -> str:
    """SHA-256 of a file's bytes, in hexadecimal."""
    digest = hashlib.sha256()
    with Path(path).expanduser().open("rb") as file:
        while chunk := file.read(1 << 20):
            digest.update(chunk)
    return digest.hexdigest()
