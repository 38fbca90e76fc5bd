"""The shapes of a training and its pairs, found in a folder. Ground truth is for the loss ``supervised`` alone."""

from __future__ import annotations

import itertools
import logging
from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np
from jaxtyping import Int

from homolog.core.errors import ArgumentError, DataError
from homolog.core.files import expanded
from homolog.datasets import DatasetDescription, Pair, ShapeFolder, mesh_files, partner
from homolog.datasets.folder import path_of
from homolog.datasets.truth import check_vertices
from homolog.shapes import Shape, Up, read_shape, repair, stand_upright
from homolog.training.settings import DataSettings, PartialSettings, Recipe

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
        described: the folder as its dataset's description has it, which shuffles the points of some datasets: where
            row i is the same point of every shape, their order would tell the correspondence.
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
        """Look into a folder: a dataset as its description has it, or one of one's own.

        That is ``off/NAME.off`` with or without ground truth, full and partial shapes, or any meshes, or clouds.

        Raises:
            ArgumentError: if the recipe and the description do not fit each other.
            DataError: if it has too few shapes.
        """
        root = expanded(root)
        if not root.is_dir():
            raise DataError(f"{root}: there is no such folder; give one that holds shapes")
        recipe = recipe.for_dataset(description)
        data, partial, validation, seed = recipe.data, recipe.partial, recipe.validation, recipe.seed
        up = data.up or "y"
        described = None if description is None else ShapeFolder.without_truth(root, description, up=up)
        if described is not None and described.description.partial == "both":
            raise DataError(
                f"{described.description.name} is a dataset of pairs of parts, which are for evaluation; train on "
                "parts and full shapes, as homolog synth views makes them without --apart"
            )
        if described is not None and described.description.partial and partial is None:
            raise ArgumentError(
                f"{described.description.name} is a dataset of partial shapes, but the recipe {recipe.name!r} has no "
                "section [partial]; take one that has, such as cuts or views"
            )
        full, files = _full_and_other_files(root, data, partial, described)
        kept = sorted(name for name in files if not any(fnmatchcase(name, pattern) for pattern in data.leave_out))
        # At random: in name order, every tenth shape often has the same pose.
        shuffled = np.random.default_rng([seed, _HELD_OUT]).permutation(np.array(kept, dtype=object))
        chosen = {str(name) for name in shuffled[: validation.shapes]}
        trained = tuple(name for name in kept if name not in chosen)
        if full:
            listed = tuple((partner(name, full), name) for name in kept)
        else:
            listed = _listed_pairs(described or _own(root, data), kept, lists=partial is not None)
        watched = tuple(pair for pair in listed if not chosen.isdisjoint(pair))
        pairs = tuple(pair for pair in listed if chosen.isdisjoint(pair))
        _check_numbers(root, trained, listed, pairs)
        # Where nothing is held out, pairs that are trained on are validated, too.
        held_out = _some_pairs(sorted(chosen) or trained, watched or pairs, validation.pairs, seed)
        files = {**full, **{name: files[name] for name in kept}}
        truth = _ground_truth(root, recipe, description)
        return cls(root, files, trained, pairs, held_out, truth, up, data.clouds, described)

    def shape(self, name: str) -> Shape:
        """Read one shape, and stand it upright.

        Raises:
            DataError: if it has no faces, and clouds were not asked for.
        """
        if self.described is not None:
            shape = self.described.shape(name)
        else:
            shape = stand_upright(read_shape(self.files[name]), self.up)
        if shape.faces is None and not self.clouds:
            raise DataError(
                f"{self.files[name]} has no faces, but training is on meshes; make surfaces of clouds "
                "with homolog reconstruct, or have [data] clouds = true in the recipe"
            )
        return shape

    def template(self, name: str) -> Int[np.ndarray, " t"]:
        """For each point of the template the point of the repaired shape that lies there, or -1: the ground truth.

        Raises:
            DataError: if there is no template, or the file of the shape's truth is not as it should be.
        """
        folder = self.described or ShapeFolder(self.root, self.names)
        if folder.description.truth != "template-correspondence":
            raise DataError(
                f"{self.root} has no template, but {folder.description.truth!r}; leave out the loss supervised"
            )
        shape, vertices = self.shape(name), folder.template_correspondence(name)
        check_vertices(path_of(folder.root, folder.description.truth_files, name), vertices, shape, "get both again")
        return np.where(vertices < 0, -1, repair(shape).clean_index[vertices])

    @property
    def used(self) -> tuple[str, ...]:
        """The names of all shapes in any pair."""
        return tuple(sorted({*self.trained, *itertools.chain.from_iterable(self.held_out)}))

    @property
    def trained(self) -> tuple[str, ...]:
        """The names of all shapes that are trained on, in any pair."""
        return tuple(sorted(set(itertools.chain.from_iterable(self.pairs)))) or self.names


