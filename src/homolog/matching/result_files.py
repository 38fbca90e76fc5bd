"""A match on disk: the result folder, and point maps in the formats of other programs."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any
from warnings import catch_warnings, simplefilter

import numpy as np
import scipy.io
from jaxtyping import Int

from homolog.core.array_files import open_npz
from homolog.core.errors import ArgumentError, DataError, HomologError, bad_choice
from homolog.core.files import (
    all_or_nothing,
    atomic_path,
    expanded,
    made_folder,
    opened,
    ordinary,
    read_text,
    write_json,
)
from homolog.core.messages import shorten
from homolog.core.progress import Timings
from homolog.core.reader_process import read_in_process
from homolog.matching.colours import matched_colours
from homolog.matching.quality import MapQuality
from homolog.pairs import SIDES, Side
from homolog.shapes import Shape, drawable, read_shape, write_shape

if TYPE_CHECKING:
    from homolog.matching.result import Match

MAPS, REPORT = "correspondence.npz", "report.json"
RESULT_FILES = (MAPS, "source.ply", "target.ply", REPORT)
"""What a match writes into its folder."""

_ARRAYS = ("source_to_target", "target_to_source", "source_confidence", "target_confidence")
_DIRECTIONS = ("target_to_source", "source_to_target")
# The first index of each format, as other programs write it.
_BASES = {".npz": 0, ".mat": 1, ".txt": 0, ".vts": 1}
_MATLAB = Path(__file__).with_name("mat_process.py")
# No shape has so many points, and below it floating-point numbers are exact.
_TOO_LARGE = 2**53
# No coordinate whose square is no number can be matched.
_FARTHEST = 1e150


def write_folder(folder: str | Path, match: Match, *, timings: Timings | None = None) -> list[Path]:
    """Write ``correspondence.npz``, ``source.ply``, ``target.ply`` and ``report.json`` into a folder, made if need be.

    The shapes are as given, point by point, coloured so that the same colour means the same point; so that any program
    opens them, faces that repair drops are left out, and points without a position lie at the mean of the others. The
    four files land together once all are written; on an error or an interrupt an earlier result stays as it was. Other
    files are left alone.

    Args:
        folder: where to.
        match: what to write.
        timings: what was done before; the report tells of these, and of the writing of the other files as one more.

    Raises:
        ArgumentError: if the folder cannot be made or written to.
    """
    folder = made_folder(folder)
    paths = [folder / name for name in RESULT_FILES]
    with all_or_nothing():
        with (timings or Timings()).measure("write"):
            source_colours, target_colours = matched_colours(match)
            write_maps(paths[0], match)
            write_shape(paths[1], drawable(match.source), colours=source_colours)
            write_shape(paths[2], drawable(match.target), colours=target_colours)
        told: dict[str, Any] = {"method": match.method, "warnings": list(match.warnings)}
        if match.quality is not None:
            told["quality"] = match.quality.to_dict()
        if timings is not None:
            told["timings"] = [asdict(timing) for timing in timings.finished]
        write_json(paths[3], {**match.report, **told})
    return paths


def read_folder(folder: str | Path) -> dict[str, Any]:
    """What a result folder holds, as the arguments of ``Match``.

    Raises:
        DataError: if one of its files is missing or damaged.
        ShapeError: if a shape cannot be read.
    """
    root = expanded(folder)
    for name in RESULT_FILES:
        if not (root / name).is_file():
            raise DataError(f"{folder} has no {name}, so that it is no result; give a folder that homolog match wrote")
    report = _read_report(root / REPORT)
    return {
        "source": _read_shape(root, report, "source"),
        "target": _read_shape(root, report, "target"),
        **_read_arrays(root / MAPS),
        "method": report["method"],
        "warnings": tuple(report["warnings"]),
        "quality": _quality(root / REPORT, report),
        "report": report,
    }


def _read_shape(root: Path, report: dict[str, Any], side: Side) -> Shape:
    """One of the shapes, by the name of the file that was matched where the report tells it."""
    shape = read_shape(root / f"{side}.ply")
    if not (np.abs(shape.points) < _FARTHEST).all():
        raise DataError(f"{root / shape.name} has points that no match writes, infinite or beyond; match again")
    return replace(shape, name=matched_name(report, side, otherwise=shape.name))


def matched_name(report: Mapping[str, Any], side: Side, *, otherwise: str) -> str:
    """The name of the file that was matched, where the report of a match tells it."""
    given = report.get("inputs", {}).get(side, {})
    return PurePath(given.get("file", given.get("name", otherwise))).name


def _read_report(path: Path) -> dict[str, Any]:
    try:
        report: Any = json.loads(read_text(path))
    except (OSError, ValueError, RecursionError) as error:
        raise DataError(f"{path} cannot be read as the report of a match ({error}); match again") from None
    known = isinstance(report, dict) and isinstance(report.get("method"), str)
    inputs = report.get("inputs", {}) if known else None
    if not isinstance(inputs, dict) or not all(isinstance(inputs.get(side, {}), dict) for side in SIDES):
        raise DataError(f"{path} is not the report of a match; match again")
    warnings = report.setdefault("warnings", [])
    if not isinstance(warnings, list) or not all(isinstance(warning, str) for warning in warnings):
        raise DataError(f"{path} is not the report of a match; match again")
    return dict(report)


def _quality(path: Path, report: dict[str, Any]) -> MapQuality | None:
    try:
        return None if report.get("quality") is None else MapQuality.from_dict(report["quality"])
    except (KeyError, TypeError, ValueError):
        raise DataError(f"{path} has figures of quality that are not those of a match; match again") from None


def _read_arrays(path: Path) -> dict[str, np.ndarray]:
    try:
        with open_npz(path) as stored:
            missing = [name for name in _ARRAYS if name not in stored.names]
            arrays = {name: stored[name] for name in _ARRAYS if name not in missing}
    except Exception as error:  # whatever NumPy raises of a damaged file
        raise DataError(f"{path} cannot be read as the arrays of a match ({error}); match again") from None
    if missing:
        raise DataError(f"{path} has no array {missing[0]!r}; it must be what homolog match wrote")
    for name, array in arrays.items():
        trust = name.endswith("confidence")
        if array.ndim != 1 or array.dtype.kind != ("f" if trust else "i"):
            raise DataError(f"{path} holds arrays that are not those of a match; match again")
        if trust and not ((array >= 0) & (array <= 1)).all():
            raise DataError(f"{path}: {name} must lie between 0 and 1; match again")
    return arrays


def write_maps(path: str | Path, match: Match, *, base: int | None = None, direction: str = _DIRECTIONS[0]) -> Path:
    """Write the point maps as one file, by its suffix; see ``Match.save``. Written whole or not at all.

    Raises:
        ArgumentError: if there is no such format, base or direction.
    """
    suffix = _checked_suffix(path)
    base = _BASES[suffix] if base is None else base
    if base not in (0, 1):
        raise ArgumentError(f"base is {base!r}, but the first index must be 0 or 1")
    if direction not in _DIRECTIONS:
        raise bad_choice("direction", direction, _DIRECTIONS)
    arrays = {name: getattr(match, name) for name in _ARRAYS}
    shifted = {name: values + base if name in _DIRECTIONS else values for name, values in arrays.items()}
    # NumPy adds a suffix to a name that has none, but not to a file.
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        if suffix == ".npz":
            np.savez_compressed(file, allow_pickle=False, **shifted)
        elif suffix == ".mat":
            scipy.io.savemat(file, {**shifted, "first_index": base}, do_compression=True, oned_as="column")
        else:
            np.savetxt(file, shifted[direction], fmt="%d")
    return expanded(path)


def read_point_map(
    path: str | Path, *, base: int | None = None, direction: str = _DIRECTIONS[0]
) -> Int[np.ndarray, " n"]:
    """Read a point map that this or another program wrote: ``.npz``, ``.mat``, ``.txt``, ``.vts`` or ``.map``.

    Args:
        path: the file. Text holds an index per line; ``.npz`` and ``.mat`` an array called ``direction``, or one alone.
        base: the first index; by default 0 for ``.npz`` and ``.txt``, 1 for the others.
        direction: which map is meant, where a file holds both.

    Returns:
        Indices from 0, -1 for none (n,).

    Raises:
        DataError: if it cannot be read as such, or holds no whole numbers.

    Examples:
        >>> import numpy as np
        >>> from homolog.matching import read_point_map
        >>> np.savetxt("map.vts", [3, 1, 2], fmt="%d")
        >>> read_point_map("map.vts")
        array([2, 0, 1])
    """
    file = expanded(path)
    suffix = _checked_suffix(path, reading=True)
    try:
        if suffix == ".npz":
            with open_npz(file) as archive:
                values = _only(path, {name: archive[name] for name in archive.names}, direction)
        elif suffix == ".mat":
            stored = read_in_process(_MATLAB, ordinary(file), library="SciPy")
            first = stored.pop("first_index", None)
            base = int(first.item()) if base is None and first is not None else base
            named = {name: value for name, value in stored.items() if not name.startswith("_")}
            values = _only(path, named, direction)
        else:
            with catch_warnings():
                simplefilter("error")  # NumPy only warns of a file without a number
                with opened(file) as text:
                    values = np.loadtxt(text, ndmin=1)
    except HomologError:
        raise
    except Exception as error:  # whatever NumPy and SciPy raise of a damaged file
        raise DataError(f"{path} cannot be read as a point map ({shorten(error, 160)})") from None
    return _whole_numbers(path, values) - (_BASES.get(suffix, 1) if base is None else base)


def _only(path: str | Path, arrays: dict[str, Any], direction: str) -> Any:
    if direction in arrays:
        return arrays[direction]
    # A single number beside a map tells something of it, but a map of one point is a single number, too.
    maps = {name: array for name, array in arrays.items() if array.size > 1} or arrays
    if len(maps) == 1:
        return next(iter(maps.values()))
    raise DataError(f"{path} has no array {direction!r}, but {shorten(', '.join(sorted(arrays)), 100) or 'none'}")


def _whole_numbers(path: str | Path, given: Any) -> Int[np.ndarray, " n"]:
    values = np.asarray(given)
    if values.dtype.kind not in "iuf" or np.squeeze(values).ndim > 1:
        raise DataError(f"{path} does not hold one whole number per point, but {values.dtype} of shape {values.shape}")
    values = values.reshape(-1)
    (wrong,) = np.nonzero((values != np.round(values)) | ~(np.abs(values.astype(float)) < _TOO_LARGE))
    if len(wrong):
        raise DataError(f"{path} holds {values[wrong[0]]}, but must hold one whole number per point, its index")
    return values.astype(np.int64)


def _checked_suffix(path: str | Path, *, reading: bool = False) -> str:
    suffix = PurePath(path).suffix.lower()
    known = [*_BASES, ".map"] if reading else [*_BASES]
    if suffix not in known:
        raise bad_choice("suffix", suffix, known, "of a file; a path without one is a result folder")
    return suffix
