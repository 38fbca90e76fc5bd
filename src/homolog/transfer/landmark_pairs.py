"""Landmark files of two shapes as pairs that guide a match; indices of points as well."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Num

from homolog.core.array_files import ArrayFileError, read_npy
from homolog.core.choices import System
from homolog.core.errors import ArgumentError, DataError
from homolog.core.files import expanded, read_text
from homolog.core.messages import shorten
from homolog.core.reasons import reason_with_remedy
from homolog.pairs import LandmarkPairs
from homolog.transfer.landmarks import LANDMARK_SUFFIXES, read_landmarks, repeated_names

_INDEX = re.compile(r"-1|\d{1,18}")


@dataclass(frozen=True, eq=False)
class _Places:
    """Landmarks of one file: indices (p,) or positions (p, 3), with what the file says of them."""

    values: Num[np.ndarray, "p ..."]
    names: tuple[str, ...] = ()
    system: System | None = None


def read_landmark_pairs(
    source: str | Path, target: str | Path, *, axes: System | None = None, uncertainty: float = 0.0
) -> LandmarkPairs:
    """Read the landmarks of two shapes, each from a file, for ``homolog.match(..., landmarks=...)``.

    Landmarks are paired by their names where both files name them, and by their order otherwise. What one file lacks,
    or leaves undefined, is left out. Each file is one that ``read_landmarks`` reads; or holds indices of points from 0,
    one a line (``.txt``, ``.csv``), with -1 for a landmark that the shape lacks; or is a ``.npy`` of indices (p,) or
    positions (p, 3).

    Args:
        source: the file of the source's landmarks.
        target: of the target's.
        axes: the anatomical axes of both shapes, for landmark files that state theirs; by default those that the
            shapes' files state, or LPS.
        uncertainty: how far from the target's landmarks the source's may end, in the target's units.

    Raises:
        ArgumentError: if there are no pairs, or too many.
        DataError: if a file is missing or damaged, or both have names and one gives a name twice.

    Examples:
        >>> landmarks = read_landmark_pairs("a.mrk.json", "b.fcsv")  # doctest: +SKIP
        >>> homolog.match("a.ply", "b.ply", landmarks=landmarks)  # doctest: +SKIP
    """
    first, second = (_read(expanded(path), path, axes) for path in (source, target))
    if first.names and second.names:
        _check_names(source, first.names)
        _check_names(target, second.names)
    try:
        pairs = _by_name(first, second) if first.names and second.names else _in_order(first, second)
    except ArgumentError as error:
        raise ArgumentError(f"{source} and {target}: {error}") from None
    pairs = replace(pairs, axes=(first.system, second.system))
    return replace(pairs, uncertainties=(uncertainty,) * len(pairs)) if uncertainty else pairs


def _read(path: Path, named: str | Path, axes: System | None) -> _Places:
    if path.suffix.lower() == ".npy":
        return _Places(_read_array(path, named))
    indices = _read_indices(path) if path.suffix.lower() in (".txt", ".csv") else None
    if indices is not None:
        return _Places(indices)
    if not path.name.lower().endswith(LANDMARK_SUFFIXES):
        allowed = ", ".join((*LANDMARK_SUFFIXES, ".npy"))
        raise DataError(f"{named} has the suffix {path.suffix!r}, but landmarks must have one of {allowed}")
    found = read_landmarks(named)
    are_numbers = found.names == tuple(map(str, range(1, len(found.names) + 1)))  # which nameless landmarks get
    names = () if are_numbers else found.names
    if axes is not None:
        return _Places(found.points_in(axes), names)
    return _Places(found.points, names, found.system)


def _check_names(named: str | Path, names: tuple[str, ...]) -> None:
    if repeated := repeated_names(names):
        raise DataError(
            f"{named} has several landmarks of the same name, {shorten(', '.join(repeated), 100)}, but landmarks are "
            "paired by their names; give each its own, or remove the names of one file to pair them by their order"
        )


def _read_array(path: Path, named: str | Path) -> Num[np.ndarray, "p ..."]:
    try:
        return read_npy(path)
    except (OSError, ArrayFileError) as error:
        reason = reason_with_remedy(error, "write it anew with numpy.save, from an array of numbers")
        raise DataError(f"{named} cannot be read as landmarks: {reason}") from None


def _read_indices(path: Path) -> Num[np.ndarray, " p"] | None:
    """Indices of points, one a line; None where the file holds anything else."""
    try:
        lines = [line.partition("#")[0].strip() for line in read_text(path).splitlines()]
    except (OSError, UnicodeDecodeError):
        return None  # the reader of positions says what is wrong with the file
    rows = [line for line in lines if line]
    return np.array([int(row) for row in rows]) if rows and all(map(_INDEX.fullmatch, rows)) else None


def _by_name(first: _Places, second: _Places) -> LandmarkPairs:
    source, target = (dict(zip(one.names, one.values.tolist(), strict=True)) for one in (first, second))
    return LandmarkPairs.by_name(source, target)


def _in_order(first: _Places, second: _Places) -> LandmarkPairs:
    """Pairs by order; those that the longer file has behind the end of the other are left out."""
    count = max(len(first.values), len(second.values))
    names = max(first.names, second.names, key=len)
    source, target = (_padded(one.values, count) for one in (first, second))
    known: Any = {"source": source, "target": target, "names": names if len(names) == count else ()}
    return LandmarkPairs(**known)


def _padded(values: Num[np.ndarray, "p ..."], count: int) -> Num[np.ndarray, "q ..."]:
    """Landmarks with missing ones behind them."""
    missing = -1 if values.dtype.kind in "iu" else np.nan
    widths = [(0, count - len(values)), *[(0, 0)] * (values.ndim - 1)]
    padded: np.ndarray = np.pad(values, widths, constant_values=missing)
    return padded