def _full_and_other_files(
    root: Path, data: DataSettings, partial: PartialSettings | None, described: ShapeFolder | None
) -> tuple[dict[str, Path], dict[str, Path]]:
    """Full shapes in a folder of their own, if there are such, and all others."""
    if described is not None:
        names = sorted(described.split(data.split))
        return {name: described.file(name) for name in described.full}, {n: described.file(n) for n in names}
    if partial is None or not (root / str(partial.full)).is_dir():
        return {}, _split_files(root, data)
    if not (root / str(partial.parts)).is_dir():
        raise DataError(f"{root} has full shapes, but no folder {partial.parts!r}; change [partial] parts")
    full, parts = mesh_files(root / str(partial.full)), mesh_files(root / str(partial.parts))
    for name in full.keys() & parts.keys():
        raise DataError(f"{full[name]} and {parts[name]} have one name; rename the partial one")
    return full, parts


def _split_files(root: Path, settings: DataSettings) -> dict[str, Path]:
    if not (root / "off").is_dir():
        return mesh_files(root, clouds=settings.clouds)
    files = mesh_files(root / "off", clouds=settings.clouds)
    if not any((root / name).exists() for name in ("corres", "train.txt", "test.txt", "pairs.txt")):
        return files  # nothing is kept for tests where nothing could be scored
    names = ShapeFolder(root, tuple(sorted(files))).split(settings.split)
    return {name: files[name] for name in names}


def _own(root: Path, settings: DataSettings) -> ShapeFolder:
    """A folder of one's own with the names of all its shapes."""
    place = root / "off" if (root / "off").is_dir() else root
    return ShapeFolder(root, tuple(mesh_files(place, clouds=settings.clouds)))


def _listed_pairs(folder: ShapeFolder, names: Sequence[str], *, lists: bool) -> tuple[Pair, ...]:
    """The pairs that a list or the classes of shapes give; none where any two make one.

    Lists count where ``lists`` is true, for partial shapes: full shapes' lists are for tests.
    """
    rule, file = folder.description.pairs, folder.root / folder.description.pairs_file
    is_listed = rule == "listed" or (rule == "found" and file.is_file())
    if not (rule == "same-class" or (lists and is_listed)):
        return ()
    listed = (pair for pair in folder.pairs("all") if pair[0] != pair[1])
    kept = tuple(pair for pair in listed if set(names).issuperset(pair))
    if not kept:
        raise DataError(f"{file} lists no pair of shapes that are trained on; leave fewer of them out")
    return kept


def _check_numbers(root: Path, names: Sequence[str], listed: Sequence[Pair], pairs: Sequence[Pair]) -> None:
    if listed and not pairs:
        raise DataError(f"{root}: no pair is left to train on; hold fewer [validation] shapes out, or leave fewer out")
    if not listed and len(names) < 2:
        raise DataError(
            f"{root}: {len(names)} of its shapes are left to train on, but it takes at least 2; add some, hold fewer "
            "[validation] shapes out, or leave fewer out"
        )


def _some_pairs(names: Sequence[str], listed: Sequence[Pair], number: int, seed: int) -> tuple[Pair, ...]:
    """Pairs to validate on: the same for every training with the same data, number of pairs and seed."""
    random = np.random.default_rng([seed, _VALIDATION])
    n_all = len(listed) or len(names) * (len(names) - 1)
    chosen = random.choice(n_all, size=min(number, n_all), replace=False)
    if listed:
        return tuple(listed[i] for i in chosen)
    first, second = np.divmod(chosen, len(names) - 1)
    second += second >= first  # of a pair, both are different
    return tuple((names[i], names[j]) for i, j in zip(first, second, strict=True))


def _ground_truth(root: Path, recipe: Recipe, description: DatasetDescription | None) -> ShapeFolder | None:
    if not recipe.validation.score_every:
        return None
    try:
        return ShapeFolder.open(root, description, up=recipe.data.up)
    except DataError as error:  # training needs none, so that an incomplete one does not matter
        _log.warning("no scores, though [validation] score_every is %d: %s", recipe.validation.score_every, error)
        return None
