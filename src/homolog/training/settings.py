"""All settings of a recipe: what one can choose about a training."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Annotated, Any, Literal

from annotated_types import Ge, Gt, Lt

from homolog.core.arguments import is_real
from homolog.core.choices import Turn
from homolog.core.errors import ArgumentError, bad_value
from homolog.core.settings import Count, CountOrZero, NotNegative, Positive, Settings, Share, unknown_key
from homolog.datasets import DatasetDescription, Split
from homolog.features import NetworkSettings
from homolog.geometry import OperatorSettings
from homolog.shapes import Up
from homolog.training.losses import BUILTIN_LOSSES, installed_losses
from homolog.training.quantities import QuantitySettings

Schedule = Literal["cosine", "constant", "one-cycle"]
Precision = Literal["32", "bf16"]
TrainedInput = Literal["xyz", "xyz+wks"]
AUTO_LENDER, NO_LENDER = "auto", "none"
"""The orienter of pretrained weights that know the training shapes, if any do; or in no case another's."""


@dataclass(frozen=True, kw_only=True)
class DataSettings(Settings):
    """Which shapes are trained on, and how they are kept at hand.

    Args:
        split: of a folder with ``off/``: ``"train"``, ``"test"`` or ``"all"``. All shapes of other folders are used.
        leave_out: patterns such as ``"*_shape_1?"``. Shapes with such names are neither trained nor validated on.
        up: which axis of the files points up; shapes are turned so that +y does. If absent, the axis that the dataset's
            description names, or y.
        align: turn all shapes first so that they stand as the most central of them does, by their form alone, or as the
            orienter of the weights to start from finds them. For full shapes that do not stand alike.
        clouds: train on shapes without faces, too. Their operators as clouds then stand for a mesh's.
        memory_gb: memory for the preprocessed shapes, in gigabytes. Those beyond it are read again from the disk cache.
        workers: threads that read and sample shapes while earlier steps are computed.
    """

    split: Split = "train"
    leave_out: tuple[str, ...] = ()
    up: Up | None = None
    align: bool = False
    clouds: bool = False
    memory_gb: Positive = 4.0
    workers: Count = 1


@dataclass(frozen=True, kw_only=True)
class SampleSettings(Settings):
    """On which points of a shape a step is computed. Operators are those of all points in any case.

    Args:
        points: points of each shape, far from each other; 0 for all.
        subsets: how many such choices there are for each shape. A step draws one of them.
    """

    points: Annotated[CountOrZero, "0 for all points"] = 1200
    subsets: Count = 4

    @property
    def choices(self) -> int:
        """How many subsets there are to draw from: all points are one."""
        return self.subsets if self.points else 1


@dataclass(frozen=True, kw_only=True)
class CloudSettings(Settings):
    """The clouds of a mesh that the network also learns: the mesh's own points and these variants, each as likely.

    Every variant is made once per shape and has its own operators. A repeated value gives another such cloud. ``cut``,
    ``holes`` and ``views`` are partial clouds of the shape: the counterpart of each of their points is known, which
    teaches partial matching without ground truth.

    Args:
        noise: standard deviations of Gaussian noise on the mesh's points, in units of sqrt(area).
        subsampled: shares of the mesh's points that are kept, chosen at random.
        resampled: numbers of points drawn evenly from the surface.
        cut: shares of the surface that are left when a plane cuts the rest away.
        holes: numbers of holes cut into the surface.
        hole_radius: the least and the greatest radius of these, along the surface, in units of sqrt(area).
        part_meshes: give each shape that is cut or has holes as a mesh, too, with the triangles that are left.
        views: partial views by a depth camera: standard deviations of the noise of its depths, in units of sqrt(area);
            0 for none.
    """

    noise: tuple[Positive, ...] = ()
    subsampled: tuple[Annotated[float, Gt(0), Lt(1)], ...] = ()
    resampled: tuple[Annotated[int, Ge(100)], ...] = ()
    cut: tuple[Annotated[float, Ge(0.1), Lt(1)], ...] = ()
    holes: tuple[Count, ...] = ()
    hole_radius: tuple[Positive, Positive] = (0.03, 0.08)
    part_meshes: bool = False
    views: tuple[NotNegative, ...] = ()


