"""What is known of a set of shapes: where to get it, what lies where, its splits, pairs and ground truth."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, Literal, get_args

from homolog.core.choices import Up
from homolog.core.errors import ArgumentError, bad_choice
from homolog.core.files import expanded
from homolog.core.tables import read_table, read_toml

Holds = Literal["meshes", "clouds", "volumes"]
TruthKind = Literal["common-points", "barycentric", "same-numbering", "pair-maps", "none"]
SplitRule = Literal["found", "listed", "last", "test", "train", "either"]
PairRule = Literal["found", "every", "same-class", "listed", "parts", "maps"]

_SHIPPED = Path(__file__).parent / "descriptions"
_RANGE = re.compile(r"\{(\d+)\.\.(\d+)\}")


@dataclass(frozen=True)
class DatasetDescription:
    """A set of shapes. The defaults describe a folder of one's own.

    Places are relative to the set's folder; a star in one stands for a shape's name. Counts are 0 where they are not
    known, or differ.

    Args:
        name: by which commands know the set.
        title: for people.
        citation: the paper to cite.
        source: where to get it, with the address.
        terms: on which it may be used.
        notes: what else one should know.
        holds: ``"meshes"``; ``"clouds"`` without faces, where errors are straight distances in the files' ``unit``; or
            ``"volumes"``, of which surfaces are to be made first.
        unit: of the files' coordinates, where that is known.
        up: which axis of the files points up.
        shapes: the files of the shapes or, where parts lie apart, of the parts.
        complete: where parts lie apart, the files of the complete shapes, each with parts whose names contain its own.
        clouds: the files of clouds with points of their own, of those shapes that have one: what a depth camera saw of
            a view, say. Where shapes are used as clouds, these are, and their truth is in ``cloud_truth``.
        partial: whether the second shape of each pair is a part of one like the first.
        pre_aligned: whether parts lie in the coordinates of their complete shapes, about where they belong.
        shuffled: whether the rows of every file are put in an order of its own before anything sees them, since the
            numbering would give the truth away.
        truth: what the ground truth is. ``"common-points"``: line i of each file holds the shape's vertex at the i-th
            common point, counted from 1, or -1 where a part lacks it. ``"barycentric"``: a row for each vertex of a
            part, its triangle of the complete shape, counted from 1, and three weights. ``"same-numbering"``: row i is
            the same point in every shape. ``"pair-maps"``: a file ``SOURCE_TARGET`` for a pair, with a line for each
            vertex of the source, the vertex of the target there, counted from 1, or -1 for none. Or ``"none"``.
        truth_files: where it lies.
        cloud_truth: for each shape that has such a cloud an NPZ file, where ``cloud_to_complete`` holds for each point
            of the cloud the point of the complete shape that it is paired with, counted from 0, or -1 if not known.
        split: ``"found"``: as ``train.txt`` and ``test.txt`` say, else the last 20 shapes in the order of names are for
            testing, or all of them where ``pairs.txt`` lists the pairs. ``"listed"``: as these two files say.
            ``"last"``: the last ``n_test`` in the order of names are for testing. ``"test"``, ``"train"``: all shapes
            are for that. ``"either"``: the set has no split; all shapes are for both.
        pairs: ``"found"``: as ``pairs.txt`` says if it is there, else every two shapes. ``"every"``: every two shapes
            of a split in both orders, and each with itself. ``"same-class"``: likewise, of shapes whose names differ in
            their last number alone. ``"listed"``: as ``pairs_file`` says. ``"parts"``: each part with its complete
            shape. ``"maps"``: those that have a map.
        pairs_file: two names a line.
        separator: between them.
        left_out: names that no pair of the test has.
        names: of all shapes, or parts, if they are known; ``{00..19}`` stands for a range of numbers.
        complete_names: of the complete shapes, likewise.
        n_shapes: how many shapes or parts there are.
        n_train: how many of them are for training.
        n_test: for testing.
        n_pairs: how many pairs the test has.
        n_points: the fewest and the most points of a shape.
        n_truth: lines of each file of ground truth.
        sha256: of what ``sha256sum`` says of all files of shapes and truth, in the order of their places.
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
    complete: str = ""
    clouds: str = ""
    partial: bool = False
    pre_aligned: bool = False
    shuffled: bool = False
    truth: TruthKind = "common-points"
    truth_files: str = "corres/*.vts"
    cloud_truth: str = ""
    split: SplitRule = "found"
    pairs: PairRule = "found"
    pairs_file: str = "pairs.txt"
    separator: str = ","
    left_out: tuple[str, ...] = ()
    names: tuple[str, ...] = ()
    complete_names: tuple[str, ...] = ()
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
        for name in ("shapes", "truth_files", "complete", "clouds", "cloud_truth"):
            needed = name in ("shapes", "truth_files")
            if (needed or getattr(self, name)) and getattr(self, name).count("*") != 1:
                raise ArgumentError(f"{name} is {getattr(self, name)!r}, but must have one star, for a shape's name")
        for key, value in _NEEDS.items():
            if getattr(self, key[0]) == key[1] and getattr(self, value[0]) not in value[1]:
                raise ArgumentError(f"{key[0]} is {_toml(key[1])}, which needs {value[0]} to be {_either(value[1])}")
        if self.split == "last" and self.n_test < 1:
            raise ArgumentError(f"n_test is {self.n_test}, but split = 'last' needs at least 1")
        if bool(self.complete) != (self.pairs == "parts"):
            raise ArgumentError("complete and pairs = 'parts' belong together; give both, or neither")
        if bool(self.clouds) != bool(self.cloud_truth):
            raise ArgumentError("clouds and cloud_truth belong together; give both, or neither")

    @property
    def expected_names(self) -> tuple[str, ...]:
        """The names of all shapes, or parts; none if they are not known."""
        return _spread(self.names)

    @property
    def expected_complete_names(self) -> tuple[str, ...]:
        """The names of all complete shapes, where they lie apart; none if they are not known."""
        return _spread(self.complete_names)

    @property
    def expected_shapes(self) -> int:
        """How many shapes, or parts, the set has; 0 if that is not known."""
        return self.n_shapes or len(self.expected_names)

    @property
    def folders(self) -> tuple[str, str]:
        """Where complete shapes and parts lie that lie apart."""
        return str(PurePosixPath(self.complete).parent), str(PurePosixPath(self.shapes).parent)


