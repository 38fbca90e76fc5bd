"""The plan of a dataset of views: which full shapes are for training and testing, and which view shows which."""

from __future__ import annotations

import re
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from homolog.core.errors import DataError
from homolog.core.files import expanded, sha256
from homolog.datasets import ShapeFolder, mesh_files

DatasetSplit = Literal["train", "test"]

# One in this many views is for testing; its full shapes are in no view for training.
TEST_EVERY = 5

# Streams of random numbers with one seed.
_SPLIT, _ORDER, _PARTNER = 0, 1, 2


@dataclass(frozen=True)
class PlannedView:
    """One view of the dataset.

    Args:
        name: of its files.
        split: for training or testing.
        viewed: the full shape that the camera sees.
        full: the full shape that the view is paired with, of the same split; possibly the viewed one. Of two views that
            are paired with each other, the one that the first of them shows.
        seed: of its camera and noise.
        apart: by how many degrees its camera is turned from that of the seed.
    """

    name: str
    split: DatasetSplit
    viewed: str
    full: str
    seed: int
    apart: float = 0.0


@dataclass(frozen=True)
class FullShapes:
    """The full shapes of a folder.

    Args:
        files: by name.
        splits: their names by split.
        truth_root: the folder with ``corres/``, if it has the template correspondence of all shapes.
    """

    files: dict[str, Path]
    splits: dict[DatasetSplit, tuple[str, ...]]
    truth_root: Path | None

    @classmethod
    def open(cls, source: str | Path, *, seed: int) -> FullShapes:
        """Open a folder with ``off/`` and perhaps ``corres/``, or any folder of meshes; the seed is that of the split.

        Raises:
            DataError: if it has fewer than two meshes, names that lists cannot hold, or splits that share a shape.
        """
        root = expanded(source)
        if not root.is_dir():
            raise DataError(f"{source}: there is no such folder; give one that holds meshes")
        files = mesh_files(root / "off" if (root / "off").is_dir() else root)
        _check_names(root, tuple(files))
        folder = ShapeFolder(root, tuple(files))
        known = all((root / "corres" / f"{name}.vts").is_file() for name in files)
        return cls(files, _splits(folder, seed), root if known else None)

    def described(self) -> dict[str, dict[str, str]]:
        """Split and hash of each file."""
        return {
            name: {"split": split, "sha256": sha256(self.files[name])}
            for split, names in self.splits.items()
            for name in sorted(names)
        }


def _check_names(root: Path, names: Sequence[str]) -> None:
    if len(names) < 2:
        raise DataError(f"{root} has {len(names)} mesh, but it takes 2, one to train on and one to test; add others")
    for name in names:
        if re.search(r"[\s,]", name) or re.fullmatch(r"view_\d{6}(_[ab])?", name):
            raise DataError(f"{root}: the name {name!r} has a blank or a comma, or is a view's; rename the file")


def _splits(folder: ShapeFolder, seed: int) -> dict[DatasetSplit, tuple[str, ...]]:
    if (folder.root / "train.txt").is_file() and (folder.root / "test.txt").is_file():
        train, test = folder.split("train"), folder.split("test")
        if shared := sorted({*train} & {*test}):
            raise DataError(f"{folder.root}: {shared[0]!r} is in train.txt and in test.txt; take it out of one")
        return {"train": train, "test": test}
    names = [folder.names[index] for index in np.random.default_rng([seed, _SPLIT]).permutation(len(folder.names))]
    n_test = max(round(len(names) / TEST_EVERY), 1)
    return {"train": tuple(names[n_test:]), "test": tuple(names[:n_test])}


def planned_view(shapes: FullShapes, number: int, *, seed: int) -> PlannedView:
    """The view with a given number, independent of the total; the shapes of a split alternate in a random order."""
    split: DatasetSplit = "test" if number % TEST_EVERY == TEST_EVERY - 1 else "train"
    names = shapes.splits[split]
    position = number // TEST_EVERY if split == "test" else number - number // TEST_EVERY
    viewed = np.random.default_rng([seed, _ORDER]).permutation(len(names))[position % len(names)]
    full = np.random.default_rng([seed, _PARTNER, number]).integers(len(names))
    name = f"view_{number:06d}"
    return PlannedView(name, split, names[viewed], names[full], zlib.crc32(f"{seed} {name}".encode()))


def planned_pair(
    shapes: FullShapes, number: int, *, seed: int, apart: float, two_shapes: bool = False
) -> tuple[PlannedView, PlannedView]:
    """The two views with a given number that are paired with each other, from cameras so many degrees apart.

    Both show the shape that the single view with this number would; or, of two shapes, the second view shows the one
    that it would be paired with.
    """
    first = planned_view(shapes, number, seed=seed)
    second = replace(first, name=f"{first.name}_b", viewed=first.full if two_shapes else first.viewed, apart=apart)
    return replace(first, name=f"{first.name}_a", full=first.viewed), replace(second, full=first.viewed)
