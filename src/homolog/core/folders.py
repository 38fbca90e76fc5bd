"""Folders that are made over a while: begun for one way of making, and gone on with in that way alone."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from homolog.core.errors import ArgumentError
from homolog.core.files import made_folder, read_json, write_json

MANIFEST = "manifest.json"
"""What is made in a folder, and how; there from the start, and complete once the whole is."""


def claim(root: Path, manifest: dict[str, Any], folders: Sequence[str], *, what: str = "a set") -> None:
    """Make a folder, or make sure that what is in it was begun in the same way.

    Args:
        root: the folder.
        manifest: what it is to say until the whole is complete; all that its files depend on is under ``making``.
        folders: to make within it.
        what: is made there, for messages.

    Raises:
        ArgumentError: if it holds another such whole or other things, or cannot be written to; nothing is changed then.
    """
    begun = read_json(root / MANIFEST, needs="making")
    if begun is None:
        if root.exists() and (not root.is_dir() or any(root.iterdir())):
            raise ArgumentError(f"{root} holds other things; give another folder with -o, a new or an empty one")
    elif different := _differences(begun["making"], manifest["making"]):
        raise ArgumentError(
            f"{root} holds {what} made in another way ({different}); give the same settings, or another folder with -o"
        )
    for folder in folders:
        made_folder(root / folder)
    if begun is None:
        write_json(root / MANIFEST, manifest)


@contextmanager
def unless_empty(root: Path, folders: Sequence[str]) -> Iterator[None]:
    """Around ``claim`` and the work: where it ends with an error or an interrupt, leave no folder in which nothing is.

    What was there before stays.

    Args:
        root: the folder.
        folders: those within it that ``claim`` makes.
    """
    new = [path for path in (root, *root.parents) if not path.exists()]
    begun = (root / MANIFEST).exists()
    try:
        yield
    except BaseException:
        if not begun:
            _take_back(root, folders, new)
        raise


def _take_back(root: Path, folders: Sequence[str], new: Sequence[Path]) -> None:
    """Take away what ``claim`` made, if there is nothing else, and folders above it that are new."""
    with suppress(OSError):  # the first that is not there, or not empty, ends it
        for name in folders:
            (root / name).rmdir()
        if {path.name for path in root.iterdir()} == {MANIFEST}:
            (root / MANIFEST).unlink()
        for path in new:
            path.rmdir()


def _differences(begun: Any, wanted: dict[str, Any]) -> str:
    if not isinstance(begun, dict):
        return "nothing tells how"
    return ", ".join(
        key if isinstance(value, dict) else f"{key} {begun.get(key)}, not {value}"
        for key, value in wanted.items()
        if begun.get(key) != value
    )
