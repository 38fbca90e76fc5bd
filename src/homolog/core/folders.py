"""Output folders that are filled step by step, and can be resumed with the same settings only."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from typing_extensions import TypedDict

from homolog.core.errors import ArgumentError
from homolog.core.files import made_folder, remove_abandoned, write_json
from homolog.core.records import record, stored_record

MANIFEST = "manifest.json"
"""The file that says what is made in a folder and how; it exists from the start, and is completed at the end."""


@record
class _Manifest(TypedDict):
    making: dict[str, Any]


def prepare_folder(root: Path, manifest: dict[str, Any], folders: Sequence[str], *, what: str = "a dataset") -> None:
    """Create an output folder, or check that an existing one was begun with the same settings.

    Args:
        root: the folder.
        manifest: its first content; all settings that its files depend on are under the key ``making``.
        folders: to create within it.
        what: is made there, for messages.

    Raises:
        ArgumentError: if it holds other files, or was begun with other settings, or cannot be written to; nothing is
            changed then.
    """
    begun = stored_record(root / MANIFEST, _Manifest)
    if begun is None:
        if root.exists() and not _is_unused(root, folders):
            raise ArgumentError(f"{root} holds other things; give another folder with -o, a new or an empty one")
    elif different := _differences(begun["making"], manifest["making"]):
        raise ArgumentError(
            f"{root} holds {what} made in another way ({different}); give the same settings, or another folder with -o"
        )
    for folder in folders:
        made_folder(root / folder)
    if begun is None:
        write_json(root / MANIFEST, manifest)


def _is_unused(root: Path, folders: Sequence[str]) -> bool:
    """Whether a folder holds no more than what a process can have left that was killed before it wrote the manifest."""
    if not root.is_dir():
        return False
    remove_abandoned(root)
    ours = {root / name for name in folders}
    return all(path in ours and path.is_dir() and not any(path.iterdir()) for path in root.iterdir())


@contextmanager
def remove_if_unused(root: Path, folders: Sequence[str]) -> Iterator[None]:
    """Remove new folders without files when the block, which calls ``prepare_folder``, ends with an error.

    Args:
        root: the folder.
        folders: those within it that ``prepare_folder`` creates.
    """
    new = [path for path in (root, *root.parents) if not path.exists()]
    begun = (root / MANIFEST).exists()
    try:
        yield
    except BaseException:
        if not begun:
            _remove_unused(root, folders, new)
        raise


def _remove_unused(root: Path, folders: Sequence[str], new: Sequence[Path]) -> None:
    """Remove what ``prepare_folder`` created, if nothing else is there, and the new folders above it."""
    with suppress(OSError):  # the first that is not there, or not empty, ends it
        for name in folders:
            (root / name).rmdir()
        if {path.name for path in root.iterdir()} == {MANIFEST}:
            (root / MANIFEST).unlink()
        for path in new:
            path.rmdir()


def _differences(begun: dict[str, Any], given: dict[str, Any]) -> str:
    return ", ".join(
        key if isinstance(value, dict) else f"{key} {begun.get(key)}, not {value}"
        for key, value in given.items()
        if begun.get(key) != value
    )
