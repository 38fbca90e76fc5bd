"""Access to a dataset on disk by its description: names, files, splits, pairs and ground truth."""

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

from homolog.core.arguments import check_choice
from homolog.core.choices import Split, Up
from homolog.core.errors import DataError, bad_value
from homolog.core.files import expanded, read_text
from homolog.datasets.description import DatasetDescription, read_description
from homolog.datasets.truth import GroundTruth, read_vertices
from homolog.shapes import Shape, read_shape, stand_upright

_log = logging.getLogger(__name__)

Pair = tuple[str, str]
"""Names of source and target."""

# Without lists, this many last shapes by name are for testing, as in FAUST_r and SCAPE_r.
_TEST_SHAPES = 20


@dataclass(frozen=True)
class ShapeFolder:
    """A dataset of shapes in correspondence, in the layout of its description.

    Without a description the layout is that of ``DatasetDescription``'s defaults; see docs/conventions.md.

    Args:
        root: the folder.
        names: of all shapes or, where full shapes are separate files, of the partial shapes, sorted.
        up: the axis of the files that points up.
        description: of the dataset.
        full: the names of the full shapes, where these are separate files.
        seed: of the permutation of the rows of files, where the description demands one.

    Examples:
        >>> folder = ShapeFolder.open("FAUST_r", "faust_r")  # doctest: +SKIP
        >>> folder.split("test"), folder.pairs("test")  # doctest: +SKIP
        >>> folder.shape("tr_reg_080"), folder.template_correspondence("tr_reg_080")  # doctest: +SKIP
    """

    root: Path
    names: tuple[str, ...]
    up: Up = "y"
    description: DatasetDescription = field(default_factory=DatasetDescription)
    full: tuple[str, ...] = ()
    seed: int = 0

    def __repr__(self) -> str:
        of = f" of {self.description.name}" if self.description.name else ""
        return f"ShapeFolder({str(self.root)!r}: {len(self.names)} shapes{of}, {self.up} up)"

    @classmethod
    def open(
        cls, root: str | Path, description: DatasetDescription | str | Path | None = None, *, up: Up | None = None
    ) -> ShapeFolder:
        """Open a folder with shapes and ground truth.

        Args:
            root: the folder.
            description: of the dataset, its name, or a TOML file; by default ``DatasetDescription()``.
            up: the axis of the files that points up; by default the description's.

        Raises:
            ArgumentError: if ``up`` is not x, y or z, or there is no such description.
            DataError: if the folder has no shapes, or shapes without ground truth.
        """
        found = cls.without_truth(root, description, up=up)
        found._warn_of_other_count()
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
        """Open a folder with shapes, with or without ground truth; see ``open``.

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
        if up is not None:
            check_choice("up", up, get_args(Up))
        if not root.is_dir():
            raise DataError(f"{root} is a file; give the folder" if root.exists() else f"there is no folder {root}")
        names, full = names_at(root, description.shapes), names_at(root, description.full)
        for found, pattern in ((names, description.shapes), (full, description.full)):
            if pattern and not found:
                raise DataError(f"{root}: no shapes; put them at {path_of(root, pattern, 'NAME')}")
        if shared := sorted({*names} & {*full}):
            raise DataError(f"{root}: {shared[0]!r} names a full shape and a partial one; rename the partial one")
        return cls(root, names, up or description.up, description, full)

    def _warn_of_other_count(self) -> None:
        """Warn if the number of shapes is not the dataset's: scores are then not comparable with others'."""
        expected = self.description.expected_shapes
        if expected and len(self.names) != expected:
            _log.warning(
                "%s has %d shapes, but %s has %d; homolog data check %s says which differ.",
                *(self.root, len(self.names), self.description.name, expected, self.description.name),
            )

    def file(self, name: str) -> Path:
        """The file of a shape."""
        pattern = self.description.full if name in self.full else self.description.shapes
        return path_of(self.root, pattern, name)

    def shape(self, name: str) -> Shape:
        """Read one shape and turn it +y up; its points are permuted if the description demands it."""
        shape = stand_upright(read_shape(self.file(name)), self.up)
        if not self.description.shuffled:
            return shape
        order = self._order(name, shape.n_points)
        faces = None if shape.faces is None else np.argsort(order)[shape.faces]
        return replace(shape, points=shape.points[order], faces=faces)

    def has_cloud(self, name: str) -> bool:
        """Whether this shape has a point cloud with its own points."""
        return bool(self.description.clouds) and self._cloud_file(name).is_file()

    def cloud(self, name: str) -> Shape:
        """Read the point cloud of a shape that has its own points, and turn it +y up."""
        return stand_upright(read_shape(self._cloud_file(name)), self.up)

    def _cloud_file(self, name: str) -> Path:
        return path_of(self.root, self.description.clouds, name)

    def missing_truth(self) -> dict[str, Path]:
        """The missing ground truth files, by the name of their shape."""
        if self.description.truth not in ("template-correspondence", "barycentric"):
            return {}
        files = {name: path_of(self.root, self.description.truth_files, name) for name in self.names}
        return {name: file for name, file in files.items() if not file.is_file()}

    def template_correspondence(self, name: str) -> Int[np.ndarray, " p"]:
        """The shape's vertex at each template point, counted from 0; -1 where a partial shape lacks it.

        Raises:
            DataError: if the file does not hold positive whole numbers, one a line.
        """
        return read_vertices(path_of(self.root, self.description.truth_files, name))

    def partners_file(self, name: str) -> Path:
        """The file that may hold the shape's vertex at each template point's partner across the mirror plane."""
        return path_of(self.root, self.description.truth_files, name).with_suffix(".sym.vts")

    def ground_truth(self, shape_of: Callable[[str], Shape] | None = None) -> GroundTruth:
        """The ground truth of the dataset's pairs; ``shape_of`` gives shapes by name if they were read already."""
        return GroundTruth(self.root, self.description, shape_of or self.shape, self._order)

    def split(self, split: Split) -> tuple[str, ...]:
        """The names of the shapes, or partial shapes, of a split.

        Raises:
            ArgumentError: if ``split`` is not one.
            DataError: if the split has no shapes, or lists one that is not there.
        """
        check_choice("split", split, get_args(Split))
        if split == "all":
            return self.names
        names = self._split_names(split)
        if not names:
            hint = f"list them in {self._list(split)}, or use split 'all'"
            hint = hint if self.description.split in ("found", "listed") else "use another split, or 'all'"
            raise DataError(f"{self.root}: no shapes in split {split!r}; {hint}")
        return names

    def pairs(self, split: Split, *, listed: str | Path | None = None) -> tuple[Pair, ...]:
        """Source and target of each pair of a split, by the description's rule.

        Args:
            split: that both shapes, or the partial shape, belong to.
            listed: a file of ``source,target`` lines to use instead, independent of the split.

        Raises:
            DataError: if there are none, or their list is not valid.
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
        """For each point of a shape its row in the file."""
        if not self.description.shuffled:
            return np.arange(n_points)
        return np.random.default_rng(zlib.crc32(f"{self.seed} {name}".encode(errors="surrogateescape"))).permutation(
            n_points
        )

    def _list(self, split: Split) -> Path:
        return self.root / f"{split}.txt"

    def _split_names(self, split: Split) -> tuple[str, ...]:
        rule = self.description.split
        if rule in ("train", "test", "either"):
            return self.names if rule in (split, "either") else ()
        if rule == "listed" or (rule == "found" and self._list(split).is_file()):
            return self._known(_listed_words(self._list(split)), self._list(split))
        if rule == "found" and (self.root / self.description.pairs_file).is_file():
            return self.names if split == "test" else ()
        n_test = self.description.n_test if rule == "last" else _TEST_SHAPES
        return self.names[-n_test:] if split == "test" else self.names[:-n_test]

    def _pairs_of(self, names: tuple[str, ...]) -> Iterable[Pair]:
        rule, listed = self.description.pairs, self.root / self.description.pairs_file
        if rule == "partial":
            return tuple((partner(name, self.full), name) for name in names)
        if rule == "maps":
            return (pair for pair in self._pairs_with_maps() if set(pair) <= set(names))
        if rule == "listed" or (rule == "found" and listed.is_file()):
            return (pair for pair in self._read_pairs(listed, self.description.separator) if set(pair) <= set(names))
        every = ((source, target) for source in names for target in names)
        return every if rule != "same-class" else (pair for pair in every if class_of(pair[0]) == class_of(pair[1]))

    def _pairs_with_maps(self) -> Iterable[Pair]:
        """The pairs that have a map, by its file name; maps of missing shapes are skipped."""
        for name in names_at(self.root, self.description.truth_files):
            words = name.split("_")
            # Names may hold underscores: every one may be the one between source and target.
            pairs = (("_".join(words[:i]), "_".join(words[i:])) for i in range(1, len(words)))
            yield from (pair for pair in pairs if set(pair) <= set(self.names))

    def _read_pairs(self, path: Path, separator: str) -> tuple[Pair, ...]:
        pairs = _listed_pairs(path, separator)
        self._known(tuple(itertools.chain.from_iterable(pairs)), path)
        return pairs

    def _known(self, names: tuple[str, ...], listed: Path) -> tuple[str, ...]:
        unknown = self._missing_names(names, listed)
        if unknown:
            raise DataError(unknown[0])
        return names

    def _missing_names(self, names: Iterable[str], listed: Path) -> list[str]:
        """A message for each name of a list that has no file."""
        folder = self.root / PurePosixPath(self.description.shapes).parent
        files = {name: PurePosixPath(self.description.shapes.replace("*", name)).name for name in names}
        unknown = sorted(set(files) - set(self.names) - set(self.full))
        return [f"{listed} names {name!r}, but {folder} has no {files[name]}; put it there" for name in unknown]

    def missing_shapes(self) -> list[str]:
        """A message for each name in the dataset's lists of splits and pairs that has no file."""
        found = list[str]()
        if self.description.split in ("found", "listed"):
            for split in (self._list("train"), self._list("test")):
                found += self._missing_names(_listed_words(split), split) if split.is_file() else []
        pairs = self.root / self.description.pairs_file
        if self.description.pairs in ("found", "listed") and pairs.is_file():
            names = itertools.chain.from_iterable(_listed_pairs(pairs, self.description.separator))
            found += self._missing_names(names, pairs)
        return found


