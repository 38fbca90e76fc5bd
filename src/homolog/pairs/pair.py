"""Two shapes on their way to a match, and the point maps between them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import torch
from jaxtyping import Float, Int
from numpy.typing import ArrayLike
from torch import Tensor

from homolog.core.arguments import check_kind
from homolog.core.choices import Side
from homolog.core.errors import ArgumentError
from homolog.core.progress import Timings
from homolog.features import FeatureExtractor, FeatureInfo
from homolog.geometry import outward
from homolog.maps import RegistrationStart, Similarity
from homolog.pairs.guidance import Guidance
from homolog.pairs.method import Method, check_supported
from homolog.pairs.options import SIDES, PairOptions
from homolog.pairs.preprocessing import PreprocessedShape, Preprocessor
from homolog.pairs.settings import MatcherSettings
from homolog.shapes import Modality, Shape

# Eigenpairs of the functional map to a partial shape, with features of full shapes alone.
_PARTIAL_SIZE = 50


@dataclass(frozen=True, eq=False)
class PointMaps:
    """Point maps between the repaired shapes x and y of a ``Pair``; every point has a counterpart.

    Their indices are those of the operators. ``Match.of(pair, maps)`` gives those of the files. Methods may also give
    arrays or lists.

    Args:
        x_to_y: for each point of x its point of y (n_x,).
        y_to_x: for each point of y its point of x (n_y,).
    """

    x_to_y: Int[Tensor, " n_x"]
    y_to_x: Int[Tensor, " n_y"]


@dataclass(frozen=True)
class PairOrientation:
    """How sure it is which way round two shapes are.

    Args:
        misfit: of the hypothesis that was taken, see ``OrientationSettings``.
        runner_up: of the best of those that lead to another map; None where there was no other.
        margin: by how much it is worse; negative where it is better: for an alternative, or where the files' way was
            kept, as no other was clearly better.
        ambiguous: whether the two differ by less than what can be told apart.
    """

    misfit: float
    runner_up: float | None = None
    margin: float | None = None
    ambiguous: bool = False


@dataclass(frozen=True)
class PartsFit:
    """How well two parts lie on each other once one of them was moved as a rigid body.

    Args:
        source: share of the source's points that lie on the target's surface, near their counterparts by features.
        target: likewise of the target's.
        rigid: whether these are enough to take the parts for those of one rigid body; see ``PartsSettings``.
    """

    source: float
    target: float
    rigid: bool


@dataclass(frozen=True)
class Candidate:
    """Features that may suit a pair, or a method without any.

    Args:
        name: of the features, or of the method.
        misfit: how little the features know the shape of the pair that they know less, see ``ChoiceSettings``; None of
            a method.
        map_misfit: how much the map that they lead to contradicts itself; None where the choice needed no map.
        least_misfit: how little they know the other shape.
    """

    name: str
    misfit: float | None = None
    map_misfit: float | None = None
    least_misfit: float | None = None


@dataclass(frozen=True)
class PairAdaptation:
    """What came of adapting a network to a pair.

    Args:
        steps: updates of its weights; 0 where a method without a network was chosen for the pair.
        map_misfit: of the map without, see ``homolog.matching.map_misfit``; None where there was nothing to adapt.
        adapted_map_misfit: of the map by the adapted network.
        kept: whether the pair has the features of the adapted network.
    """

    steps: int
    map_misfit: float | None = None
    adapted_map_misfit: float | None = None
    kept: bool = False


@dataclass(frozen=True, eq=False)
class Pair:
    """Two preprocessed shapes, with all that was decided about them.

    In the mathematics they are x and y: the source and the target, or the full and the partial shape.

    Args:
        source: one shape.
        target: the other.
        options: what is known of the two.
        settings: how maps are made.
        method: what finds them, chosen by what the two shapes are.
        extractor: what computed their features; None where nothing did.
        choice: among which features and methods these were chosen, the chosen one first; empty where it was given.
        adaptation: what came of adapting a network to the pair; None where that was not asked for.
        orientation: which way round they were found to be; None where nothing was looked for.
        before_search: the pair before it was turned, where other ways round may still be asked for; None elsewhere.
        alignment: what took the partial shape as it was given onto the full one, or of two parts the target onto the
            source, in normalised coordinates; None where it stays.
        fit: how well two parts lie on each other; None where that was not looked for.
        start: from where the shapes as they are turned are registered; None where that was not looked for.
        maps: refined point maps of the pair as it is, where the choice among features, or the search for where a part
            lies, made them; None elsewhere.

    Raises:
        ArgumentError: if the options want shapes that were preprocessed in another way, a shape is partial or a cloud,
            and the method knows full shapes or meshes alone, or the features of both have different widths.
    """

    source: PreprocessedShape
    target: PreprocessedShape
    options: PairOptions
    settings: MatcherSettings
    method: Method
    extractor: FeatureExtractor | None = None
    choice: tuple[Candidate, ...] = ()
    adaptation: PairAdaptation | None = None
    orientation: PairOrientation | None = None
    before_search: Pair | None = None
    alignment: Similarity | None = None
    fit: PartsFit | None = None
    start: RegistrationStart | None = None
    maps: PointMaps | None = None

    @classmethod
    def of(
        cls,
        source: Shape,
        target: Shape,
        preprocessor: Preprocessor,
        choose_method: Callable[[Modality, Modality], Method],
        *,
        options: PairOptions | None = None,
        settings: MatcherSettings | None = None,
        features: Sequence[ArrayLike] | None = None,
        timings: Timings | None = None,
    ) -> Pair:
        """Preprocess two shapes for each other: a partial one takes the scale of the full one, and comes second.

        Args:
            source: a mesh or cloud in any state; never changed.
            target: another.
            preprocessor: how.
            choose_method: what finds maps between two shapes of these modalities, as repair leaves them.
            options: what is known of the two.
            settings: how maps will be made.
            features: of the points of both shapes as given (n, d), in place of an extractor's.
            timings: collects time and memory of each step.

        Raises:
            ArgumentError: if something given is no shape.
            ShapeError: if a shape cannot be used, or ``strict`` forbids it.
        """
        options = options or PairOptions()
        # Features that are given are those of the given pose, and pre-aligned shapes lie where they belong.
        if features is not None or options.pre_aligned:
            options = replace(options, orient="given")
        shapes: dict[Side, Shape] = {"source": source, "target": target}
        for side, shape in shapes.items():
            check_kind(side, shape, Shape)
        order: tuple[Side, Side] = ("target", "source") if options.partial == "source" else SIDES
        found: dict[Side, PreprocessedShape] = {}
        scale: float | None = None
        centre: Float[Tensor, " 3"] | None = None
        for side in order:
            found[side] = preprocessor(
                shapes[side],
                as_cloud=options.is_cloud(side),
                up=options.up(side),
                scale=scale,
                centre=centre,
                features=None if features is None else features[SIDES.index(side)],
                orient=options.orient,
                partial=options.is_partial(side),
                mirror=options.mirror == side,
                clutter=options.clutter,
                proxy=options.proxy,
                mask=options.mask(side),
                strict=options.strict,
                timings=timings,
                label=side,
            )
            full = found[side].operators
            scale = full.scale / options.partial_scale if options.partial else None
            centre = full.centre / options.partial_scale if options.pre_aligned else None
        source_found, target_found = found["source"], found["target"]
        method = choose_method(source_found.modality, target_found.modality)
        settings = settings or MatcherSettings()
        return cls(source_found, target_found, options, settings, method, preprocessor.extractor)

    def __post_init__(self) -> None:
        for side in SIDES:
            getattr(self, side).check_made_for(self.options, side)
        check_supported(self.method, self.options, self.source, self.target)
        widths = [None if shape.features is None else shape.features.shape[1] for shape in (self.source, self.target)]
        if None not in widths and widths[0] != widths[1]:
            raise ArgumentError(
                f"features of the source, {self.source.name}, have width {widths[0]} and those of the target, "
                f"{self.target.name}, {widths[1]}, but must have the same width to be compared"
            )

    @property
    def x(self) -> PreprocessedShape:
        """The source, or the full shape where one is partial."""
        return self.target if self.options.partial == "source" else self.source

    @property
    def y(self) -> PreprocessedShape:
        """The target, or the partial shape where one is."""
        return self.source if self.options.partial == "source" else self.target

    @cached_property
    def guidance(self) -> Guidance | None:
        """The landmarks that guide the match; None without any.

        Raises:
            ArgumentError: if they are not those of these shapes.
        """
        if self.options.landmarks is None:
            return None
        sides: tuple[Side, Side] = ("target", "source") if self.options.partial == "source" else SIDES
        return Guidance.of(self.options.landmarks, self.x, self.y, sides)

    @property
    def is_partial(self) -> bool:
        """Whether y is a part of a shape like x, which is full."""
        return self.options.partial in SIDES

    @property
    def are_parts(self) -> bool:
        """Whether both are parts, which overlap."""
        return self.options.partial == "both"

    @property
    def are_meshes(self) -> bool:
        """Whether both shapes have faces."""
        return self.source.modality == self.target.modality == "mesh"

    @property
    def have_outsides(self) -> bool:
        """Whether both shapes are meshes whose triangles face outward; open ones have no clear outside."""
        surfaces = self.source.surface, self.target.surface
        return all(surface is not None and outward(surface) > 0 for surface in surfaces)

    @property
    def info(self) -> FeatureInfo:
        """What the features expect; where there are none, what is usual."""
        return FeatureInfo() if self.extractor is None else self.extractor.info

    @property
    def follows_pose(self) -> bool:
        """Whether maps depend on how the shapes stand: by their features, or where a method compares positions."""
        return not self.method.supports.needs_features if self.extractor is None else self.extractor.info.follows_pose

    @property
    def near_isometric(self) -> bool:
        """Whether the features are of surfaces that bend without stretching much."""
        return self.info.near_isometric

    @property
    def map_size(self) -> int:
        """Eigenpairs of the functional map from the features."""
        settings, info = self.settings.functional_map, None if self.extractor is None else self.extractor.info
        trained = _PARTIAL_SIZE if info is None else info.map_eigenpairs
        if not self.is_partial:
            return settings.n_eigenpairs or trained
        return settings.n_eigenpairs_partial or (trained if info is not None and info.partial else _PARTIAL_SIZE)

    @property
    def temperature(self) -> float:
        """Of the soft map between the features."""
        return self.settings.soft_map.temperature or self.info.temperature

    def with_y(self, y: PreprocessedShape) -> Pair:
        """The same with y in another pose or scale."""
        return replace(self, source=y) if self.options.partial == "source" else replace(self, target=y)

    @torch.no_grad()
    def with_extractor(self, extractor: FeatureExtractor) -> Pair:
        """The same with the features of another extractor, turned as it is for good."""
        preprocessor = Preprocessor(extractor=extractor, device=self.source.operators.points.device)
        source, target = (
            replace(shape, features=preprocessor.features(shape.operators, shape=shape.name))
            for shape in (self.source, self.target)
        )
        return replace(self, source=source, target=target, extractor=extractor, before_search=None, maps=None)

    def __repr__(self) -> str:
        return f"Pair(source={self.source!r},\n     target={self.target!r})"
