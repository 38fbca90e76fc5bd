"""Reading ordinary files alone, and writing so that a half-written one, or half of several, is never left behind."""

from __future__ import annotations

import csv
import errno
import hashlib
import json
import os
import secrets
import shutil
import stat
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

from homolog.core.errors import ArgumentError

if TYPE_CHECKING:  # commands find out where files are before they load numpy
    import numpy as np
    from jaxtyping import Shaped

# Temporary files, each with the place that it is to take.
_Moves = dict[Path, Path]
_open_moves: ContextVar[_Moves | None] = ContextVar("open_moves", default=None)
# What begins so, spreadsheets take for a formula, and run it.
_FORMULAS = ("=", "+", "-", "@", "\t", "\r", "\n")


def expanded(path: str | Path) -> Path:
    """A path with ``~`` and ``~name`` replaced by a home folder, unless there is a file or folder of just this name.

    Raises:
        ArgumentError: if there is no such user.
    """
    given = Path(path)
    if given.parts[:1] and given.parts[0].startswith("~") and len(given.parts[0]) > 1 and is_there(given.parts[0]):
        return given
    try:
        return given.expanduser()
    except RuntimeError:
        raise ArgumentError(f"{path}: there is no such user's home folder; write the path out") from None


def is_there(path: str | Path) -> bool:
    """Whether a path leads to something; one that is too long, or a link to itself, does not."""
    try:
        return Path(path).exists()
    except (OSError, ValueError):
        return False


def opened(path: str | Path) -> BinaryIO:
    """An ordinary file, or a link to one, opened for reading; the one way in which files of others are opened.

    Raises:
        OSError: if it is not there, or cannot be read; and of a pipe or a device, which may never end.
    """
    descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    file = os.fdopen(descriptor, "rb")
    mode = os.fstat(descriptor).st_mode
    if stat.S_ISREG(mode):
        return file
    file.close()
    number = errno.EISDIR if stat.S_ISDIR(mode) else errno.EINVAL
    raise OSError(number, os.strerror(number) if stat.S_ISDIR(mode) else "it is not an ordinary file", str(path))


def ordinary(path: str | Path) -> Path:
    """A path of an ordinary file, for a library that opens it.

    Raises:
        OSError: as ``opened`` does.
    """
    opened(path).close()
    return Path(path)


def read_bytes(path: str | Path) -> bytes:
    """The content of an ordinary file.

    Raises:
        OSError: as ``opened`` does.
    """
    with opened(path) as file:
        return file.read()


def read_text(path: str | Path, *, encoding: str = "utf-8", errors: str = "strict") -> str:
    """The content of an ordinary file of text, with line feeds as its ends of lines.

    Raises:
        OSError: as ``opened`` does.
        UnicodeDecodeError: if it is no text in this encoding.
    """
    return read_bytes(path).decode(encoding, errors).replace("\r\n", "\n").replace("\r", "\n")


def parse_json(text: str | bytes) -> Any:
    """What a text of JSON holds.

    Raises:
        ValueError: if it is none, or its values lie too deep in each other.
    """
    try:
        return json.loads(text)
    except RecursionError:
        raise ValueError("its values lie too deep in each other") from None


