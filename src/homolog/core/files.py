"""Reading ordinary files alone, and writing so that a half-written one, or half of several, is never left behind."""

from __future__ import annotations

import csv
import errno
import hashlib
import json
import os
import platform
import re
import secrets
import shutil
import stat
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass, field, replace
from functools import cache
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, TextIO

from homolog.core.errors import ArgumentError, bad_value

if TYPE_CHECKING:  # commands find out where files are before they load numpy
    import numpy as np
    from jaxtyping import Shaped

# Temporary files, each with the place that it is to take.
_Moves = dict[Path, Path]
_open_moves: ContextVar[_Moves | None] = ContextVar("open_moves", default=None)
# Of all threads, for an end that no thread can be waited for.
_temporary_files: set[Path] = set()
# Machine, process and the second in which it began, so that another process can tell whether its writer still lives.
_TEMPORARY_NAME = re.compile(r"\.homolog-([0-9a-f]{8})-(\d+)-(\d+)-[0-9a-f]{12}(\..*)?", re.DOTALL)
# The second in which a process began follows from the machine's clock, which may be set meanwhile.
_CLOCK_SECONDS = 5
PATH_NEEDED = "a path to a file or folder; the current folder is '.'"
"""What to say of an empty path, which ``pathlib`` takes for the current folder."""
# What begins so, spreadsheets take for a formula, and run it.
_FORMULAS = ("=", "+", "-", "@", "\t", "\r", "\n")


def expanded(path: str | Path) -> Path:
    """A path with ``~`` and ``~name`` replaced by a home folder, unless there is a file or folder of just this name.

    Raises:
        ArgumentError: if it is no path, or there is no such user.
    """
    if path == "":
        raise bad_value("path", path, PATH_NEEDED)
    if not isinstance(path, str | PathLike):
        raise bad_value("path", path, "a path, that is a str or a pathlib.Path")
    given = Path(path)
    if given.parts[:1] and given.parts[0].startswith("~") and len(given.parts[0]) > 1 and is_there(given.parts[0]):
        return given
    try:
        return given.expanduser()
    except RuntimeError:
        raise ArgumentError(f"{path}: there is no such user's home folder; write the path out") from None


def resolved(path: str | Path) -> Path:
    """A path without links and ``..``, with ``~`` replaced; what it leads to need not exist.

    Raises:
        ArgumentError: if a link in it leads to itself.
    """
    try:
        place = expanded(path).resolve()
    except (RuntimeError, OSError):  # which Python 3.13 no longer raises
        place = expanded(path)
    if place.is_symlink():
        raise ArgumentError(f"{path} is a link that leads to itself, or cannot be followed; give another path")
    return place


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


def read_bytes(path: str | Path, *, first: int = -1) -> bytes:
    """The content of an ordinary file, or the ``first`` bytes of it.

    Raises:
        OSError: as ``opened`` does.
    """
    with opened(path) as file:
        return file.read(first)


def read_text(path: str | Path, *, errors: str = "strict") -> str:
    """The content of an ordinary file of text in UTF-8, without its mark, with line feeds as its ends of lines.

    Raises:
        OSError: as ``opened`` does.
        UnicodeDecodeError: if it is no such text.
    """
    return read_bytes(path).decode("utf-8-sig", errors).replace("\r\n", "\n").replace("\r", "\n")


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


@dataclass(frozen=True)
class _Kept:
    """What ``keeping`` keeps: its inputs, the folder that is the writer's own, and what was written since."""

    inputs: tuple[Path, ...]
    own: Path | None = None
    written: set[Path] = field(default_factory=set)

    def owns(self, target: Path, given: Path) -> bool:
        """Whether a file lies in the writer's own folder, below an input."""
        return self.own is not None and self.own in target.parents and resolved(given) in self.own.parents


_keeping: ContextVar[_Kept | None] = ContextVar("keeping", default=None)


@contextmanager
def keeping(inputs: Iterable[str | Path]) -> Iterator[None]:
    """Let nothing that is written in this block replace an input, whoever writes it.

    Each command runs in such a block, with what its arguments name. ``atomic_path`` refuses such files, and so does
    ``refuse_overwriting_inputs`` before any work is done.

    Args:
        inputs: files and folders that are read.

    Examples:
        >>> with keeping(["source.ply"]):
        ...     write_json("figures.json", {})  # doctest: +SKIP
    """
    token = _keeping.set(_Kept(tuple(map(expanded, inputs))))
    try:
        yield
    finally:
        _keeping.reset(token)


