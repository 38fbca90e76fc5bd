"""A match on disk: the result folder, and point maps in the formats of other programs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Annotated, Any, Literal
from warnings import catch_warnings, simplefilter

import numpy as np
import scipy.io
from annotated_types import Ge, Gt, Le
from jaxtyping import Int
from typing_extensions import NotRequired, TypedDict

from homolog.core.arguments import check_choice, is_count
from homolog.core.array_files import open_npz
from homolog.core.errors import ArgumentError, DataError, HomologError, bad_value
from homolog.core.files import (
    all_or_nothing,
    atomic_path,
    expanded,
    opened,
    ordinary,
    resolved,
    sha256,
    write_json,
    written_together,
)
from homolog.core.messages import shorten
from homolog.core.progress import Timings
from homolog.core.reader_process import read_in_process
from homolog.core.reasons import reason_of
from homolog.core.records import read_record, record
from homolog.core.versions import versions
from homolog.features import NetworkInput
from homolog.matching.colours import matched_colours
from homolog.matching.quality import MapQuality
from homolog.pairs import SIDES, PairOptions, PartsFit, Side
from homolog.shapes import Finding, Modality, Shape, drawable, read_shape, write_shape

if TYPE_CHECKING:
    from homolog.matching.result import Match

MAPS, REPORT = "correspondence.npz", "report.json"
RESULT_FILES = (MAPS, "source.ply", "target.ply", REPORT)
"""What a match writes into its folder."""

_UNTIED = (
    f"{REPORT} does not say the hashes of the files beside it, so whether they belong together is not known; "
    "match again"
)
_ARRAYS = ("source_to_target", "target_to_source", "source_confidence", "target_confidence")
_DIRECTIONS = ("target_to_source", "source_to_target")
# The first index of each format, as other programs write it.
_BASES = {".npz": 0, ".mat": 1, ".txt": 0, ".vts": 1, ".map": 1}
_FIRST_INDEX = "first_index"
MAP_SUFFIXES = (*_BASES,)
"""The suffixes of files that point maps are read from."""
_MATLAB = Path(__file__).with_name("mat_process.py")
# No shape has so many points, and below it floating-point numbers are exact.
_TOO_LARGE = 2**53
# Of the entries of a rotation, which single precision computes.
_TURN_TOLERANCE = 1e-3
# No coordinate whose square is no number can be matched.
_FARTHEST = 1e150
_Count = Annotated[int, Ge(0)]


@dataclass(frozen=True)
class _Turn:
    """A rotation of a shape, by which it was turned."""

    rotation: list[list[float]]
    degrees: float = 0.0
    scale: Annotated[float, Gt(0)] = 1.0

    def __post_init__(self) -> None:
        found = np.array(self.rotation) if {*map(len, self.rotation)} == {3} else np.zeros((0, 3))
        bounded = found.shape == (3, 3) and (np.abs(found) < 2).all()  # products of others may be no numbers
        orthogonal = bounded and np.allclose(found @ found.T, np.eye(3), atol=_TURN_TOLERANCE)
        if not orthogonal or np.linalg.det(found) < 0:
            raise ValueError("rotation is no rotation matrix (3, 3)")


class _Orientation(TypedDict, total=False):
    source: _Turn
    target: _Turn
    misfit: float
    runner_up: float | None
    margin: float | None
    ambiguous: bool


class _Eigenpairs(TypedDict, total=False):
    number: _Count
    method: str


class _Input(TypedDict, total=False):
    """A shape as it was given: where it came from, and the report of its repair."""

    name: str
    file: str
    sha256: str
    modality: Modality
    n_points: _Count
    n_faces: _Count
    n_clean_points: _Count
    n_clean_faces: _Count
    extent: Annotated[float, Ge(0)] | None
    area: Annotated[float, Ge(0)] | None
    n_components: _Count | None
    n_boundary_loops: _Count | None
    findings: list[Finding]
    usable: bool
    eigenpairs: _Eigenpairs
    points_left_out: _Count
    mask: str
    space: Literal["RAS", "LPS"] | None


class _Timing(TypedDict):
    """As ``homolog.core.progress.Timing``."""

    name: str
    seconds: Annotated[float, Ge(0)]
    process_peak_mb: Annotated[float, Ge(0)]


class _Adaptation(TypedDict, total=False):
    """As ``homolog.pairs.PairAdaptation``."""

    steps: _Count
    map_misfit: float | None
    adapted_map_misfit: float | None
    kept: bool


class _Candidate(TypedDict):
    """As ``homolog.pairs.Candidate``."""

    name: str
    misfit: NotRequired[float | None]
    map_misfit: NotRequired[float | None]
    least_misfit: NotRequired[float | None]


class _Features(TypedDict, total=False):
    """As ``homolog.features.FeatureInfo``, whose fields may become more."""

    name: str
    licence: str
    input: NetworkInput
    upright: bool
    n_eigenpairs: _Count
    laplacian: str
    n_neighbours: _Count
    map_eigenpairs: _Count
    partial: bool
    near_isometric: bool
    temperature: Annotated[float, Gt(0)]
    most_misfit: Annotated[float, Gt(0)]
    sha256: str
    file: str


class _Inputs(TypedDict, total=False):
    source: _Input
    target: _Input


class _Overlap(TypedDict, total=False):
    """How much of two parts overlaps."""

    source_share: Annotated[float, Ge(0), Le(1)]
    target_share: Annotated[float, Ge(0), Le(1)]
    fit: PartsFit | None


class _Matched(TypedDict, total=False):
    """What became of the points of both shapes."""

    source_points: _Count
    source_points_left_out: _Count
    source_points_without_counterpart: _Count
    source_mean_confidence: Annotated[float, Ge(0), Le(1)]
    target_points: _Count
    target_points_left_out: _Count
    target_points_without_counterpart: _Count
    target_mean_confidence: Annotated[float, Ge(0), Le(1)]


@record
class _Report(TypedDict):
    """What a report may hold; others may add entries. Those that an older version did not write may be missing."""

    method: str
    warnings: NotRequired[list[str]]
    inputs: NotRequired[_Inputs]
    options: NotRequired[PairOptions]
    choice: NotRequired[list[_Candidate]]
    adapt: NotRequired[_Count]
    adaptation: NotRequired[_Adaptation | None]
    features: NotRequired[_Features | None]
    settings: NotRequired[dict[str, Any]]
    timings: NotRequired[list[_Timing]]
    versions: NotRequired[dict[str, str]]
    device: NotRequired[str]
    orientation: NotRequired[_Orientation | None]
    alignment: NotRequired[_Turn | None]
    overlap: NotRequired[_Overlap | None]
    quality: NotRequired[MapQuality | None]
    matched: NotRequired[_Matched]
    sha256: NotRequired[dict[str, str]]


def given_files(match: Match) -> list[Path]:
    """The files that the shapes of a match were read from, as far as its report names them."""
    inputs = match.report.get("inputs", {})
    return [Path(inputs[side]["file"]) for side in SIDES if "file" in inputs.get(side, {})]


def write_folder(folder: str | Path, match: Match, *, timings: Timings | None = None) -> list[Path]:
    """Write ``correspondence.npz``, ``source.ply``, ``target.ply`` and ``report.json`` into a folder, made if need be.

    The shapes are as given, point by point, coloured so that the same colour means the same point; so that any program
    opens them, faces that repair drops are left out, and points without a position lie at the mean of the others. The
    four files land together once all are written; on an error or an interrupt an earlier result stays as it was. Only a
    process that is killed amid the landing leaves some of both, which the report tells by its hashes of the others.
    Other files are left alone.

    Args:
        folder: where to.
        match: what to write.
        timings: what was done before; the report tells of these, and of the writing of the other files as one more.

    Raises:
        ArgumentError: if the folder cannot be made or written to, or a shape was read from one of those files.
    """
    with all_or_nothing() as moves, written_together(folder, RESULT_FILES, given_files(match)) as paths:
        with (timings or Timings()).measure("write"):
            source_colours, target_colours = matched_colours(match)
            write_maps(paths[0], match)
            write_shape(paths[1], drawable(match.source), colours=source_colours)
            write_shape(paths[2], drawable(match.target), colours=target_colours)
        landing = {target: temporary for temporary, target in moves.items()}
        known = match.report.get("inputs", {})
        inputs = {side: {"name": getattr(match, side).name, **known.get(side, {})} for side in SIDES}
        told: dict[str, Any] = {
            "inputs": inputs,
            "method": match.method,
            "warnings": list(match.warnings),
            "sha256": {path.name: sha256(landing[resolved(path)]) for path in paths[:-1]},
        }
        if match.quality is not None:
            told["quality"] = match.quality.to_dict()
        if timings is not None:
            told["timings"] = [asdict(timing) for timing in timings.finished]
        write_json(paths[3], {"versions": versions(), **match.report, **told})
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
    report = read_record(root / REPORT, _Report, instead="match again")
    hashes, told = report.pop("sha256", {}), report.setdefault("warnings", [])
    if not {*RESULT_FILES[:-1]} <= hashes.keys() and _UNTIED not in told:
        told.append(_UNTIED)
    for name, digest in hashes.items():
        if name in RESULT_FILES and sha256(root / name) != digest:
            raise DataError(
                f"{root / name} is not the file that {REPORT} belongs to: it was changed, or a run was killed while it "
                "wrote them; match again"
            )
    return {
        "source": _read_shape(root, report, "source"),
        "target": _read_shape(root, report, "target"),
        **_read_arrays(root / MAPS),
        "method": report["method"],
        "warnings": tuple(told),
        "quality": None if report.get("quality") is None else MapQuality.from_dict(report["quality"]),
        "report": report,
    }


def _read_shape(root: Path, report: dict[str, Any], side: Side) -> Shape:
    """One of the shapes, by the name of the file that was matched where the report tells it."""
    shape = read_shape(root / f"{side}.ply")
    _check_counts(root, report, side, shape)
    if not (np.abs(shape.points) < _FARTHEST).all():
        raise DataError(f"{root / shape.name} has points that no match writes, infinite or beyond; match again")
    return replace(shape, name=matched_name(report, side, otherwise=shape.name))


def _check_counts(root: Path, report: dict[str, Any], side: Side, shape: Shape) -> None:
    """Refuse a report that counts more points of a shape than there are, or fewer where it counts all of them."""
    given, matched = report.get("inputs", {}).get(side, {}), report.get("matched", {})
    counts = {
        f"inputs.{side}.n_points": (given.get("n_points"), shape.n_points),
        f"inputs.{side}.points_left_out": (given.get("points_left_out"), 0),
        f"matched.{side}_points": (matched.get(f"{side}_points"), shape.n_points),
        **{
            f"matched.{name}": (matched.get(name), 0)
            for name in (f"{side}_points_left_out", f"{side}_points_without_counterpart")
        },
    }
    for entry, (count, least) in counts.items():
        if count is not None and not least <= count <= shape.n_points:
            raise DataError(
                f"{root / REPORT} is damaged (its entry {entry} is {count}, but {shape.name} has {shape.n_points} "
                "points); match again"
            )


def matched_name(report: Mapping[str, Any], side: Side, *, otherwise: str) -> str:
    """The name of the file that was matched, where the report of a match tells it."""
    given = report.get("inputs", {}).get(side, {})
    return PurePath(given.get("file", given.get("name", otherwise))).name


def _read_arrays(path: Path) -> dict[str, np.ndarray]:
    try:
        with open_npz(path) as stored:
            missing = [name for name in _ARRAYS if name not in stored.names]
            arrays = {name: stored[name] for name in _ARRAYS if name not in missing}
    except Exception as error:  # whatever NumPy raises of a damaged file
        raise DataError(f"{path} cannot be read as the arrays of a match ({reason_of(error)}); match again") from None
    if missing:
        raise DataError(f"{path} has no array {missing[0]!r}; it must be what homolog match wrote")
    for name, array in arrays.items():
        trust = name.endswith("confidence")
        if array.ndim != 1 or array.dtype.kind != ("f" if trust else "i"):
            raise DataError(f"{path} holds arrays that are not those of a match; match again")
        if trust and not ((array >= 0) & (array <= 1)).all():
            raise DataError(f"{path}: {name} must lie between 0 and 1; match again")
    return arrays


def write_maps(
    path: str | Path,
    match: Match,
    *,
    base: int | None = None,
    direction: str = _DIRECTIONS[0],
    name: str | None = None,
) -> Path:
    """Write the point maps as one file, by its suffix; see ``Match.save``. Written whole or not at all.

    Raises:
        ArgumentError: if there is no such format, base or direction, or a name for a format without names.
    """
    suffix = _checked_suffix(path)
    if name is not None and (suffix not in (".mat", ".npz") or not name.isidentifier()):
        raise ArgumentError(f"name is {name!r}, but must be a word that a .mat or .npz calls its map; {path} is named")
    _check_options(base, direction)
    base = _BASES[suffix] if base is None else base
    arrays = {name: getattr(match, name) for name in _ARRAYS}
    shifted = {name: values + base if name in _DIRECTIONS else values for name, values in arrays.items()}
    if name is not None:
        shifted = {name: shifted[direction]}
    # NumPy adds a suffix to a name that has none, but not to a file.
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        # A result folder's arrays count from 0, and need not say so.
        told = {_FIRST_INDEX: base} if name is None and (base or suffix == ".mat") else {}
        if suffix == ".npz":
            np.savez_compressed(file, allow_pickle=False, **{**shifted, **told})
        elif suffix == ".mat":
            scipy.io.savemat(file, {**shifted, **told}, do_compression=True, oned_as="column")
        else:
            np.savetxt(file, shifted[direction], fmt="%d")
    return expanded(path)


def read_point_map(
    path: str | Path, *, base: int | None = None, direction: str = _DIRECTIONS[0], n_others: int | None = None
) -> Int[np.ndarray, " n"]:
    """Read a point map that this or another program wrote: ``.npz``, ``.mat``, ``.txt``, ``.vts`` or ``.map``.

    Args:
        path: the file. Text holds an index per line; ``.npz`` and ``.mat`` an array called ``direction``, or one alone.
        base: the first index; by default what ``.npz`` or ``.mat`` say themselves by ``first_index``, or else 0 for
            ``.npz`` and ``.txt``, 1 for the others.
        direction: which map is meant, where a file holds both.
        n_others: how many points the shape has that the map leads to. Where it is given and ``base`` is not, a file
            that seems to count from another index than its format is refused: one that holds the index after the last
            point, or 0 and not the last point, though it should count from 1.

    Returns:
        Indices from 0, -1 for none (n,).

    Raises:
        ArgumentError: if ``base`` is neither 0 nor 1, or there is no such direction.
        DataError: if it cannot be read as such, holds no whole numbers, or numbers that are no indices.

    Examples:
        >>> import numpy as np
        >>> from homolog.matching import read_point_map
        >>> np.savetxt("map.vts", [3, 1, 2], fmt="%d")
        >>> read_point_map("map.vts")
        array([2, 0, 1])
    """
    file = expanded(path)
    suffix = _checked_suffix(path, reading=True)
    _check_options(base, direction)
    own = None
    try:
        if suffix == ".npz":
            with open_npz(file) as archive:
                names = [direction] if direction in archive.names else archive.names
                own = archive[_FIRST_INDEX] if _FIRST_INDEX in archive.names else None
                values = _only(path, {name: archive[name] for name in names if name != _FIRST_INDEX}, direction)
        elif suffix == ".mat":
            stored = read_in_process(_MATLAB, ordinary(file), library="SciPy")
            own = stored.pop(_FIRST_INDEX, None)
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
        raise DataError(f"{path} cannot be read as a point map ({reason_of(error)})") from None
    values = _whole_numbers(path, values)
    first = _own_base(path, own) if base is None and own is not None else base
    if first is None:
        first = _BASES.get(suffix, 1)
        _check_usual_base(path, values, first, n_others)
    if values.size and values.min() < first - 1:
        hint = "; give base=0 if they count from 0" if first == 1 and values.min() == -1 else ""
        raise DataError(
            f"{path} holds {values.min()}, but must hold indices from {first}, or {first - 1} for none{hint}"
        )
    return values - first


def _own_base(path: str | Path, told: np.ndarray) -> int:
    """The first index that a file tells."""
    if told.size != 1 or told.item() not in (0, 1):
        raise DataError(f"{path}: its first_index is {shorten(told.tolist())}, but must be 0 or 1; give base")
    return int(told.item())


def _check_options(base: Any, direction: Any) -> None:
    if base is not None and not (is_count(base, least=0) and base <= 1):
        raise bad_value("base", base, "the first index, 0 or 1")
    check_choice("direction", direction, _DIRECTIONS)


def _check_usual_base(path: str | Path, values: Int[np.ndarray, " n"], first: int, n_others: int | None) -> None:
    """Refuse indices that fit the shape only if they count from another index than is usual in such a file."""
    if n_others is None or not values.size:
        return
    if first == 0 and values.max() == n_others and values.min() >= 0:
        raise DataError(
            f"{path} holds {n_others}, but must hold indices from 0 to {n_others - 1}; give base=1 if they count from 1"
        )
    if first == 1 and values.min() == 0 and values.max() < n_others:
        raise DataError(
            f"{path} holds 0, and {values.max()} at most: its indices seem to count from 0, where those of such a file "
            f"count from 1, to {n_others}; give base=0, or base=1 if 0 stands for a point without a counterpart"
        )


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
        found = f"{shorten(values.dtype)} of shape {shorten(values.shape)}"
        raise DataError(f"{path} does not hold one whole number per point, but {found}")
    values = values.reshape(-1)
    with np.errstate(over="ignore"):  # of numbers in extended precision
        (wrong,) = np.nonzero((values != np.round(values)) | ~(np.abs(values.astype(float)) < _TOO_LARGE))
    if len(wrong):
        raise DataError(f"{path} holds {values[wrong[0]]}, but must hold one whole number per point, its index")
    return values.astype(np.int64)


def _checked_suffix(path: str | Path, *, reading: bool = False) -> str:
    suffix = PurePath(path).suffix.lower()
    if suffix not in MAP_SUFFIXES:
        folder = "" if reading else "; without a suffix it is a result folder"
        found = f"the suffix {suffix!r}" if suffix else "no suffix"
        raise ArgumentError(f"{path} has {found}, but a point map must have one of {', '.join(MAP_SUFFIXES)}{folder}")
    return suffix
