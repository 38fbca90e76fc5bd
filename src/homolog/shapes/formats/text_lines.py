"""Text files of numbers: read block by block, so that no more of the text is held than a block of lines."""

from __future__ import annotations

import codecs
import re
from array import array
from collections.abc import Iterable, Iterator, Sequence
from io import TextIOWrapper
from itertools import chain, islice
from pathlib import Path
from typing import NoReturn, TypeVar

import numpy as np
from jaxtyping import Int

from homolog.core.files import opened
from homolog.core.messages import shorten
from homolog.shapes.formats.parsing import CUT_OFF, UnreadableError, check_claim

T = TypeVar("T")

# Characters read at a time, and lines made numbers at a time.
_BLOCK, _LINES = 2**20, 2**14
# The end of a line that goes on; some programs write blanks behind the backslash, at most as many as are looked at.
_GOES_ON, _BLANKS = re.compile(r"\\[ \t]*\n\Z"), 100


def encoding_of(head: bytes) -> str:
    """The encoding of a text, by the byte order mark that its first bytes may be; UTF-8 without one."""
    if head.startswith((codecs.BOM_UTF32_LE, codecs.BOM_UTF32_BE)):  # the former begins as UTF-16 does
        return "utf-32"
    return "utf-16" if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)) else "utf-8-sig"


def mark_length(head: bytes) -> int:
    """The bytes of a byte order mark before a header, which some editors write; 0 without one.

    Raises:
        UnreadableError: for text whose characters are not bytes.
    """
    if (encoding := encoding_of(head)) != "utf-8-sig":
        raise UnreadableError(f"it is {encoding.upper()} text, but UTF-8 is needed; save it as UTF-8")
    return len(codecs.BOM_UTF8) if head.startswith(codecs.BOM_UTF8) else 0


def text_blocks(path: Path, *, start: int = 0, padded: bool = False) -> Iterator[str]:
    """The text of a file in blocks of whole lines, which end with line feeds; UTF-16 and UTF-32 by their marks.

    A line that ends with a backslash, and perhaps blanks, is in one block with the next one.

    Args:
        path: the file.
        start: the bytes to pass over.
        padded: whether the file is padded with zeros, which are left out then.

    Raises:
        UnreadableError: if it holds zeros otherwise, as binary files do.
    """
    with opened(path) as file:
        file.seek(start)
        encoding = encoding_of(file.read(4))
        file.seek(start)
        text = TextIOWrapper(file, encoding, errors="replace")
        while block := text.read(_BLOCK):
            parts = [block, text.readline()]
            while _GOES_ON.search((parts[-2][-_BLANKS:] + parts[-1])[-_BLANKS:]):  # also where a block ends within
                parts.append(text.readline())
            whole = "".join(parts)
            if "\0" in whole and not (padded or encoding != "utf-8-sig"):
                raise UnreadableError("it holds binary data where text is expected; check the suffix")
            yield whole.replace("\0", "") if padded else whole


def text_lines(path: Path, *, start: int = 0, padded: bool = False) -> Iterator[str]:
    """The lines of a text file without ``#`` comments, surrounding blanks and empty lines; as ``text_blocks`` else."""
    return chain.from_iterable(map(content_lines, text_blocks(path, start=start, padded=padded)))


def content_lines(text: str) -> list[str]:
    """The lines of a text without ``#`` comments, surrounding blanks and empty lines."""
    lines: Iterable[str] = text.splitlines()
    if "#" in text:
        lines = (line.partition("#")[0] for line in lines)
    return list(filter(None, map(str.strip, lines)))


def n_lines(lines: Iterable[str]) -> int:
    """The number of lines, which are not kept."""
    return sum(1 for _ in lines)


def batches(lines: Iterable[T]) -> Iterator[list[T]]:
    """Lists of lines, or of statements, that are made numbers at a time."""
    rest = iter(lines)
    while batch := list(islice(rest, _LINES)):
        yield batch


Polygons = tuple[Int[np.ndarray, " m"], Int[np.ndarray, " c"]]
"""The corners of each polygon, counted, and all corners, one polygon after the other."""