@contextmanager
def resuming(folder: str | Path) -> Iterator[None]:
    """Within ``keeping``, let a folder below an input folder be the writer's own, of an earlier run that goes on."""
    kept = _keeping.get() or _Kept(())
    token = _keeping.set(replace(kept, own=resolved(folder)))
    try:
        yield
    finally:
        _keeping.reset(token)


def refuse_overwriting_inputs(outputs: Iterable[str | Path], inputs: Iterable[str | Path] = ()) -> None:
    """Refuse outputs that would replace an input, or a file in a folder that is an input.

    Files are compared by their identity, so that links of both kinds, other spellings and relative paths are
    recognised. An output that does not exist yet replaces nothing, and may lie in an input folder.

    Args:
        outputs: files that are to be written, or removed.
        inputs: files and folders that are read, beside those of ``keeping``; those that do not exist are passed over.

    Raises:
        ArgumentError: naming the first such output.

    Examples:
        >>> refuse_overwriting_inputs(["map.npz"], ["source.ply", "target.ply"])
    """
    kept = _keeping.get() or _Kept(())
    read = [path for path in (*map(expanded, inputs), *kept.inputs) if is_there(path)]
    known, folders = {_file_identity(path) for path in read}, [path for path in read if path.is_dir()]
    for output in map(expanded, outputs):
        target = resolved(output)
        if not output.exists() or target in kept.written:
            continue
        if _file_identity(output) in known:
            raise ArgumentError(f"{output} is an input and would be replaced by the result; give another output")
        for given in folders:
            if not kept.owns(target, given) and _lies_in(target, given):
                raise ArgumentError(
                    f"{output} lies in the input {given} and would be replaced by the result; give another output"
                )


def _file_identity(path: Path) -> tuple[int, int]:
    """Tells a file from all others, by whatever name; a set of many is searched at once."""
    status = path.stat()
    return status.st_dev, status.st_ino


def _lies_in(target: Path, folder: Path) -> bool:
    """Whether a file lies in a folder or below it, be it by another name for the same content."""
    if any(parent.samefile(folder) for parent in target.parents):
        return True
    status = target.stat()
    may_be_linked = status.st_nlink > 1 and stat.S_ISREG(status.st_mode)
    return may_be_linked and any(path.is_file() and target.samefile(path) for path in folder.rglob("*"))


def remove(path: Path) -> None:
    """Remove a file of an earlier result, if it is there.

    Raises:
        ArgumentError: if it is an input, as ``refuse_overwriting_inputs`` has it.
    """
    refuse_overwriting_inputs([path])
    path.unlink(missing_ok=True)


@contextmanager
def atomic_path(path: str | Path) -> Iterator[Path]:
    """Give a temporary path beside ``path`` that takes its place when the block ends well.

    On an error or an interrupt the temporary file is removed and ``path`` stays as it was. What a killed process has
    left, the next one that writes into the folder removes. Who may read it is as with any file, whatever the library
    that writes it thinks: as before, or as the process makes new files.

    Args:
        path: the file to write; ``~`` is expanded, and a link is followed, not replaced.

    Yields:
        A path in the same folder with the same suffix. The block must create the file.

    Raises:
        ArgumentError: if the folder does not exist, ``path`` is a folder, or an input that ``keeping`` keeps.
    """
    target = resolved(path)
    if not target.parent.is_dir():
        raise ArgumentError(f"{path} cannot be written: the folder {target.parent} does not exist; create it first")
    if target.is_dir():
        raise ArgumentError(f"{path} cannot be written: it is a folder; give a file name")
    refuse_overwriting_inputs([path])
    if kept := _keeping.get():
        kept.written.add(target)
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
            _removed(temporary)


@contextmanager
def written_together(
    folder: str | Path, names: Iterable[str], inputs: Iterable[str | Path] = ()
) -> Iterator[list[Path]]:
    """Give the paths of a result's files; those that are written in this block land together, whole or not at all.

    Args:
        folder: where to; it is made, and so are folders within it that names have.
        names: of the files, relative to it.
        inputs: files that are read, which are not to be replaced.

    Raises:
        ArgumentError: if the folder cannot be made or written to, or a file in it is an input.

    Examples:
        >>> with written_together("result", ["points.npy", "report.json"]) as paths:  # doctest: +SKIP
        ...     write_npy(paths[0], points)
        ...     write_json(paths[1], {})
    """
    paths = [expanded(folder) / name for name in names]
    refuse_overwriting_inputs(paths, inputs)
    for parent in dict.fromkeys(path.parent for path in paths):
        made_folder(parent)
    with all_or_nothing():
        yield paths


