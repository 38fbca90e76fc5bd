"""A folder of shapes as a description has it: names, files, splits, pairs and ground truth."""

from __future__ import annotations

import hashlib
import itertools
import logging
import re
import zlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath
from typing import get_args

import numpy as np
from jaxtyping import Int

from homolog.core.choices import Split, Up
from homolog.core.errors import DataError, bad_choice, bad_value
from homolog.core.files import expanded
from homolog.datasets.description import DatasetDescription, read_description
from homolog.datasets.truth import GroundTruth, read_vertices
from homolog.shapes import Shape, read_shape, stand_upright

_log = logging.getLogger(__name__)

Pair = tuple[str, str]
"""Names of source and target."""

# Without a list of its own, a set keeps its last shapes in name order for testing, as FAUST_r and SCAPE_r do.
_TEST_SHAPES = 20


@dataclass(frozen=True)
class ShapeFolder:
    """Shapes in correspondence on disk, in whatever layout its description says.

    Without a description a folder is one's own: see ``DatasetDescription``'s defaults, and docs/conventions.md.

    Args:
        root: the folder.
        names: of all its shapes or, where parts lie apart, of the parts, in order.
        up: which axis of the files points up.
        description: of the set.
        complete: where parts lie apart, the names of the complete shapes.
        seed: of the order that the rows of files are put in, where the description wants that.
    """

    root: Path
    names: tuple[str, ...]
    up: Up = "y"
    description: DatasetDescription = field(default_factory=DatasetDescription)
    complete: tuple[str, ...] = ()
    seed: int = 0

    @classmethod
    def open(
        cls, root: str | Path, description: DatasetDescription | str | Path | None = None, *, up: Up | None = None
    ) -> ShapeFolder:
        """Look into a folder with shapes and ground truth.

        Args:
            root: the folder.
            description: of the set, its name, or a TOML file of one's own; by default the folder is one's own.
            up: which axis of the files points up; by default the description's.

        Raises:
            ArgumentError: if ``up`` is not x, y or z, or there is no such description.
            DataError: if the folder has no shapes, or shapes without ground truth.
        """
        found = cls.without_truth(root, description, up=up)
        found._warn_of_others()
        if missing := found.missing_truth():
            raise DataError(
                f"{found.root}: {len(missing)} of {len(found.names)} shapes have no ground truth; "
                f"put the first one's at {next(iter(missing.values()))}"
            )
        return found

    @classmethod
    def without_truth(
        cls, root: str | Path, description: DatasetDescription | str | Path | None = None, *, up: Up | None = None
    ) -> ShapeFolder:
        """Look into a folder with shapes, whether they have ground truth or not; see ``open``.

        Raises:
            ArgumentError: as with ``open``.
            DataError: if it has no shapes, or holds volumes.
        """
        root = expanded(root)
        if description is None:
            description = DatasetDescription()
        elif not isinstance(description, DatasetDescription):
            description = read_description(description)
        if description.holds == "volumes":
            raise DataError(f"{root} holds volumes; make surfaces of them with homolog volume surface, and give these")
        if up is not None and up not in get_args(Up):
            raise bad_choice("up", up, get_args(Up))
        names, complete = names_at(root, description.shapes), names_at(root, description.complete)
        for found, pattern in ((names, description.shapes), (complete, description.complete)):
            if pattern and not found:
                raise DataError(f"{root}: no shapes; put them at {place(root, pattern, 'NAME')}")
        if shared := sorted({*names} & {*complete}):
            raise DataError(f"{root}: {shared[0]!r} names a complete shape and a part; rename the partial one")
        return cls(root, names, up or description.up, description, complete)

    def _warn_of_others(self) -> None:
        """Say so where these are not all the shapes of the set, or others: their scores are not the set's."""
        wanted = self.description.expected_shapes
        if wanted and len(self.names) != wanted:
            _log.warning(
                "%s has %d shapes, but %s has %d; homolog data check %s says which differ.",
                *(self.root, len(self.names), self.description.name, wanted, self.description.name),
            )

    def file(self, name: str) -> Path:
        """Where a shape lies."""
        pattern = self.description.complete if name in self.complete else self.description.shapes
        return place(self.root, pattern, name)

    def shape(self, name: str) -> Shape:
        """Read one shape, and stand it upright: +y up. Its points are shuffled if the set asks for it."""
        shape = stand_upright(read_shape(self.file(name)), self.up)
        return _reordered(shape, self._order(name, shape.n_points)) if self.description.shuffled else shape

    def has_cloud(self, name: str) -> bool:
        """Whether there is a cloud of this shape with points of its own."""
        return bool(self.description.clouds) and self._cloud_file(name).is_file()

    def cloud(self, name: str) -> Shape:
        """Read the cloud of a shape that has points of its own, and stand it upright."""
        return stand_upright(read_shape(self._cloud_file(name)), self.up)

    def _cloud_file(self, name: str) -> Path:
        return place(self.root, self.description.clouds, name)

    def missing_truth(self) -> dict[str, Path]:
        """The files of ground truth that are not there, by the shape or part that each belongs to."""
        if self.description.truth not in ("common-points", "barycentric"):
            return {}
        files = {name: place(self.root, self.description.truth_files, name) for name in self.names}
        return {name: file for name, file in files.items() if not file.is_file()}

    def common_points(self, name: str) -> Int[np.ndarray, " p"]:
        """0-based vertex index of each common point; -1 for those that the shape does not have.

        Raises:
            DataError: if the file does not hold positive whole numbers, one a line.
        """
        return read_vertices(place(self.root, self.description.truth_files, name))

    def ground_truth(self, shape_of: Callable[[str], Shape] | None = None) -> GroundTruth:
        """The truth of its pairs, of whatever kind; ``shape_of`` gives shapes that are read already by their names."""
        return GroundTruth(self.root, self.description, shape_of or self.shape, self._order)

    def split(self, split: Split) -> tuple[str, ...]:
        """The names of the shapes, or parts, in a split.

        Raises:
            ArgumentError: if ``split`` is not one.
            DataError: if the split has no shapes, or lists one that is not there.
        """
        if split not in get_args(Split):
            raise bad_choice("split", split, get_args(Split))
        if split == "all":
            return self.names
        names = self._split_names(split)
        if not names:
            hint = f"list them in {self._list(split)}, or use split 'all'"
            hint = hint if self.description.split in ("found", "listed") else "use another split, or 'all'"
            raise DataError(f"{self.root}: no shapes in split {split!r}; {hint}")
        return names

    def pairs(self, split: Split, *, listed: str | Path | None = None) -> tuple[Pair, ...]:
        """Source and target of each pair to match: those that the description wants of a split.

        Args:
            split: where the shapes come from; a pair has both of its shapes, or its part, in it.
            listed: a file of ``source,target`` lines to use instead, whatever the split.

        Raises:
            DataError: if there are none, or a list of them is not as it should be.
        """
        if listed is not None:
            return self._read_pairs(expanded(listed), ",")
        names = self.split(split)
        left_out = self.description.left_out if split == "test" else ()
        pairs = tuple(pair for pair in self._pairs_of(names) if not set(pair) & set(left_out))
        if not pairs:
            where = self.description.truth_files if self.description.pairs == "maps" else self.description.pairs_file
            raise DataError(
                f"{self.root / where} lists no pair with both shapes in split {split!r}; "
                "use split 'all', or another list of pairs"
            )
        return pairs

    def _order(self, name: str, n_points: int) -> Int[np.ndarray, " n"]:
        """Which row of a shape's file each of its points is."""
        if not self.description.shuffled:
            return np.arange(n_points)
        return np.random.default_rng(zlib.crc32(f"{self.seed} {name}".encode())).permutation(n_points)

    def _list(self, split: Split) -> Path:
        return self.root / f"{split}.txt"

    def _split_names(self, split: Split) -> tuple[str, ...]:
        rule = self.description.split
        if rule in ("train", "test", "either"):
            return self.names if rule in (split, "either") else ()
        if rule == "listed" or (rule == "found" and self._list(split).is_file()):
            return self._listed_names(self._list(split))
        if rule == "found" and (self.root / self.description.pairs_file).is_file():
            return self.names if split == "test" else ()
        n_test = self.description.n_test if rule == "last" else _TEST_SHAPES
        return self.names[-n_test:] if split == "test" else self.names[:-n_test]

    def _listed_names(self, listed: Path) -> tuple[str, ...]:
        try:
            names = tuple(listed.read_text(encoding="utf-8").split())
        except (OSError, UnicodeDecodeError):
            raise DataError(f"{listed} cannot be read as text; it must hold a name a line") from None
        return self._known(names, listed)

    def _pairs_of(self, names: tuple[str, ...]) -> Iterable[Pair]:
        rule, own = self.description.pairs, self.root / self.description.pairs_file
        if rule == "parts":
            return tuple((partner(name, self.complete), name) for name in names)
        if rule == "maps":
            return (pair for pair in self._pairs_with_maps() if set(pair) <= set(names))
        if rule == "listed" or (rule == "found" and own.is_file()):
            return (pair for pair in self._read_pairs(own, self.description.separator) if set(pair) <= set(names))
        every = ((source, target) for source in names for target in names)
        return every if rule != "same-class" else (pair for pair in every if class_of(pair[0]) == class_of(pair[1]))

    def _pairs_with_maps(self) -> Iterable[Pair]:
        """The pairs that have a map, by its name; those of shapes that are not there do not count."""
        for name in names_at(self.root, self.description.truth_files):
            words = name.split("_")
            ways = (("_".join(words[:i]), "_".join(words[i:])) for i in range(1, len(words)))
            yield from (pair for pair in ways if set(pair) <= set(self.names))

    def _read_pairs(self, path: Path, separator: str) -> tuple[Pair, ...]:
        wanted = f"SOURCE{separator}TARGET"
        try:
            lines = path.read_text(encoding="utf-8").splitlines()
        except (OSError, UnicodeDecodeError):
            raise DataError(f"{path}: there is no such list of pairs; it must hold {wanted} a line") from None
        pairs = []
        for number, line in enumerate(lines, 1):
            words = tuple(word.strip() for word in line.strip().split(separator))
            if words == ("",):
                continue
            if len(words) != 2:
                raise DataError(f"{path}, line {number}: {line.strip()[:60]!r} must be {wanted}")
            pairs.append((words[0], words[1]))
        if not pairs:
            raise DataError(f"{path} lists no pairs; it must hold {wanted} a line")
        self._known(tuple(itertools.chain.from_iterable(pairs)), path)
        return tuple(pairs)

    def _known(self, names: tuple[str, ...], listed: Path) -> tuple[str, ...]:
        unknown = sorted(set(names) - set(self.names) - set(self.complete))
        if unknown:
            file = PurePosixPath(self.description.shapes.replace("*", unknown[0]))
            raise DataError(
                f"{listed} names {unknown[0]!r}, but {self.root / file.parent} has no {file.name}; put it there"
            )
        return names