class GrowingArray:
    """Numbers that are appended batch by batch, where concatenating batches would hold all of them twice."""

    def __init__(self, dtype: type) -> None:
        self._dtype, self._numbers = dtype, array("d" if dtype is np.float64 else "q")

    def __len__(self) -> int:
        return len(self._numbers)

    def append(self, numbers: np.ndarray) -> None:
        """Append numbers of this type, in the order of their rows."""
        self._numbers.frombytes(numbers.astype(self._dtype, copy=False).tobytes())

    def rows(self, width: int) -> np.ndarray:
        """All numbers in rows, without a copy; nothing can be appended any more."""
        return np.asarray(self._numbers).view(self._dtype).reshape(-1, width)


def number_rows(
    lines: Iterable[str], columns: Sequence[int], dtype: type = np.float64, delimiter: str | None = None
) -> np.ndarray:
    """Read the given columns of lines of numbers; a line that does not hold them is quoted in the error."""
    numbers = GrowingArray(dtype)
    for batch in batches(lines):
        numbers.append(_numbers(batch, columns, dtype, delimiter))
    return numbers.rows(len(columns))


def _numbers(lines: list[str], columns: Sequence[int], dtype: type, delimiter: str | None = None) -> np.ndarray:
    try:
        return _loaded(lines, columns, dtype, delimiter)
    except (ValueError, OverflowError):
        _blame_line(lines, columns, dtype, delimiter)


def _loaded(lines: list[str], columns: Sequence[int], dtype: type, delimiter: str | None) -> np.ndarray:
    return np.loadtxt(lines, dtype=dtype, delimiter=delimiter, usecols=columns, ndmin=2, comments=None, quotechar='"')


def _blame_line(lines: list[str], columns: Sequence[int], dtype: type, delimiter: str | None) -> NoReturn:
    """Name the first line that NumPy does not read, which alone decides: Python takes 1_000 for a number."""
    kind = "whole numbers" if dtype is np.int64 else "numbers"
    faulty = (line for line in lines if not _is_read(line, columns, dtype, delimiter))
    if line := next(faulty, None):
        raise UnreadableError(_fault_of(line, columns, kind, delimiter)) from None
    raise UnreadableError(f"its lines do not all hold {kind}; {CUT_OFF}") from None


def _is_read(line: str, columns: Sequence[int], dtype: type, delimiter: str | None) -> bool:
    try:
        _loaded([line], columns, dtype, delimiter)
    except (ValueError, OverflowError):
        return False
    return True


def _fault_of(line: str, columns: Sequence[int], kind: str, delimiter: str | None) -> str:
    """Why a line does not hold its numbers."""
    cells = line.split(delimiter)
    if len(cells) <= max(columns):
        return f"the line {shorten(line)!r} has {len(cells)} values, too few; {CUT_OFF}"
    if kind == "whole numbers" and all(re.fullmatch(r"[-+]?[0-9]+", cells[column].strip('" ')) for column in columns):
        return (
            f"the line {shorten(line)!r} holds a number that is too large, of more than 64 bits; correct or remove it"
        )
    return f"the line {shorten(line)!r} should hold {kind}; correct or remove it"


def polygon_rows(lines: Iterable[str], column: int = 0) -> Polygons:
    """Polygons of lines that hold, from ``column`` on, a number of corners and then as many corners."""
    all_sizes, all_corners = GrowingArray(np.int64), GrowingArray(np.int64)
    for batch in batches(lines):
        sizes = _numbers(batch, (column,), np.int64)[:, 0]
        if sizes.min() < 0:
            raise UnreadableError("a face has a negative number of corners")
        check_claim(int(sizes.max()), "corners of one face", 2, max(map(len, batch)))
        all_sizes.append(sizes)
        all_corners.append(polygon_corners(batch, sizes, column + 1))
    return all_sizes.rows(1)[:, 0], all_corners.rows(1)[:, 0]


def polygon_corners(lines: list[str], sizes: Int[np.ndarray, " m"], column: int) -> Int[np.ndarray, " c"]:
    """The corners of all polygons, of which each line holds as many as ``sizes`` says, from ``column`` on."""
    corners = np.zeros(int(sizes.sum()), dtype=np.int64)
    starts = np.cumsum(sizes) - sizes
    for size in np.unique(sizes[sizes > 0]).tolist():
        (rows,) = np.nonzero(sizes == size)
        some = lines if len(rows) == len(lines) else [lines[i] for i in rows]
        corners[starts[rows][:, None] + np.arange(size)] = _numbers(some, range(column, column + size), np.int64)
    return corners
