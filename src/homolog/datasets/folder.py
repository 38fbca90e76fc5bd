"""A folder of shapes with ground truth, ``off/NAME.off`` and ``corres/NAME.vts``, and lists of pairs and splits."""

from __future__ import annotations

import hashlib
import itertools
import warnings
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

import numpy as np
from jaxtyping import Int

from homolog.errors import DataError, bad_choice, bad_value
from homolog.files import expanded
from homolog.shapes import Shape, Up, read_shape, stand_upright

Split = Literal["train", "test", "all"]
Pair = tuple[str, str]

# Without a list of its own, a set keeps its last shapes in name order for testing, as FAUST_r and SCAPE_r do.
_TEST_SHAPES = 20


@dataclass(frozen=True)
class ShapeFolder:
    """Shapes in correspondence on disk.

    Line i of every ``corres/NAME.vts`` holds the 1-based index of the vertex of NAME nearest to the i-th common point;
    -1 where NAME, a part, lacks it. Splits are ``train.txt`` and ``test.txt``, a name a line; without them the
    last 20 shapes in name order are the test set, or all of them where ``pairs.txt`` lists the pairs. ``pairs.txt``
    holds ``source,target`` a line.

    Args:
        root: the folder.
        names: of all its shapes, in order.
        up: which axis of the files points up.
    """

    root: Path
    names: tuple[str, ...]
    up: Up = "y"

    @classmethod
    def open(cls, root: str | Path, *, up: Up = "y") -> ShapeFolder:
        """Look into a folder whose shapes stand with this axis up.

        Raises:
            ArgumentError: if ``up`` is not x, y or z.
            DataError: if it has no shapes or no ground truth.
        """
        root = expanded(root)
        names = tuple(sorted(path.stem for path in (root / "off").glob("*.off")))
        if not names:
            raise DataError(f"{root}: no shapes; put them at {root / 'off'}/NAME.off")
        missing = [name for name in names if not (root / "corres" / f"{name}.vts").is_file()]
        if missing:
            raise DataError(
                f"{root}: {len(missing)} of {len(names)} shapes have no ground truth; "
                f"put the first one's at {root / 'corres' / missing[0]}.vts"
            )
        if up not in get_args(Up):
            raise bad_choice("up", up, get_args(Up))
        return cls(root, names, up)

    def shape(self, name: str) -> Shape:
        """Read one shape, and stand it upright: +y up."""
        return stand_upright(read_shape(self.root / "off" / f"{name}.off"), self.up)

    def common_points(self, name: str) -> Int[np.ndarray, " p"]:
        """0-based vertex index of each common point; -1 for those that the shape does not have.

        Raises:
            DataError: if the file does not hold positive whole numbers, one a line.
        """
        path = self.root / "corres" / f"{name}.vts"
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")  # an empty file, or a number with a fraction
                indices = np.loadtxt(path, dtype=np.int64, ndmin=1)
        except (OSError, ValueError, OverflowError, Warning) as error:
            raise DataError(f"{path} must hold a vertex number a line ({error})") from None
        if indices.ndim != 1 or indices.size == 0 or np.any((indices < 1) & (indices != -1)):
            raise DataError(f"{path} must hold a vertex number a line, counted from 1, or -1 for none")
        return np.where(indices < 0, -1, indices - 1)

    def split(self, split: Split) -> tuple[str, ...]:
        """The names of the shapes in a split.

        Raises:
            ArgumentError: if ``split`` is not one.
            DataError: if the split has no shapes, or lists one that is not there.
        """
        if split not in get_args(Split):
            raise bad_choice("split", split, get_args(Split))
        if split == "all":
            return self.names
        listed = self.root / f"{split}.txt"
        names = self._listed_names(listed) if listed.is_file() else self._split_by_order(split)
        if not names:
            raise DataError(f"{self.root}: no shapes in split {split!r}; list them in {listed}, or use split 'all'")
        return names

    def pairs(self, split: Split, *, listed: str | Path | None = None) -> tuple[Pair, ...]:
        """Source and target of each pair to match: as listed in a file, or every two shapes of the split, in order.

        Args:
            split: where the shapes come from; only pairs with both shapes in it are kept from ``pairs.txt``.
            listed: a file of ``source,target`` lines to use instead, whatever the split.
        """
        if listed is not None:
            return self._read_pairs(expanded(listed))
        names = self.split(split)
        own = self.root / "pairs.txt"
        if not own.is_file():
            return tuple((source, target) for source in names for target in names)
        pairs = tuple(pair for pair in self._read_pairs(own) if set(pair) <= set(names))
        if not pairs:
            raise DataError(
                f"{own} lists no pair with both shapes in split {split!r}; use split 'all', or another list of pairs"
            )
        return pairs

    def _listed_names(self, listed: Path) -> tuple[str, ...]:
        try:
            names = tuple(listed.read_text(encoding="utf-8").split())
        except (OSError, UnicodeDecodeError):
            raise DataError(f"{listed} cannot be read as text; it must hold a name a line") from None
        return self._known(names, listed)

    def _split_by_order(self, split: Split) -> tuple[str, ...]:
        if (self.root / "pairs.txt").is_file():
            return self.names if split == "test" else ()
        return self.names[-_TEST_SHAPES:] if split == "test" else self.names[:-_TEST_SHAPES]

    def _read_pairs(self, path: Path) -> tuple[Pair, ...]:
        try:
            lines = path.read_text(encoding="utf-8").splitlines()
        except (OSError, UnicodeDecodeError):
            raise DataError(f"{path}: there is no such list of pairs; it must hold SOURCE,TARGET a line") from None
        pairs = []
        for number, line in enumerate(lines, 1):
            words = tuple(word.strip() for word in line.split(","))
            if words == ("",):
                continue
            if len(words) != 2:
                raise DataError(f"{path}, line {number}: {line.strip()[:60]!r} must be SOURCE,TARGET")
            pairs.append((words[0], words[1]))
        if not pairs:
            raise DataError(f"{path} lists no pairs; it must hold SOURCE,TARGET a line")
        self._known(tuple(itertools.chain.from_iterable(pairs)), path)
        return tuple(pairs)

    def _known(self, names: tuple[str, ...], listed: Path) -> tuple[str, ...]:
        unknown = sorted(set(names) - set(self.names))
        if unknown:
            raise DataError(f"{listed} names {unknown[0]!r}, but {self.root / 'off'} has no {unknown[0]}.off")
        return names


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