def _listed_words(path: Path) -> tuple[str, ...]:
    try:
        return tuple(read_text(path).split())
    except (OSError, UnicodeDecodeError):
        raise DataError(f"{path} cannot be read as text; it must hold a name a line") from None


def _listed_pairs(path: Path, separator: str) -> tuple[Pair, ...]:
    expected = f"SOURCE{separator}TARGET"
    try:
        lines = read_text(path).splitlines()
    except (OSError, UnicodeDecodeError):
        raise DataError(f"{path}: there is no such list of pairs; it must hold {expected} a line") from None
    pairs = []
    for number, line in enumerate(lines, 1):
        words = tuple(word.strip() for word in line.strip().split(separator))
        if words == ("",):
            continue
        if len(words) != 2:
            raise DataError(f"{path}, line {number}: {line.strip()[:60]!r} must be {expected}")
        pairs.append((words[0], words[1]))
    if not pairs:
        raise DataError(f"{path} lists no pairs; it must hold {expected} a line")
    return tuple(pairs)


def path_of(root: Path, pattern: str, name: str) -> Path:
    """The file of a shape by its name and a pattern with one star.

    Examples:
        >>> path_of(Path("data"), "off/*.off", "cat1").as_posix()
        'data/off/cat1.off'
    """
    return root / pattern.replace("*", name)


