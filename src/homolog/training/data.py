"""The shapes of a training and its pairs, found in a folder. Ground truth is not looked at."""

from __future__ import annotations

import itertools
import logging
from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np

from homolog.core.errors import ArgumentError, DataError
from homolog.core.files import expanded
from homolog.datasets import DatasetDescription, Pair, ShapeFolder, mesh_files, partner
from homolog.shapes import Shape, Up, read_shape, stand_upright
from homolog.training.recipe import DataSettings, Recipe

_log = logging.getLogger(__name__)

# What tells the choices at random from one another that are made with the recipe's seed.
_HELD_OUT, _VALIDATION = 0, 1


@dataclass(frozen=True)
class TrainingSet:
    """Which shapes to train on, and in which pairs.

    Args:
        root: the folder.
        files: the file of each shape that takes part, by name, held-out ones included.
        names: of the shapes to train on, where any two make a pair.
        pairs: to train on; empty where any two of ``names`` make one.
        held_out: pairs to validate on.
        truth: the folder with its ground truth, where it has one.
        up: which axis of the files points up.
        clouds: whether shapes may be without faces.
        described: the folder as its set's description has it, for which the points of some sets are shuffled: where
            row i is the same point of every shape, their order would tell what is to be found.
    """

    root: Path
    files: dict[str, Path]
    names: tuple[str, ...]
    pairs: tuple[Pair, ...]
    held_out: tuple[Pair, ...]
    truth: ShapeFolder | None
    up: Up
    clouds: bool = False
    described: ShapeFolder | None = None

    @classmethod
    def open(cls, root: str | Path, recipe: Recipe, description: DatasetDescription | None = None) -> TrainingSet:
        """Look into a folder: a set as its description has it, or one of one's own.

        That is ``off/NAME.off`` with or without ground truth, complete shapes and parts, or any meshes, or clouds.

        Raises:
            ArgumentError: if the recipe and the description do not fit each other.
            DataError: if it has too few shapes.
        """
        root = expanded(root)
        if not root.is_dir():
            raise DataError(f"{root}: there is no such folder; give one that holds shapes")
        recipe = recipe.for_set(description)
        up = recipe.data.up or "y"
        described = None if description is None else ShapeFolder.without_truth(root, description, up=up)
        complete, files = _complete_and_other_files(root, recipe, described)
        kept = sorted(name for name in files if not _left_out(name, recipe.data))
        chosen = _held_out(kept, recipe)
        trained = tuple(name for name in kept if name not in chosen)
        listed = _parts(kept, complete) if complete else _listed_pairs(described or _own(root, recipe), kept, recipe)
        watched = tuple(pair for pair in listed if not chosen.isdisjoint(pair))
        pairs = tuple(pair for pair in listed if chosen.isdisjoint(pair))
        _check_numbers(root, trained, listed, pairs)
        # Where nothing is held out, pairs that are trained on are validated, too.
        held_out = _some_pairs(sorted(chosen) or trained, watched or pairs, recipe)
        files = {**complete, **{name: files[name] for name in kept}}
        truth = _ground_truth(root, recipe, description)
        return cls(root, files, trained, pairs, held_out, truth, up, recipe.data.clouds, described)

    def shape(self, name: str) -> Shape:
        """Read one shape, and stand it upright.

        Raises:
            DataError: if it has no faces, and clouds were not asked for.
        """
        shape = self._upright(name)
        if shape.faces is None and not self.clouds:
            raise DataError(
                f"{self.files[name]} has no faces, but training is on meshes; make surfaces of clouds "
                "with homolog reconstruct, or have [data] clouds = true in the recipe"
            )
        return shape

    def _upright(self, name: str) -> Shape:
        if self.described is not None:
            return self.described.shape(name)
        return stand_upright(read_shape(self.files[name]), self.up)

    @property
    def used(self) -> tuple[str, ...]:
        """The names of all shapes in any pair."""
        paired = itertools.chain.from_iterable((*self.pairs, *self.held_out))
        return tuple(sorted({*paired, *(() if self.pairs else self.names)}))


def _complete_and_other_files(
    root: Path, recipe: Recipe, described: ShapeFolder | None
) -> tuple[dict[str, Path], dict[str, Path]]:
    """Complete shapes in a folder of their own, if there are such, and all others."""
    if described is not None:
        return _described_files(described, recipe)
    if recipe.partial is not None and (root / str(recipe.partial.complete)).is_dir():
        complete, parts = root / str(recipe.partial.complete), root / str(recipe.partial.parts)
        if not parts.is_dir():
            raise DataError(f"{root} has complete shapes, but no {recipe.partial.parts!r}; change [partial] parts")
        return _apart(mesh_files(complete), mesh_files(parts))
    return {}, _split_files(root, recipe.data)


