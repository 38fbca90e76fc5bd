"""Recipes: all that one can choose about a training, as typed settings read from TOML."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, get_args

from homolog.core.errors import ArgumentError, bad_choice, bad_value
from homolog.core.files import expanded
from homolog.core.settings import read_settings, read_toml
from homolog.datasets import DatasetDescription, Split
from homolog.features import AugmentationSettings, NetworkSettings
from homolog.geometry import OperatorSettings
from homolog.shapes import Up
from homolog.training.objective import LossSettings

Schedule = Literal["cosine", "constant", "one-cycle"]
Precision = Literal["32", "bf16"]

# In the package where it is installed, in the root of the repository where it is not.
_SHIPPED = (Path(__file__).parent / "recipes", Path(__file__).parents[3] / "recipes")


@dataclass(frozen=True)
class DataSettings:
    """Which shapes are trained on, and how they are kept at hand.

    Args:
        split: of a folder with ``off/``: ``"train"``, ``"test"`` or ``"all"``; other folders are used whole.
        leave_out: patterns such as ``"*_shape_1?"``; shapes with such names are neither trained nor validated on.
        up: which axis of the files points up; shapes are turned so that +y does. Left out, it is the one that the
            set's description names, and y where there is none.
        clouds: shapes without faces are trained on, too; their operators as clouds then stand for a mesh's.
        memory_gb: how much memory the prepared shapes may take; those beyond are read again from the disk cache.
        workers: threads that read and sample shapes while the steps before theirs are computed.
    """

    split: Split = "train"
    leave_out: tuple[str, ...] = ()
    up: Up | None = None
    clouds: bool = False
    memory_gb: float = 4.0
    workers: int = 1

    def __post_init__(self) -> None:
        _choose("split", self.split, Split)
        if self.up is not None:
            _choose("up", self.up, Up)
        _require("memory_gb", self.memory_gb, _positive, "a positive number of gigabytes")
        _require("workers", self.workers, _positive, "at least 1")


@dataclass(frozen=True)
class SampleSettings:
    """On which points of a shape a step is computed. Operators are those of all points in any case.

    Args:
        points: how many points of each shape, far from each other; 0 for all.
        subsets: how many such choices there are for each shape; a step draws one of them.
    """

    points: int = 1200
    subsets: int = 4

    def __post_init__(self) -> None:
        _require("points", self.points, _not_negative, "at least 1, or 0 for all points")
        _require("subsets", self.subsets, _positive, "at least 1")

    @property
    def choices(self) -> int:
        """How many subsets there are to draw from: all points are but one."""
        return self.subsets if self.points else 1


@dataclass(frozen=True)
class CloudSettings:
    """The clouds of a mesh that the network also learns: the mesh's own points, and variants, each as likely.

    Every variant is made once per shape and has operators of its own. A repeated value gives another such cloud.

    Args:
        noise: standard deviations of Gaussian noise on the mesh's points, in units of sqrt(area).
        thinned: shares of the mesh's points that are kept, chosen at random.
        resampled: numbers of points drawn evenly from the surface.
        cut: shares of the surface that are left where a plane cuts the rest away. A part looks like its whole where
            both are, which needs no correspondence to be known: that teaches what parts are parts of.
        pierced: numbers of holes eaten into the surface, likewise.
        seen: what a depth camera sees of the shape from somewhere around, likewise: standard deviations of the noise
            of its depths, in units of sqrt(area); 0 for none.
    """

    noise: tuple[float, ...] = ()
    subsampled: tuple[float, ...] = ()
    resampled: tuple[int, ...] = ()
    cut: tuple[float, ...] = ()
    holes: tuple[int, ...] = ()
    seen: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        for value in self.noise:
            _require("noise", value, _positive, "a list of positive numbers, in units of sqrt(area)")
        for value in self.subsampled:
            _require("thinned", value, lambda share: 0 < share < 1, "a list of shares between 0 and 1")
        for value in self.resampled:
            _require("resampled", value, lambda number: number >= 100, "a list of numbers of points, at least 100 each")
        for value in self.cut:
            _require("cut", value, lambda share: 0.1 <= share < 1, "a list of shares from 0.1 to below 1")
        for value in self.holes:
            _require("pierced", value, _positive, "a list of numbers of holes, at least 1 each")
        for value in self.seen:
            _require("seen", value, _not_negative, "a list of numbers that are at least 0, in units of sqrt(area)")


@dataclass(frozen=True)
class OptimiserSettings:
    """How weights follow gradients: Adam.

    Args:
        learning_rate: the highest that the schedule reaches.
        betas: decay of the mean of the gradients, and of their squares.
        weight_decay: share of a weight that is lost per step and unit of learning rate.
        gradient_clip: norm to which longer gradients are shortened; 0 for none.
        schedule: after the warm-up, ``"cosine"`` falls to zero, ``"constant"`` stays; ``"one-cycle"`` rises in a cosine
            for ``warmup_steps``, or three tenths of all steps if these are 0, and falls in another.
        warmup_steps: steps over which the learning rate rises to its highest.
        average: decay per step of a running average of the weights, such as 0.999; it is then the average that is
            validated and written. 0 for none.
    """

    learning_rate: float = 1e-3
    betas: tuple[float, float] = (0.9, 0.999)
    weight_decay: float = 0.0
    gradient_clip: float = 1.0
    schedule: Schedule = "cosine"
    warmup_steps: int = 0
    average: float = 0.0

    def __post_init__(self) -> None:
        _require("learning_rate", self.learning_rate, _positive, "a positive number")
        for beta in self.betas:
            _require("betas", beta, _below_one, "two numbers from 0 to below 1")
        _require("weight_decay", self.weight_decay, _not_negative, "at least 0")
        _require("gradient_clip", self.gradient_clip, _not_negative, "a positive number, or 0 for none")
        _choose("schedule", self.schedule, Schedule)
        _require("warmup_steps", self.warmup_steps, _not_negative, "at least 0")
        _require("average", self.average, _below_one, "from 0 to below 1")


@dataclass(frozen=True)
class TrainingSettings:
    """How long, and in what portions.

    Args:
        steps: changes of the weights.
        pairs_per_step: pairs of shapes whose mean gradient makes a step.
        precision: ``"32"``, or ``"bf16"`` for matrix products in bfloat16 on GPUs that have it.
        checkpoint_minutes: minutes between checkpoints; 0 for one after every step.
    """

    steps: int = 10_000
    pairs_per_step: int = 1
    precision: Precision = "32"
    checkpoint_minutes: float = 5.0

    def __post_init__(self) -> None:
        _require("steps", self.steps, _positive, "at least 1")
        _require("pairs_per_step", self.pairs_per_step, _positive, "at least 1")
        _choose("precision", self.precision, Precision)
        _require("checkpoint_minutes", self.checkpoint_minutes, _not_negative, "at least 0")


@dataclass(frozen=True)
class ValidationSettings:
    """How training is watched, on pairs that it does not use.

    Args:
        shapes: how many shapes of the split are kept out of training for it, drawn at random. With 0,
            shapes that are trained on are used.
        pairs: how many pairs of these; 0 for no validation.
        every: steps between validations by the training's own loss, without dropout or augmentation. The weights with
            the lowest one are the best.
        score_every: steps between scores by geodesic error at full resolution, where the folder has ground truth. They
            are reported, and decide nothing. 0 for never.
        score_pairs: how many of the pairs are scored.
    """

    shapes: int = 4
    pairs: int = 8
    every: int = 500
    score_every: int = 0
    score_pairs: int = 4

    def __post_init__(self) -> None:
        for name in ("shapes", "pairs", "score_every"):
            _require(name, getattr(self, name), _not_negative, "at least 0")
        for name in ("every", "score_pairs"):
            _require(name, getattr(self, name), _positive, "at least 1")
        if self.shapes == 1:
            raise bad_value("shapes", 1, "0, or at least 2 to make a pair")


@dataclass(frozen=True)
class PartialSettings:
    """Training on pairs of a complete shape and a part of one like it, in the same units.

    Where the data has the two folders, a part's partner is the complete shape whose name its own contains; otherwise
    any two shapes make a pair, or those that ``pairs.txt`` lists. The one with the larger area is the complete one.
    What is left out is as the set's description says.

    Args:
        complete: the folder of the complete shapes; ``"null"`` where nothing says otherwise.
        parts: the folder of the partial ones; ``"cuts"`` where nothing says otherwise.
        pre_aligned: parts lie in the coordinates of their complete shapes, about where they belong. Otherwise, as where
            nothing says so, only their form counts, and the positions of each are around its own middle.
    """

    complete: str | None = None
    parts: str | None = None
    pre_aligned: bool | None = None

    def __post_init__(self) -> None:
        if self.complete is not None and self.complete == self.parts:
            raise bad_value("parts", self.parts, "another folder than that of the complete shapes")

    def for_set(self, described: DatasetDescription) -> PartialSettings:
        """These settings with nothing left out.

        Raises:
            ArgumentError: if they name other folders than the description.
        """
        complete, parts = described.folders if described.full else (self.complete or "null", self.parts or "cuts")
        for key, given, wanted in (("complete", self.complete, complete), ("parts", self.parts, parts)):
            if given not in (None, wanted):
                raise ArgumentError(
                    f"[partial] {key} is {given!r}, but {described.name} has {wanted!r}; leave it out of the recipe"
                )
        return PartialSettings(complete, parts, described.pre_aligned if self.pre_aligned is None else self.pre_aligned)


@dataclass(frozen=True)
class Recipe:
    """A whole training.

    Args:
        name: of the weights.
        licence: terms of the weights, which follow from the data's.
        seed: of everything random: weights, order, augmentation, dropout, noise.
        data: which shapes.
        samples: on which points.
        clouds: which clouds of them.
        network: the architecture.
        operators: of the shapes.
        loss: weights and sizes of the losses.
        augmentation: of the network's input.
        optimiser: how weights follow gradients.
        training: how long.
        validation: how it is watched.
        partial: present where one shape of each pair is partial.
    """

    name: str = "untitled"
    licence: str = "unknown"
    seed: int = 0
    data: DataSettings = field(default_factory=DataSettings)
    samples: SampleSettings = field(default_factory=SampleSettings)
    clouds: CloudSettings = field(default_factory=CloudSettings)
    network: NetworkSettings = field(default_factory=NetworkSettings)
    operators: OperatorSettings = field(default_factory=OperatorSettings)
    loss: LossSettings = field(default_factory=LossSettings)
    augmentation: AugmentationSettings = field(default_factory=AugmentationSettings)
    optimiser: OptimiserSettings = field(default_factory=OptimiserSettings)
    training: TrainingSettings = field(default_factory=TrainingSettings)
    validation: ValidationSettings = field(default_factory=ValidationSettings)
    partial: PartialSettings | None = None

    def __post_init__(self) -> None:
        _require("seed", self.seed, _not_negative, "at least 0")
        # What sections ask of one another.
        n = self.operators.n_eigenpairs
        _require("[network] in_channels", self.network.in_channels, lambda given: given == 3, "3, for positions")
        _require(
            "[loss] map_eigenpairs", self.loss.map_eigenpairs, lambda size: size <= n, f"at most n_eigenpairs, {n}"
        )
        if self.partial is not None and self.loss.registration:
            raise bad_value(
                "[loss] registration",
                self.loss.registration,
                "0 with a section [partial], as registration is of full shapes",
            )
        # Coefficients of positions from as many samples as eigenpairs are off by a tenth, from twice as many by 2 %.
        _require(
            "[samples] points",
            self.samples.points,
            lambda points: points == 0 or points >= 2 * n,
            f"0 for all, or at least twice [operators] n_eigenpairs, {2 * n}",
        )
        for share in self.clouds.cut if self.samples.points else ():
            _require(
                "[clouds] cut",
                share,
                lambda kept: kept * self.samples.points >= 2 * n,
                f"at least {2 * n / self.samples.points:.2f}, where twice [operators] n_eigenpairs of [samples] points "
                "are left",
            )

    def for_set(self, description: DatasetDescription | None = None) -> Recipe:
        """The recipe for a set, or for a folder of one's own: with what it leaves to the description filled in.

        Raises:
            ArgumentError: if it names other folders of parts than the description.
        """
        described = description or DatasetDescription()
        data = replace(self.data, up=self.data.up or described.up)
        return replace(self, data=data, partial=self.partial and self.partial.for_set(described))


def read_recipe(recipe: str | Path) -> Recipe:
    """Read a recipe from a TOML file, or one that ships by its name.

    Raises:
        ArgumentError: if there is no such recipe, or it is not as it should be; one line with file, section and key.
    """
    path = find_recipe(recipe)
    return recipe_from(read_toml(path), str(path))


def recipe_from(table: dict[str, Any], where: str) -> Recipe:
    """A recipe from nested tables; ``where`` they come from is for messages."""
    return read_settings(Recipe, table, f"{where}:")


def find_recipe(recipe: str | Path) -> Path:
    """The file of a recipe that a user named: a path, or the name of one that ships.

    Raises:
        ArgumentError: if there is neither.
    """
    path = expanded(recipe)
    if path.is_file():
        return path
    shipped = builtin_recipes()
    if str(recipe) in shipped:
        return shipped[str(recipe)]
    raise bad_choice("recipe", str(recipe), list(shipped), "or give the path of a TOML file")


def builtin_recipes() -> dict[str, Path]:
    """Name and file of the recipes that ship with the package."""
    return {file.stem: file for folder in _SHIPPED for file in sorted(folder.glob("*.toml"))}


def _require(name: str, value: float, allowed: Callable[[float], bool], described: str) -> None:
    if not (math.isfinite(value) and allowed(value)):
        raise bad_value(name, value, described)


def _choose(name: str, word: str, words: Any) -> None:
    if word not in get_args(words):
        raise bad_choice(name, word, get_args(words))


def _positive(value: float) -> bool:
    return value > 0


def _not_negative(value: float) -> bool:
    return value >= 0


def _below_one(value: float) -> bool:
    return 0 <= value < 1