def names_at(root: Path, pattern: str) -> tuple[str, ...]:
    """The names of the existing files of a pattern, sorted; hidden files are skipped."""
    if not pattern:
        return ()
    head, tail = (len(part) for part in PurePosixPath(pattern).name.split("*"))
    found = (path.name for path in root.glob(pattern) if not path.name.startswith("."))
    return tuple(sorted(name[head : len(name) - tail] for name in found))


def partner(name: str, full: Iterable[str]) -> str:
    """The full shape of a partial one: the longest name that is a word, or several, of the partial shape's.

    Raises:
        DataError: if there is none.

    Examples:
        >>> partner("cuts_cat_shape_1", ["cat", "dog"])
        'cat'
    """
    found = [other for other in full if f"_{other}_" in f"_{name}_"]
    if not found:
        raise DataError(f"{name}: no full shape has a word of its name, as cat has of cuts_cat_shape_1; rename it")
    return max(found, key=len)


def demo_folder() -> ShapeFolder:
    """The two demo bodies with their ground truth; commands take its path, ``demo_folder().root``.

    Examples:
        >>> from homolog.datasets import demo_folder
        >>> demo_folder().names
        ('amber', 'boris')
    """
    return ShapeFolder.open(Path(__file__).parents[1] / "demo_data")


def class_of(name: str) -> str:
    """The class of a shape: its name without the last number.

    Examples:
        >>> class_of("cat10")
        'cat'
    """
    return re.sub(r"[\W_]*\d+$", "", name)


def drawn_pairs(pairs: Iterable[Pair], count: int, *, seed: int) -> tuple[Pair, ...]:
    """Sample pairs of two different shapes at random, without replacement; the sample keeps the given order.

    The pairs with the smallest SHA-256 of seed and names are taken: the sample is the same on every machine and with
    every version of any library, and is part of every larger sample with the same seed. New here.

    Raises:
        ArgumentError: if there are fewer pairs.

    Examples:
        >>> drawn_pairs([("a", "b"), ("b", "a"), ("a", "a")], 1, seed=0)
        (('b', 'a'),)
    """
    different = [pair for pair in dict.fromkeys(pairs) if pair[0] != pair[1]]
    if not 1 <= count <= len(different):
        raise bad_value("n_pairs", count, f"from 1 to the number of pairs of different shapes, {len(different)}")
    keys = {
        pair: hashlib.sha256(f"{seed} {pair[0]},{pair[1]}".encode(errors="surrogateescape")).digest()
        for pair in different
    }
    drawn = set(sorted(different, key=keys.__getitem__)[:count])
    return tuple(pair for pair in different if pair in drawn)