def _land(moves: _Moves) -> None:
    with ExitStack() as always, ExitStack() as undo:
        # The last file needs no second name: once it has landed nothing is undone.
        for target in list(moves.values())[:-1]:
            former = _beside(target)
            always.callback(_removed, former)
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
    """A name in the same folder for a temporary file of this process."""
    remove_abandoned(target.parent)
    process = os.getpid()
    temporary = target.with_name(
        f".homolog-{_machine()}-{process}-{_began(process)}-{secrets.token_hex(6)}{target.suffix}"
    )
    _temporary_files.add(temporary)
    return temporary


def _removed(temporary: Path) -> None:
    temporary.unlink(missing_ok=True)
    _temporary_files.discard(temporary)


def remove_temporary_files() -> None:
    """Remove what this process is writing, before it ends at once; nothing that it writes may go on after that."""
    for temporary in list(_temporary_files):
        with suppress(OSError):
            temporary.unlink()


def remove_abandoned(folder: Path) -> None:
    """Remove temporary files that killed processes of this machine have left in a folder."""
    _remove_abandoned(folder, os.getpid())


def remove_abandoned_below(folder: Path) -> None:
    """Remove what ``remove_abandoned`` removes in a folder and in all folders below it, again if need be."""
    _remove_abandoned.cache_clear()
    if folder.is_dir():
        for each in (folder, *(path for path in folder.rglob("*") if path.is_dir())):
            remove_abandoned(each)


@cache
def _remove_abandoned(folder: Path, process: int) -> None:
    """Once for each process."""
    with suppress(OSError):  # of a folder that may be written to, but not listed
        for path in folder.glob(".homolog-*"):
            named = _TEMPORARY_NAME.fullmatch(path.name)
            if named and named[1] == _machine() and not _lives(int(named[2]), int(named[3])):
                path.unlink(missing_ok=True)


def _lives(process: int, began: int) -> bool:
    """Whether a process is still there, and not another one under its number."""
    import psutil

    try:
        found = psutil.Process(process)
        return found.status() != psutil.STATUS_ZOMBIE and abs(found.create_time() - began) <= _CLOCK_SECONDS
    except psutil.NoSuchProcess:
        return False
    except psutil.AccessDenied:  # it is somebody else's
        return True


@cache
def _began(process: int) -> int:
    """The second in which this process began."""
    import psutil

    return int(psutil.Process(process).create_time())


@cache
def _machine() -> str:
    """Tells apart machines that share a disk, and containers, whose processes have numbers of their own."""
    numbers = Path("/proc/self/ns/pid")
    container = numbers.stat().st_ino if numbers.exists() else 0
    return hashlib.sha256(f"{platform.node()} {container}".encode()).hexdigest()[:8]


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


def open_text(path: Path) -> TextIO:
    """Open a new file of UTF-8 text with lines that end alike everywhere; names that are no UTF-8 keep their bytes."""
    return path.open("w", encoding="utf-8", errors="surrogateescape", newline="")


def write_csv(path: str | Path, rows: Iterable[Sequence[Any]]) -> None:
    """Write rows of a table whole or not at all; None is an empty cell.

    Text that a spreadsheet would run as a formula, which the name of a file may look like, gets an apostrophe before
    it: spreadsheets take that for text. Numbers stay as they are, negative ones and those given as text, too.

    Raises:
        ArgumentError: as ``atomic_path`` does.
    """
    with atomic_path(path) as temporary, open_text(temporary) as file:
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


def write_npy_rows(path: str | Path, rows: Iterable[np.ndarray], count: int) -> Path:
    """Write rows of an array of float64, one after the other, as ``write_npy`` writes all of them.

    Args:
        path: of the file.
        rows: of one shape, at least one.
        count: how many there are.

    Returns:
        Where the array is until all files of ``all_or_nothing`` land, or else ``path``.

    Raises:
        ArgumentError: as ``atomic_path`` does.
    """
    import numpy as np

    with atomic_path(path) as temporary, temporary.open("wb") as file:
        for number, row in enumerate(rows):
            if number == 0:
                header = {"descr": "<f8", "fortran_order": False, "shape": (count, *row.shape)}
                np.lib.format.write_array_header_1_0(file, header)
            file.write(np.ascontiguousarray(row, dtype="<f8").tobytes())
    return temporary if temporary.exists() else resolved(path)


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