@dataclass(frozen=True, kw_only=True)
class LossSettings(QuantitySettings):
    """The losses: weights, and what they are computed with. The defaults are the paper's but for ``raw_products``.

    In a recipe each weight is a key of its own in ``[loss]``: ``infonce = 5.0``. The fields of ``QuantitySettings`` are
    among its own.

    Args:
        weights: of the losses, by name; absent ones have their default weight. Losses of weight 0 are not computed.
        functions: losses of one's own, by name: ``"package.module:function"``, which is imported. Those installed under
            the entry-point group ``homolog.losses`` need no entry here.
    """

    weights: dict[str, Any] = field(default_factory=dict)
    functions: dict[str, str] = field(default_factory=dict)

    def check(self) -> None:
        """Weights are numbers of at least 0, of losses that there are; absent ones get their defaults."""
        for name in self.functions:
            if name in BUILTIN_LOSSES:
                raise ArgumentError(f"[loss.functions] has {name!r}, which is a built-in loss; give yours another name")
        known = [*BUILTIN_LOSSES, *self.functions, *installed_losses()]
        for name, weight in self.weights.items():
            if name not in known:
                keys = [*known, *self.__dataclass_fields__]
                raise ArgumentError(unknown_key(name, [key for key in keys if key != "weights"]))
            if not (is_real(weight) and weight >= 0):
                raise bad_value(name, weight, "a number of at least 0")
        given = {name: float(weight) for name, weight in self.weights.items()}
        defaults = {name: loss.weight for name, loss in BUILTIN_LOSSES.items()}
        object.__setattr__(self, "weights", {**defaults, **given})


@dataclass(frozen=True, kw_only=True)
class AugmentationSettings(Settings):
    """How the network's input positions are varied, drawn anew for each pass. Operators stay as they are.

    Args:
        turn: ``"none"``, about the ``"vertical"`` axis (y), or ``"any"`` rotation, all of them as likely.
        degrees: largest angle of a turn about the vertical, to either side.
        tilt: largest angle, in degrees, by which the vertical leans, in any direction. An orienter knows it to some 10.
        least_scale: smallest factor per axis.
        most_scale: largest factor per axis.
        shift: standard deviation of a shift along each axis, in units of sqrt(area). For partial shapes, which seldom
            lie exactly where they belong.
        jitter: standard deviation of noise per coordinate, in units of sqrt(area).
        largest_jitter: where that noise is clipped.
    """

    turn: Turn = "vertical"
    degrees: NotNegative = 90.0
    tilt: NotNegative = 0.0
    least_scale: Positive = 0.9
    most_scale: NotNegative = 1.1
    shift: NotNegative = 0.0
    jitter: NotNegative = 0.01
    largest_jitter: NotNegative = 0.05

    def check(self) -> None:
        """The range of scales is not empty."""
        if self.least_scale > self.most_scale:
            raise bad_value("least_scale", self.least_scale, f"above 0 and at most most_scale, {self.most_scale:g}")


@dataclass(frozen=True, kw_only=True)
class OptimiserSettings(Settings):
    """How weights follow gradients: Adam.

    Args:
        learning_rate: the highest that the schedule reaches.
        betas: decay of the mean of the gradients, and of their squares.
        weight_decay: share of a weight that is lost per step and unit of learning rate.
        gradient_clip: norm to which longer gradients are shortened; 0 for none.
        schedule: after the warm-up, ``"cosine"`` falls to zero and ``"constant"`` stays; ``"one-cycle"`` rises in a
            cosine for ``warmup_steps``, or three tenths of all steps if these are 0, and falls in another.
        warmup_steps: steps over which the learning rate rises to its highest.
        average: decay per step of a running average of the weights, such as 0.999. The average is then validated and
            written. 0 for none.
    """

    learning_rate: Positive = 1e-3
    betas: tuple[Share, Share] = (0.9, 0.999)
    weight_decay: NotNegative = 0.0
    gradient_clip: Annotated[NotNegative, "0 for none"] = 1.0
    schedule: Schedule = "cosine"
    warmup_steps: CountOrZero = 0
    average: Annotated[Share, "0 for none"] = 0.0