def made_folder(path: str | Path) -> Path:
    """A folder, made if need be, with the folders above it; ``~`` is expanded.

    Raises:
        ArgumentError: if it cannot be made, or is a file.
    """
    folder = expanded(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ArgumentError(f"{path} cannot be made a folder ({error.strerror}); give another one") from None
    return folder


def refuse_overwriting_inputs(outputs: Iterable[str | Path], inputs: Iterable[str | Path]) -> None:
    """Refuse outputs that would replace an input, or a file in a folder that is an input.

    Files are compared by their identity, so that links, other spellings and relative paths are recognised. An output
    that does not exist yet replaces nothing, and may lie in an input folder.

    Args:
        outputs: files that are to be written.
        inputs: files and folders that are read; those that do not exist are passed over.

    Raises:
        ArgumentError: naming the first such output.

    Examples:
        >>> refuse_overwriting_inputs(["map.npz"], ["source.ply", "target.ply"])
    """
    read = [path for path in map(expanded, inputs) if path.exists()]
    for output in map(expanded, outputs):
        if not output.exists():
            continue
        for given in read:
            if given.samefile(output):
                raise ArgumentError(f"{output} is an input and would be replaced by the result; give another output")
            if given.is_dir() and any(folder.samefile(given) for folder in output.resolve().parents):
                raise ArgumentError(
                    f"{output} lies in the input {given} and would be replaced by the result; give another output"
                )


@contextmanager
def atomic_path(path: str | Path) -> Iterator[Path]:
    """Give a temporary path beside ``path`` that takes its place when the block ends well.

    On an error or an interrupt the temporary file is removed and ``path`` stays as it was. Who may read it is as with
    any file, whatever the library that writes it thinks: as before, or as the process makes new files.

    Args:
        path: the file to write; ``~`` is expanded, and a link is followed, not replaced.

    Yields:
        A path in the same folder with the same suffix. The block must create the file.

    Raises:
        ArgumentError: if the folder does not exist, or ``path`` is a folder.
    """
    target = expanded(path).resolve()
    if not target.parent.is_dir():
        raise ArgumentError(f"{path} cannot be written: the folder {target.parent} does not exist; create it first")
    if target.is_dir():
        raise ArgumentError(f"{path} cannot be written: it is a folder; give a file name")
    temporary = _beside(target)
    with all_or_nothing() as moves, _blamed(path):
        mode = _mode(target if target.exists() else temporary)
        moves[temporary] = target
        yield temporary
        temporary.chmod(mode)


def _mode(file: Path) -> int:
    """The permissions of a file, or those that it gets when it is made."""
    if file.exists():
        return stat.S_IMODE(file.stat().st_mode)
    file.touch()
    try:
        return stat.S_IMODE(file.stat().st_mode)
    finally:
        file.unlink()


@contextmanager
def all_or_nothing() -> Iterator[_Moves]:
    """Let the files that are written in this block by ``atomic_path`` land together when it ends well.

    They wait under their temporary names until then. On an error or an interrupt, even amid the landing, all of them
    stay as they were; only a process killed outright while it renames can leave some new and some old.
    """
    outer = _open_moves.get()
    if outer is not None:
        yield outer
        return
    moves: _Moves = {}
    token = _open_moves.set(moves)
    try:
        yield moves
        _land(moves)
    finally:
        _open_moves.reset(token)
        for temporary in moves:
            temporary.unlink(missing_ok=True)


def _land(moves: _Moves) -> None:
    with ExitStack() as always, ExitStack() as undo:
        # The last file needs no second name: once it has landed nothing is undone.
        for target in list(moves.values())[:-1]:
            former = _beside(target)
            always.callback(former.unlink, missing_ok=True)
            undo.callback(_restore, target, former, existed=_kept(target, former))
        for temporary, target in moves.items():
            with _blamed(target):
                temporary.replace(target)
        undo.pop_all()


def _kept(target: Path, former: Path) -> bool:
    """Give a file that is there a second name, so that it can be restored."""
    if not target.exists():
        return False
    try:
        former.hardlink_to(target)
    except OSError:  # some file systems have no second names
        with _blamed(target):
            shutil.copy2(target, former)
    return True


def _restore(target: Path, former: Path, *, existed: bool) -> None:
    if existed:
        former.replace(target)
    else:
        target.unlink(missing_ok=True)


def _beside(target: Path) -> Path:
    return target.with_name(f".{secrets.token_hex(6)}{target.suffix}")


@contextmanager
def _blamed(path: str | Path) -> Iterator[None]:
    """Turn what the system says against writing into one line about ``path``."""
    try:
        yield
    except OSError as error:
        raise ArgumentError(f"{path} cannot be written: {error.strerror or error}") from error


def write_json(path: str | Path, content: Any) -> None:
    """Write an object or a list for people and programs to read.

    Raises:
        ArgumentError: as ``atomic_path`` does.
    """
    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="utf-8", newline="\n")


def write_csv(path: str | Path, rows: Iterable[Sequence[Any]]) -> None:
    """Write rows of a table whole or not at all; None is an empty cell.

    Text that a spreadsheet would run as a formula, which the name of a file may look like, gets an apostrophe before
    it: spreadsheets take that for text. Numbers stay as they are, negative ones and those given as text, too.

    Raises:
        ArgumentError: as ``atomic_path`` does.
    """
    with atomic_path(path) as temporary, temporary.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([_harmless(cell) for cell in row] for row in rows)


def _harmless(cell: Any) -> Any:
    """A cell that no spreadsheet runs."""
    text = str(cell) if isinstance(cell, (str, Path)) else ""
    return f"'{text}" if text.startswith(_FORMULAS) and not _says_a_number(text) else cell


def _says_a_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def write_npy(path: str | Path, values: Shaped[np.ndarray, ...]) -> None:
    """Write an array of numbers whole or not at all, without pickles.

    Raises:
        ArgumentError: as ``atomic_path`` does.
    """
    import numpy as np

    with atomic_path(path) as temporary, temporary.open("wb") as file:
        np.save(file, values, allow_pickle=False)


def read_json(path: Path, *, needs: str) -> dict[str, Any] | None:
    """An object that has a certain key; None if the file holds anything else, or is not there."""
    try:
        content = parse_json(read_text(path))
    except (OSError, ValueError):
        return None
    return content if isinstance(content, dict) and needs in content else None


def sha256(*paths: str | Path) -> str:
    """SHA-256 of the bytes of a file, or of several one after the other, in hexadecimal.

    Raises:
        ArgumentError: if one cannot be read.
    """
    digest = hashlib.sha256()
    for path in paths:
        for chunk in _chunks(path):
            digest.update(chunk)
    return digest.hexdigest()


def _chunks(path: str | Path) -> Iterator[bytes]:
    try:
        with opened(expanded(path)) as file:
            while chunk := file.read(1 << 20):
                yield chunk
    except OSError as error:
        raise ArgumentError(f"{path} cannot be read: {error.strerror or error}") from error