def _described_files(folder: ShapeFolder, recipe: Recipe) -> tuple[dict[str, Path], dict[str, Path]]:
    if folder.description.partial and recipe.partial is None:
        raise ArgumentError(
            f"{folder.description.name} is a set of parts, but the recipe {recipe.name!r} has no section [partial]; "
            "take one that has, such as cuts or views"
        )
    names = folder.split(recipe.data.split)
    return {name: folder.file(name) for name in folder.full}, {name: folder.file(name) for name in sorted(names)}


def _apart(complete: dict[str, Path], parts: dict[str, Path]) -> tuple[dict[str, Path], dict[str, Path]]:
    for name in complete.keys() & parts.keys():
        raise DataError(f"{complete[name]} and {parts[name]} have one name; rename the partial one")
    return complete, parts


def _split_files(root: Path, settings: DataSettings) -> dict[str, Path]:
    if not (root / "off").is_dir():
        return mesh_files(root, clouds=settings.clouds)
    files = mesh_files(root / "off", clouds=settings.clouds)
    if not any((root / name).exists() for name in ("corres", "train.txt", "test.txt", "pairs.txt")):
        return files  # nothing is kept for tests where nothing could be scored
    names = ShapeFolder(root, tuple(sorted(files))).split(settings.split)
    return {name: files[name] for name in names}


def _left_out(name: str, settings: DataSettings) -> bool:
    return any(fnmatchcase(name, pattern) for pattern in settings.leave_out)


def _held_out(names: Sequence[str], recipe: Recipe) -> set[str]:
    """Shapes to validate on, drawn at random: in name order, every tenth one often has the same pose."""
    random = np.random.default_rng([recipe.seed, _HELD_OUT])
    return {str(name) for name in random.permutation(np.array(names, dtype=object))[: recipe.validation.shapes]}


def _own(root: Path, recipe: Recipe) -> ShapeFolder:
    """A folder of one's own with the names of all its shapes."""
    place = root / "off" if (root / "off").is_dir() else root
    return ShapeFolder(root, tuple(mesh_files(place, clouds=recipe.data.clouds)))


def _parts(names: Sequence[str], complete: dict[str, Path]) -> tuple[Pair, ...]:
    """Each part with its complete shape."""
    return tuple((partner(name, complete), name) for name in names)


def _listed_pairs(folder: ShapeFolder, names: Sequence[str], recipe: Recipe) -> tuple[Pair, ...]:
    """The pairs that a list or the classes of shapes give; none where any two make one."""
    if not _has_pairs_of_its_own(folder, recipe):
        return ()
    listed = (pair for pair in folder.pairs("all") if pair[0] != pair[1])
    kept = tuple(pair for pair in listed if set(names).issuperset(pair))
    if not kept:
        raise DataError(
            f"{folder.root / folder.description.pairs_file} lists no pair of shapes that are trained on; "
            "leave fewer of them out"
        )
    return kept


def _has_pairs_of_its_own(folder: ShapeFolder, recipe: Recipe) -> bool:
    """Whether not any two shapes make a pair: lists are for parts, as whole shapes' lists are for tests."""
    rule, listed = folder.description.pairs, folder.root / folder.description.pairs_file
    is_listed = rule == "listed" or (rule == "found" and listed.is_file())
    return rule == "same-class" or (recipe.partial is not None and is_listed)


def _check_numbers(root: Path, names: Sequence[str], listed: Sequence[Pair], pairs: Sequence[Pair]) -> None:
    if listed and not pairs:
        raise DataError(f"{root}: no pair is left to train on; hold fewer [validation] shapes out, or leave fewer out")
    if not listed and len(names) < 2:
        raise DataError(
            f"{root}: {len(names)} of its shapes are left to train on, but it takes at least 2; add some, hold fewer "
            "[validation] shapes out, or leave fewer out"
        )


def _some_pairs(names: Sequence[str], listed: Sequence[Pair], recipe: Recipe) -> tuple[Pair, ...]:
    """Pairs to validate on: the same for every training with the same data, number of pairs and seed."""
    random = np.random.default_rng([recipe.seed, _VALIDATION])
    n_all = len(listed) or len(names) * (len(names) - 1)
    chosen = random.choice(n_all, size=min(recipe.validation.pairs, n_all), replace=False)
    return tuple(listed[number] if listed else _pair(names, int(number)) for number in chosen)


def _pair(names: Sequence[str], number: int) -> Pair:
    """The ordered pair of two different names that has this number."""
    first, second = divmod(number, len(names) - 1)
    return names[first], names[second + (second >= first)]


def _ground_truth(root: Path, recipe: Recipe, description: DatasetDescription | None) -> ShapeFolder | None:
    if not recipe.validation.score_every:
        return None
    try:
        return ShapeFolder.open(root, description, up=recipe.data.up)
    except DataError as error:  # training needs none, so that an incomplete one does not matter
        _log.warning("no scores, though [validation] score_every is %d: %s", recipe.validation.score_every, error)
        return None