@dataclass(frozen=True, kw_only=True)
class OrienterSettings(Settings):
    """The orienter: a small network that tells how to turn a shape, learned after the other from the same shapes.

    Weights with ``upright = false`` need none, and get none.

    Args:
        lender: weights whose orienter is taken in place of one trained on these shapes: ``"auto"`` for pretrained ones
            that know them, if any do; ``"none"``; or a file, or the name of pretrained weights. A lent one saw many
            more shapes than most trainings have.
        lent_steps: updates of a lent orienter on these shapes, so that it comes to know their partial clouds, say; 0 to
            leave it as it is.
        steps: updates of the weights of an orienter of its own; 0 for no orienter.
        shapes_per_step: shapes whose mean gradient makes a step.
        learning_rate: the highest; it rises over 100 steps and falls in a cosine.
    """

    lender: str = AUTO_LENDER
    lent_steps: CountOrZero = 0
    steps: Annotated[CountOrZero, "0 for no orienter"] = 4000
    shapes_per_step: Count = 4
    learning_rate: Positive = 2e-3


@dataclass(frozen=True, kw_only=True)
class TrainingSettings(Settings):
    """How long, and in what portions.

    Args:
        steps: updates of the weights; 0 to leave those that it starts from as they are, and give them an orienter.
        pairs_per_step: pairs of shapes whose mean gradient makes a step.
        precision: ``"32"``, or ``"bf16"`` for matrix products in bfloat16 on GPUs that have it.
        checkpoint_minutes: minutes between checkpoints; 0 for one after every step.
    """

    steps: Annotated[CountOrZero, "0 for an orienter alone"] = 10_000
    pairs_per_step: Count = 1
    precision: Precision = "32"
    checkpoint_minutes: NotNegative = 5.0


@dataclass(frozen=True, kw_only=True)
class ValidationSettings(Settings):
    """How training is watched, on pairs that it does not use.

    Args:
        shapes: shapes of the split that are held out for validation, drawn at random. With 0, shapes that are
            trained on are used.
        pairs: pairs of these; 0 for no validation.
        every: steps between validations by the training's own loss, without dropout or augmentation. The weights with
            the lowest one are the best.
        score_every: steps between scores by geodesic error at full resolution, where the folder has ground truth. They
            are reported and decide nothing. 0 for never.
        score_pairs: how many of the pairs are scored.
    """

    shapes: CountOrZero = 4
    pairs: Annotated[CountOrZero, "0 for no validation"] = 8
    every: Count = 500
    score_every: Annotated[CountOrZero, "0 for never"] = 0
    score_pairs: Count = 4

    def check(self) -> None:
        """Held-out shapes make a pair."""
        if self.shapes == 1:
            raise bad_value("shapes", 1, "0, or at least 2 to make a pair")


@dataclass(frozen=True, kw_only=True)
class PartialSettings(Settings):
    """Training on pairs of a full and a partial shape, in the same units.

    Where the data has the two folders, the partner of a partial shape is the full shape whose name its own contains.
    Otherwise any two shapes make a pair, or those that ``pairs.txt`` lists. The one with the larger area is the full
    one. What is left out is as the dataset's description says.

    Args:
        full: folder of the full shapes; ``"null"`` by default.
        parts: folder of the partial shapes; ``"cuts"`` by default.
        pre_aligned: partial shapes lie in the coordinates of their full shapes, about where they belong. Otherwise, and
            by default, the positions of each are around its own centre.
    """

    full: str | None = None
    parts: str | None = None
    pre_aligned: bool | None = None

    def check(self) -> None:
        """The two folders differ."""
        if self.full is not None and self.full == self.parts:
            raise bad_value("parts", self.parts, "another folder than that of the full shapes")

    def for_dataset(self, description: DatasetDescription) -> PartialSettings:
        """These settings with nothing left out.

        Raises:
            ArgumentError: if they name other folders than the description.
        """
        full, parts = description.folders if description.partial else (self.full or "null", self.parts or "cuts")
        for key, given, target in (("full", self.full, full), ("parts", self.parts, parts)):
            if given not in (None, target):
                raise ArgumentError(
                    f"[partial] {key} is {given!r}, but {description.name} has {target!r}; leave it out of the recipe"
                )
        pre_aligned = description.pre_aligned if self.pre_aligned is None else self.pre_aligned
        return PartialSettings(full=full, parts=parts, pre_aligned=pre_aligned)