_WORDS: dict[str, Any] = {
    "holds": Holds,
    "up": Up,
    "truth": TruthKind,
    "split": SplitRule,
    "pairs": PairRule,
}
# What a value of one key asks of another.
_NEEDS: dict[tuple[str, Any], tuple[str, tuple[Any, ...]]] = {
    ("pre_aligned", True): ("partial", (True,)),
    ("pairs", "parts"): ("partial", (True,)),
    ("shuffled", True): ("truth", ("same-numbering",)),
    ("truth", "barycentric"): ("pairs", ("parts",)),
    ("pairs", "maps"): ("truth", ("pair-maps",)),
    ("holds", "volumes"): ("truth", ("none",)),
}


def _toml(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) else repr(value)


def _either(values: tuple[Any, ...]) -> str:
    return " or ".join(map(_toml, values))


def _spread(names: tuple[str, ...]) -> tuple[str, ...]:
    """Names with each range of numbers written out."""
    return tuple(name for given in names for name in _written_out(given))


def _written_out(name: str) -> list[str]:
    found = _RANGE.search(name)
    if found is None:
        return [name]
    first, last = found.groups()
    return [_RANGE.sub(str(number).zfill(len(first)), name) for number in range(int(first), int(last) + 1)]


def read_description(given: str | Path) -> DatasetDescription:
    """The description that ships under this name, in capitals or not, or the one in a TOML file of one's own.

    Raises:
        ArgumentError: if there is neither, or it is not as it should be; one line with file and key.
    """
    shipped = _shipped()
    name = str(given).lower()
    if name in shipped:
        return _read(shipped[name])
    path = expanded(given)
    if path.suffix != ".toml":
        raise bad_choice("set", str(given), list(shipped), "or give the path of a TOML file")
    return _read(path)


def builtin_descriptions() -> tuple[DatasetDescription, ...]:
    """All descriptions that ship with the package, in the order of their names."""
    return tuple(_read(path) for path in _shipped().values())


def _shipped() -> dict[str, Path]:
    return {path.stem: path for path in sorted(_SHIPPED.glob("*.toml"))}


def _read(path: Path) -> DatasetDescription:
    return read_table(DatasetDescription, {"name": path.stem, **read_toml(path)}, f"{path}:")
