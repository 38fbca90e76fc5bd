"""What finds the maps of a matcher: a method, and the features that it compares or may choose from."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, get_args

import torch
from numpy.typing import ArrayLike

from homolog.core.arguments import check_choice, check_kind
from homolog.core.errors import ArgumentError
from homolog.core.progress import Timings
from homolog.features import FeatureExtractor, FeatureInfo, on_device
from homolog.matching.choice import (
    chosen_method,
    extractor_for,
    extractors_of,
    left_aside_warnings,
    method_between,
    operators_expected,
)
from homolog.matching.inputs import check_two_arrays, options_of
from homolog.matching.mirror import are_mirror_images
from homolog.matching.recognition import SeenShapes, candidate_of, choose
from homolog.matching.search import orient
from homolog.pairs import (
    SIDES,
    Candidate,
    Device,
    MatcherSettings,
    Method,
    OperatorSource,
    Pair,
    PairOptions,
    PreprocessedShape,
    Preprocessor,
    check_supported,
    choose_device,
)
from homolog.shapes import Modality, Shape


@dataclass(frozen=True, eq=False)
class FeatureChoice:
    """The method of a matcher and the features that it compares: none, those of one kind, or several to choose from.

    Args:
        method: the one that was asked for; of ``"auto"`` that for two meshes.
        settings: how maps are made, with the operators that the features expect.
        preprocess: makes shapes ready, with the usual features.
        shapes: that other features have looked at, too.
        others: features of other kinds of shapes, with an orienter each; empty where there is no choice.
        warnings: of features that were given, but that the method does not use.
        limited: whether a choice was made before, for many pairs together: each pair tells how well it was.
    """

    method: Method
    settings: MatcherSettings
    preprocess: Preprocessor
    shapes: SeenShapes
    others: tuple[FeatureExtractor, ...] = ()
    warnings: tuple[str, ...] = ()
    limited: bool = False

    @classmethod
    def of(
        cls,
        features: Any,
        info: FeatureInfo | None,
        settings: MatcherSettings,
        *,
        device: Device | torch.device,
        operators: OperatorSource,
    ) -> FeatureChoice:
        """What was given to a matcher, see ``Matcher``, with all that follows from it.

        Raises:
            ArgumentError: if something given is of another kind, or the method needs features and there are none.
        """
        device = choose_device(device)
        given = extractors_of(features, info)
        first = next(iter(given), None)
        method = chosen_method(settings, first)
        warnings = left_aside_warnings(method, first)
        extractor = extractor_for(method, first, settings, device)
        others = () if warnings else tuple(on_device(other, device) for other in given[1:])
        of_features = operators_expected([extractor, *others])
        preprocess = Preprocessor(
            extractor=extractor,
            orientation=settings.orientation,
            clutter=settings.clutter,
            proxies=settings.proxy,
            settings=settings.operators or of_features,
            device=device,
            source=operators,
        )
        resolved = replace(settings, operators=preprocess.settings)
        return cls(method, resolved, preprocess, SeenShapes(preprocess), others, warnings)

    @property
    def is_open(self) -> bool:
        """Whether one is made for each pair, among several features and methods without any."""
        return bool(self.others)

    @property
    def extractors(self) -> tuple[FeatureExtractor, ...]:
        """All features, the usual ones first; none where the method needs none."""
        usual = self.preprocess.extractor
        return () if usual is None else (usual, *self.others)

    def method_of(self, source: Modality, target: Modality, *, parts: bool = False) -> Method:
        """How two shapes of these modalities, or two parts, are matched; see ``MatcherSettings``."""
        for name, modality in (("source", source), ("target", target)):
            check_choice(name, modality, get_args(Modality))
        return method_between(source, target, self.method, self.settings, self.preprocess.extractor, parts=parts)

    def check(self, options: PairOptions, features: Sequence[ArrayLike] | None) -> None:
        """Refuse options that the method does not know, and features that are not one array for each shape."""
        check_supported(self.method_of("mesh", "mesh", parts=options.partial == "both"), options)
        if features is not None:
            check_two_arrays(features)

    def pair_of(
        self,
        source: Shape,
        target: Shape,
        options: PairOptions,
        *,
        features: Sequence[ArrayLike] | None = None,
        timings: Timings | None = None,
    ) -> Pair:
        """Two shapes, preprocessed for each other, with what suits them best; see ``Matcher.pair``."""
        pair = Pair.of(
            source,
            target,
            self.preprocess,
            functools.partial(self.method_of, parts=options.partial == "both"),
            options=options,
            settings=self.settings,
            features=None if self.warnings else features,  # they are left aside
            timings=timings,
        )
        pair = self.best_for([pair], timings)[0]
        if options.mirror != "auto":
            return pair
        unmirrored = replace(pair.options, mirror=None)
        plain = replace(pair.before_search or pair, options=unmirrored, choice=pair.choice)
        oriented = orient(plain)
        if not are_mirror_images(oriented):
            return replace(oriented, before_search=plain)
        options = replace(options, mirror="source")
        return self.pair_of(source, target, options, features=features, timings=timings)

    def usual_pair(
        self, source: PreprocessedShape, target: PreprocessedShape, options: PairOptions | None = None
    ) -> Pair:
        """Two preprocessed shapes as a pair, with the usual features; see ``Matcher.paired``."""
        options = options_of(options, {})
        if options.mirror == "auto":
            raise ArgumentError(
                "mirror is 'auto', but the shapes are preprocessed; give mirror=True to Matcher.preprocess for one "
                "that is a mirror image, and leave out the option"
            )
        for side, shape in zip(SIDES, (source, target), strict=True):
            check_kind(side, shape, PreprocessedShape)
        extractor = self.preprocess.extractor
        if options.pre_aligned:  # so that other features, if they are chosen, leave them as they lie, too
            options = replace(options, orient="given")
        if options.orient == "given":
            source, target = (shape.as_given(extractor) for shape in (source, target))
        method = self.method_of(source.modality, target.modality, parts=options.partial == "both")
        return Pair(source, target, options, self.settings, method, extractor)

    def best_for(self, pairs: Sequence[Pair], timings: Timings | None = None) -> list[Pair]:
        """Pairs with the features that know them best together, or a method without any; as they are without a choice.

        Args:
            pairs: with the usual features, and with the same options.
            timings: collects time and memory.
        """
        if self.limited:
            return [replace(pair, choice=(candidate_of(pair),)) for pair in pairs]
        if not self.is_open:
            return list(pairs)
        with (timings or Timings()).measure("choice of features"):
            return choose(pairs, self.extractors, self.shapes)

    @torch.no_grad()
    def candidates(
        self, shapes: Sequence[tuple[PreprocessedShape, PreprocessedShape]], options: PairOptions | None = None
    ) -> tuple[Candidate, ...]:
        """Which features, or method without any, suit several pairs of one kind of shapes best together.

        Args:
            shapes: pairs that ``Matcher.preprocess`` gave, at least one.
            options: of all of them.

        Returns:
            What came into question, the best first; empty where there is no choice. Misfits are medians over the pairs.

        Examples:
            >>> matcher = homolog.Matcher.from_weights()
            >>> source, target = map(matcher.preprocess, homolog.demo_shapes())
            >>> best = matcher.feature_choice.candidates([(source, target)])[0]
            >>> best.name, matcher.limited_to(best.name).extractor.info.name
            ('people', 'people')
        """
        return self.best_for([self.usual_pair(*both, options) for both in shapes])[0].choice

    def to_dict(self) -> dict[str, Any]:
        """Features and settings, for reports."""
        infos = [asdict(extractor.info) for extractor in self.extractors]
        return {"features": infos if self.is_open else next(iter(infos), None), "settings": self.settings.to_dict()}