@dataclass(frozen=True, kw_only=True)
class Recipe(Settings):
    """A whole training.

    Args:
        name: of the weights.
        licence: terms of the weights, which follow from the data's.
        upright: stored with the weights: shapes must stand as those trained on did, +y up and facing +z. False for a
            training on shapes in any pose, with ``turn = "any"``.
        near_isometric: stored with the weights: the shapes bend without stretching much, so that meshes are matched by
            functional maps and all maps are refined as such. False for organs and the like.
        input: what features are computed from, stored with the weights: positions, ``"xyz"``, or wave kernel signatures
            beside them, ``"xyz+wks"``. The signatures are not augmented.
        seed: of everything random: initial weights, order, augmentation, dropout, noise.
        data: which shapes.
        samples: on which points.
        clouds: which clouds of them.
        network: the architecture.
        operators: of the shapes.
        loss: the losses.
        augmentation: of the network's input.
        optimiser: how weights follow gradients.
        training: how long.
        orienter: which turns shapes before they are matched.
        validation: how it is watched.
        partial: present where one shape of each pair is partial.

    Examples:
        >>> from homolog.training import Recipe
        >>> Recipe(name="teeth", upright=False).training.steps
        10000
    """

    name: str = "untitled"
    licence: str = "unknown"
    upright: bool = True
    near_isometric: bool = True
    input: TrainedInput = "xyz"
    seed: CountOrZero = 0
    data: DataSettings = field(default_factory=DataSettings)
    samples: SampleSettings = field(default_factory=SampleSettings)
    clouds: CloudSettings = field(default_factory=CloudSettings)
    network: NetworkSettings = field(default_factory=NetworkSettings)
    operators: OperatorSettings = field(default_factory=OperatorSettings)
    loss: LossSettings = field(default_factory=LossSettings)
    augmentation: AugmentationSettings = field(default_factory=AugmentationSettings)
    optimiser: OptimiserSettings = field(default_factory=OptimiserSettings)
    training: TrainingSettings = field(default_factory=TrainingSettings)
    orienter: OrienterSettings = field(default_factory=OrienterSettings)
    validation: ValidationSettings = field(default_factory=ValidationSettings)
    partial: PartialSettings | None = None

    def check(self) -> None:
        """What sections ask of one another."""
        n, points, registration = self.operators.n_eigenpairs, self.samples.points, self.loss.weights["registration"]
        channels = self.network.in_channels
        if self.input == "xyz" and channels != 3:
            raise bad_value("[network] in_channels", channels, "3, for positions")
        if self.input != "xyz" and channels <= 3:
            raise bad_value("[network] in_channels", channels, "more than 3, for positions and signatures, such as 131")
        if self.loss.map_eigenpairs > n:
            raise bad_value("[loss] map_eigenpairs", self.loss.map_eigenpairs, f"at most n_eigenpairs, {n}")
        if self.partial is not None and registration:
            allowed = "0 with a section [partial], as registration is of full shapes"
            raise bad_value("[loss] registration", registration, allowed)
        if self.partial is not None and self.data.align:
            raise bad_value("[data] align", True, "false with a section [partial], as only full shapes can be aligned")
        # Coefficients of positions from as many samples as eigenpairs are off by a tenth, from twice as many by 2 %.
        if 0 < points < 2 * n:
            allowed = f"0 for all, or at least twice [operators] n_eigenpairs, {2 * n}"
            raise bad_value("[samples] points", points, allowed)
        for share in self.clouds.cut:
            if 0 < share * points < 2 * n:
                left = "where twice [operators] n_eigenpairs of [samples] points are left"
                raise bad_value("[clouds] cut", share, f"at least {2 * n / points:.2f}, {left}")

    def for_dataset(self, description: DatasetDescription | None = None) -> Recipe:
        """The recipe for a dataset, or for a folder of one's own: what it leaves to the description is filled in.

        Raises:
            ArgumentError: if it names other folders of partial shapes than the description.
        """
        described = description or DatasetDescription()
        data = replace(self.data, up=self.data.up or described.up)
        return replace(self, data=data, partial=self.partial and self.partial.for_dataset(described))

    @classmethod
    def json_schema(cls) -> dict[str, Any]:
        """The JSON Schema of recipe files, with which editors complete and check them."""
        from pydantic import TypeAdapter

        schema = TypeAdapter(cls).json_schema()
        loss = schema["$defs"]["LossSettings"]
        del loss["properties"]["weights"]
        for name, built_in in BUILTIN_LOSSES.items():
            loss["properties"][name] = {"type": "number", "minimum": 0, "default": built_in.weight}
        loss["additionalProperties"] = {"type": "number", "minimum": 0}  # losses of one's own
        return schema
