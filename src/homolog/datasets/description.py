"""Descriptions of datasets: source, file layout, splits, pairs and kind of ground truth."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, Literal, get_args

from homolog.core.choices import Up
from homolog.core.errors import ArgumentError, bad_choice
from homolog.core.files import expanded
from homolog.core.messages import shorten
from homolog.core.settings import read_settings, read_toml

Holds = Literal["meshes", "clouds", "volumes"]
TruthKind = Literal["template-correspondence", "barycentric", "same-numbering", "pair-maps", "none"]
SplitRule = Literal["found", "listed", "last", "test", "train", "either"]
PairRule = Literal["found", "every", "same-class", "listed", "partial", "maps"]

_BUILTIN = Path(__file__).parent / "descriptions"
_RANGE = re.compile(r"\{(\d+)\.\.(\d+)\}")
# The names that ranges stand for, of one description, and the digits of a number in them.
_MOST_NAMES, _MOST_DIGITS = 100_000, 18


@dataclass(frozen=True)
class DatasetDescription:
    """The description of a dataset. The defaults describe a folder with ``off/NAME.off`` and ``corres/NAME.vts``.

    File patterns are relative to the dataset's folder and have one star, for the shape's name. Counts are 0 if unknown
    or if they differ.

    Args:
        name: by which commands know the dataset.
        title: for people.
        citation: the paper to cite.
        source: where to get it, with the address.
        terms: of use.
        notes: further remarks.
        holds: ``"meshes"``; ``"clouds"`` without faces, whose errors are Euclidean distances in the files' ``unit``; or
            ``"volumes"``, of which surfaces have to be extracted first.
        unit: of the files' coordinates, if known.
        up: the axis of the files that points up.
        shapes: pattern of the shapes or, where ``full`` is given, of the partial shapes.
        full: pattern of the full shapes, where these are separate files; the name of a partial shape contains that of
            its full shape.
        clouds: pattern of point clouds that have their own points, such as those of a depth camera. They are used in
            place of the mesh's points where shapes are matched as clouds; their ground truth is in ``cloud_truth``.
        partial: whether the second shape of each pair is partial; ``"both"``: both are, and overlap.
        pre_aligned: whether partial shapes are aligned with their full shapes.
        shuffled: whether the rows of every file are permuted when it is read, since equal numbering would reveal the
            ground truth.
        truth: the kind of ground truth. ``"template-correspondence"``: line i of each file is the shape's vertex at
            template point i, counted from 1, or -1 where a partial shape lacks it. ``"barycentric"``: a row for each
            vertex of a partial shape, with the triangle of the full shape, counted from 1, and three barycentric
            coordinates. ``"same-numbering"``: row i is the same point in every shape. ``"pair-maps"``: a file
            ``SOURCE_TARGET`` for each pair, with the target vertex of each source vertex, counted from 1, or -1 for
            none. Or ``"none"``.
        truth_files: pattern of the ground truth.
        cloud_truth: pattern of NPZ files, one for each cloud, in which ``cloud_to_full`` holds for each point of the
            cloud the point of the full shape that it is paired with, counted from 0, or -1 if unknown.
        split: ``"found"``: by ``train.txt`` and ``test.txt``; without these the last 20 shapes by name are for testing,
            or all of them if ``pairs.txt`` lists the pairs. ``"listed"``: by these two files. ``"last"``: the last
            ``n_test`` by name are for testing. ``"test"``, ``"train"``: all shapes are for that. ``"either"``: there is
            no split; all shapes are for both.
        pairs: ``"found"``: by ``pairs.txt`` if it exists, else as ``"every"``. ``"every"``: all ordered pairs of the
            shapes of a split, each with itself too. ``"same-class"``: likewise, within shapes whose names differ only
            in their last number. ``"listed"``: by ``pairs_file``. ``"partial"``: each partial shape with its full
            shape. ``"maps"``: the pairs that have a map.
        pairs_file: two names a line.
        separator: between them.
        left_out: names that occur in no test pair.
        names: of all shapes, or partial shapes, if known; ``{00..19}`` stands for a range of numbers. All of these
            together are at most 100,000.
        full_names: of the full shapes, likewise.
        n_shapes: number of shapes or partial shapes.
        n_train: number of them for training.
        n_test: number of them for testing.
        n_pairs: number of test pairs.
        n_points: least and largest number of points of a shape.
        n_truth: number of lines of each ground truth file.
        sha256: hash of the output of ``sha256sum`` for all files of shapes and truth, sorted by path.
    """

    name: str = ""
    title: str = ""
    citation: str = ""
    source: str = ""
    terms: str = ""
    notes: str = ""
    holds: Holds = "meshes"
    unit: str = ""
    up: Up = "y"
    shapes: str = "off/*.off"
    full: str = ""
    clouds: str = ""
    partial: bool | Literal["both"] = False
    pre_aligned: bool = False
    shuffled: bool = False
    truth: TruthKind = "template-correspondence"
    truth_files: str = "corres/*.vts"
    cloud_truth: str = ""
    split: SplitRule = "found"
    pairs: PairRule = "found"
    pairs_file: str = "pairs.txt"
    separator: str = ","
    left_out: tuple[str, ...] = ()
    names: tuple[str, ...] = ()
    full_names: tuple[str, ...] = ()
    n_shapes: int = 0
    n_train: int = 0
    n_test: int = 0
    n_pairs: int = 0
    n_points: tuple[int, int] | None = None
    n_truth: int = 0
    sha256: str = ""

    def __post_init__(self) -> None:
        for name, words in _WORDS.items():
            if getattr(self, name) not in get_args(words):
                raise bad_choice(name, getattr(self, name), get_args(words))
        for name in ("shapes", "truth_files", "full", "clouds", "cloud_truth"):
            needed = name in ("shapes", "truth_files")
            if (needed or getattr(self, name)) and getattr(self, name).count("*") != 1:
                raise ArgumentError(f"{name} is {getattr(self, name)!r}, but must have one star, for a shape's name")
        for key, value in _NEEDS.items():
            if getattr(self, key[0]) == key[1] and getattr(self, value[0]) != value[1]:
                raise ArgumentError(f"{key[0]} is {_toml(key[1])}, which needs {value[0]} to be {_toml(value[1])}")
        if self.split == "last" and self.n_test < 1:
            raise ArgumentError(f"n_test is {self.n_test}, but split = 'last' needs at least 1")
        if bool(self.full) != (self.pairs == "partial"):
            raise ArgumentError("full and pairs = 'partial' belong together; give both, or neither")
        if bool(self.clouds) != bool(self.cloud_truth):
            raise ArgumentError("clouds and cloud_truth belong together; give both, or neither")
        for name in ("names", "full_names"):
            _check_ranges(name, getattr(self, name))

    @property
    def expected_names(self) -> tuple[str, ...]:
        """The names of all shapes, or partial shapes; empty if unknown."""
        return _expanded_names(self.names)

    @property
    def expected_full_names(self) -> tuple[str, ...]:
        """The names of all full shapes, where these are separate files; empty if unknown."""
        return _expanded_names(self.full_names)

    @property
    def expected_shapes(self) -> int:
        """The number of shapes, or partial shapes; 0 if unknown."""
        return self.n_shapes or len(self.expected_names)

    @property
    def folders(self) -> tuple[str, str]:
        """The folders of full and of partial shapes, where these are separate files."""
        return str(PurePosixPath(self.full).parent), str(PurePosixPath(self.shapes).parent)


_WORDS: dict[str, Any] = {
    "holds": Holds,
    "up": Up,
    "truth": TruthKind,
    "split": SplitRule,
    "pairs": PairRule,
}
# A value of one key that requires a value of another.
_NEEDS: dict[tuple[str, Any], tuple[str, Any]] = {
    ("pre_aligned", True): ("partial", True),
    ("pairs", "partial"): ("partial", True),
    ("shuffled", True): ("truth", "same-numbering"),
    ("truth", "barycentric"): ("pairs", "partial"),
    ("pairs", "maps"): ("truth", "pair-maps"),
    ("holds", "volumes"): ("truth", "none"),
}


def _toml(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) else repr(value)


def _check_ranges(what: str, names: tuple[str, ...]) -> None:
    """Refuse ranges of numbers that stand for too many names, before any of them is made."""
    n_names = len(names)
    for found in filter(None, map(_RANGE.search, names)):
        first, last = found.groups()
        shown = f"{what} holds the range {shorten(found[0], 60)}"
        if max(len(first), len(last)) > _MOST_DIGITS:
            raise ArgumentError(f"{shown}, but numbers in ranges must have at most {_MOST_DIGITS} digits")
        if int(last) < int(first):
            raise ArgumentError(f"{shown}, but a range must begin with its least number")
        n_names += int(last) - int(first)
        if n_names > _MOST_NAMES:
            raise ArgumentError(f"{shown}, but all ranges together must stand for at most {_MOST_NAMES} names")


def _expanded_names(names: tuple[str, ...]) -> tuple[str, ...]:
    """Expand the ranges of numbers in names."""
    return tuple(name for given in names for name in _written_out(given))


def _written_out(name: str) -> list[str]:
    found = _RANGE.search(name)
    if found is None:
        return [name]
    first, last = found.groups()
    return [_RANGE.sub(str(number).zfill(len(first)), name) for number in range(int(first), int(last) + 1)]


def read_description(given: str | Path) -> DatasetDescription:
    """Read a built-in description by its name, in any case, or a TOML file.

    Raises:
        ArgumentError: if there is neither, or the file is not valid; one line with file and key.

    Examples:
        >>> read_description("faust_r").expected_shapes
        100
    """
    builtin = _builtin_files()
    name = str(given).lower()
    if name in builtin:
        return _read(builtin[name])
    path = expanded(given)
    if path.suffix != ".toml":
        raise bad_choice("dataset", str(given), list(builtin), "or give the path of a TOML file")
    return _read(path)


def builtin_descriptions() -> tuple[DatasetDescription, ...]:
    """All built-in descriptions, sorted by name."""
    return tuple(_read(path) for path in _builtin_files().values())


def _builtin_files() -> dict[str, Path]:
    return {path.stem: path for path in sorted(_BUILTIN.glob("*.toml"))}


def _read(path: Path) -> DatasetDescription:
    return read_settings(DatasetDescription, {"name": path.stem, **read_toml(path)}, f"{path}:")