def place(root: Path, pattern: str, name: str) -> Path:
    """Where the file of a name lies, by a pattern with one star."""
    return root / pattern.replace("*", name)


def names_at(root: Path, pattern: str) -> tuple[str, ...]:
    """What the star of a pattern stands for in each file that is there, in order; hidden files do not count."""
    if not pattern:
        return ()
    head, tail = (len(part) for part in PurePosixPath(pattern).name.split("*"))
    found = (path.name for path in root.glob(pattern) if not path.name.startswith("."))
    return tuple(sorted(name[head : len(name) - tail] for name in found))


def partner(part: str, complete: Iterable[str]) -> str:
    """The complete shape whose name is a word, or several, of the part's.

    Raises:
        DataError: if there is none.
    """
    found = [name for name in complete if f"_{name}_" in f"_{part}_"]
    if not found:
        raise DataError(f"{part}: no complete shape has a word of its name, as cat has of cuts_cat_shape_1; rename it")
    return max(found, key=len)


def class_of(name: str) -> str:
    """A name without its last number: cat of cat10."""
    return re.sub(r"[\W_]*\d+$", "", name)


def _reordered(shape: Shape, order: Int[np.ndarray, " n"]) -> Shape:
    faces = None if shape.faces is None else np.argsort(order)[shape.faces]
    return replace(shape, points=shape.points[order], faces=faces)


def drawn_pairs(pairs: Iterable[Pair], count: int, *, seed: int) -> tuple[Pair, ...]:
    """Draw so many of the pairs of two different shapes at random, and give them in their order.

    Those are drawn whose names and seed have the smallest SHA-256: the same on every machine and with every version of
    any library, and among those of a larger draw with the same seed.

    Raises:
        ArgumentError: if there are not so many pairs.
    """
    different = [pair for pair in dict.fromkeys(pairs) if pair[0] != pair[1]]
    if not 1 <= count <= len(different):
        raise bad_value("n_pairs", count, f"from 1 to the number of pairs of different shapes, {len(different)}")
    places = {pair: hashlib.sha256(f"{seed} {pair[0]},{pair[1]}".encode()).digest() for pair in different}
    drawn = set(sorted(different, key=places.__getitem__)[:count])
    return tuple(pair for pair in different if pair in drawn)
