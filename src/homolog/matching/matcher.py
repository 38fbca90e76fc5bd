"""The road of a match: pair -> orientation -> alignment -> method -> refinement -> match."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import asdict, replace
from os import PathLike
from pathlib import Path
from typing import Any, get_args
from weakref import WeakKeyDictionary

import torch
from numpy.typing import ArrayLike

from homolog.core.arguments import check_choice, check_count, check_kind, given_or_default
from homolog.core.errors import ArgumentError, ShapeError
from homolog.core.pretrained import AUTO_WEIGHTS
from homolog.core.progress import Timings
from homolog.core.unchanged import left_unchanged
from homolog.features import FeatureExtractor, FeatureInfo, on_device
from homolog.geometry import compute_operators
from homolog.matching.alignment import align_partial
from homolog.matching.choice import (
    chosen_method,
    extractor_for,
    extractors_of,
    features_of_weights,
    left_aside_warnings,
    method_between,
    operators_expected,
)
from homolog.matching.guidance import guidance_warnings, guided, meet_landmarks
from homolog.matching.inputs import check_two_arrays, options_of, read_inputs, with_inputs
from homolog.matching.mirror import mirror_warnings
from homolog.matching.recognition import choose
from homolog.matching.refinement import refine
from homolog.matching.result import Match, checked_maps
from homolog.matching.search import orient, orientations
from homolog.matching.warnings import (
    blaming,
    low_confidence_warnings,
    orientation_warnings,
    part_warnings,
    unit_warnings,
)
from homolog.pairs import (
    SIDES,
    Candidate,
    Device,
    MatcherSettings,
    Method,
    OperatorSource,
    Pair,
    PairOptions,
    PointMaps,
    PreprocessedShape,
    Preprocessor,
    Side,
    check_supported,
    choose_device,
)
from homolog.shapes import Modality


class Matcher:
    """Finds correspondences between two shapes, with learned features, features of one's own, or none.

    Its ``warnings`` are also those of every match: features that were given, but that the method does not use.

    Args:
        features: what computes features: what ``load_weights`` gives, a network, a function of operators (see
            ``as_extractor``), or a ``FeatureInfo`` where features are given with each pair. None for methods that need
            none. Of several extractors, those are used that know a pair best; see ``homolog.pairs.ChoiceSettings``.
        settings: how maps are made.
        device: where features and maps are computed.
        operators: where operators come from; pass an ``OperatorCache``'s ``operators`` to keep them on disk.
        info: what features of one's own expect of shapes.

    Raises:
        ArgumentError: if something given is of another kind, or the method needs features and there are none.

    Examples:
        >>> import homolog
        >>> source, target = homolog.demo_shapes()
        >>> matcher = homolog.Matcher.from_weights("people")
        >>> matcher.match(source, target).method
        'functional-map'
    """

    def __init__(
        self,
        features: Any = None,
        info: FeatureInfo | None = None,
        *,
        settings: MatcherSettings | None = None,
        device: Device | torch.device = "auto",
        operators: OperatorSource = compute_operators,
    ) -> None:
        if info is not None:
            check_kind("info", info, FeatureInfo)
        if not callable(operators):
            raise ArgumentError(
                f"operators is {type(operators).__name__}, but must be a function like homolog.compute_operators, "
                "such as an OperatorCache's operators"
            )
        self.settings = given_or_default("settings", settings, MatcherSettings)
        self.device = choose_device(device)
        given = extractors_of(features, info)
        first = next(iter(given), None)
        self._method = chosen_method(self.settings, first)
        self.warnings = left_aside_warnings(self._method, first)
        self.extractor = extractor_for(self._method, first, self.settings, self.device)
        self._others = () if self.warnings else tuple(on_device(other, self.device) for other in given[1:])
        self._seen = WeakKeyDictionary[PreprocessedShape, dict[Hashable, PreprocessedShape]]()
        of_features = operators_expected([self.extractor, *self._others])
        self.preprocess = Preprocessor(
            extractor=self.extractor,
            orientation=self.settings.orientation,
            proxies=self.settings.proxy,
            settings=self.settings.operators or of_features,
            device=self.device,
            source=operators,
        )

    @property
    def _resolved(self) -> MatcherSettings:
        """The settings with the operators that the features expect, as reports tell them."""
        return replace(self.settings, operators=self.preprocess.settings)

    @classmethod
    def from_weights(
        cls,
        weights: str | Path = AUTO_WEIGHTS,
        *,
        settings: MatcherSettings | None = None,
        device: Device | torch.device = "auto",
        operators: OperatorSource = compute_operators,
    ) -> Matcher:
        """A matcher with pretrained weights, by their name, or with weights from a file.

        By default each pair is matched by the pretrained weights that know it best, or without any.

        Raises:
            ArgumentError: if something given is of another kind.
            WeightsError: if there are no such weights, or the file does not hold any.
        """
        settings = given_or_default("settings", settings, MatcherSettings)
        check_kind("weights", weights, PathLike, str)
        features = features_of_weights(weights, settings)
        return cls(features, settings=settings, device=device, operators=operators)

    def with_extractor(self, extractor: FeatureExtractor) -> Matcher:
        """A matcher that differs in its features alone."""
        return Matcher(extractor, settings=self.settings, device=self.device, operators=self.preprocess.source)

    @property
    def has_choice(self) -> bool:
        """Whether it chooses among several features, and methods without any, for each pair."""
        return bool(self._others)

    def limited_to(self, name: str) -> Matcher:
        """A matcher that makes no choice: it uses these features of its own, or this method, for every pair.

        Args:
            name: of the features, or of a method that needs none, as ``choice_for`` tells it.
        """
        named = {each.info.name: each for each in (self.extractor, *self._others) if each is not None}
        settings = self._resolved if name in named else replace(self._resolved, method=name)
        return Matcher(named.get(name), settings=settings, device=self.device, operators=self.preprocess.source)

    def method_of(self, source: Modality, target: Modality) -> Method:
        """How two shapes of these modalities are matched; see ``MatcherSettings``."""
        for name, modality in (("source", source), ("target", target)):
            check_choice(name, modality, get_args(Modality))
        return method_between(source, target, self._method, self.settings, self.extractor)

    def describe(self) -> dict[str, Any]:
        """Features, settings and device, for reports."""
        infos = [asdict(extractor.info) for extractor in (self.extractor, *self._others) if extractor is not None]
        features = infos if self._others else next(iter(infos), None)
        return {"features": features, "settings": self._resolved.to_dict(), "device": str(self.device)}

    def match(
        self,
        source: Any,
        target: Any,
        options: PairOptions | None = None,
        *,
        features: Sequence[ArrayLike] | None = None,
        timings: Timings | None = None,
        **words: Any,
    ) -> Match:
        """Find for every point of each shape its counterpart on the other.

        Args:
            source: a mesh or cloud in any state, never changed: a shape, a path, or whatever ``as_shape`` takes.
            target: another.
            options: what is known of the two.
            features: of the points of both as given, two arrays (n, d), in place of the matcher's own.
            timings: collects time and memory of each step.
            **words: the fields of ``PairOptions``, such as ``partial="source"``, in place of ``options``.

        Raises:
            ArgumentError: if something given is not a shape, such a word, a factor, or features of both.
            ShapeError: if a shape cannot be used, or ``strict`` forbids it.
        """
        timings = timings or Timings()
        pair, files = self.pair(source, target, options, features=features, timings=timings, **words)
        return with_inputs(self.match_pair(pair, timings=timings), files, timings)

    def pair(
        self,
        source: Any,
        target: Any,
        options: PairOptions | None = None,
        *,
        features: Sequence[ArrayLike] | None = None,
        timings: Timings | None = None,
        **words: Any,
    ) -> tuple[Pair, dict[Side, dict[str, str]]]:
        """Read and preprocess two shapes for each other; also which files they came from. See ``match``."""
        timings = timings or Timings()
        options = options_of(options, words)
        check_supported(self._method, options)  # before anything is computed
        if features is not None:
            check_two_arrays(features)
            features = None if self.warnings else features  # they are left aside
        (first, second), files = read_inputs(source, target, timings)
        pair = Pair.of(
            first,
            second,
            self.preprocess,
            self.method_of,
            options=options,
            settings=self._resolved,
            features=features,
            timings=timings,
        )
        if not self._others:
            return pair, files
        with timings.measure("choice of features"):
            return self._chosen([pair])[0], files

    @torch.no_grad()
    def paired(self, source: PreprocessedShape, target: PreprocessedShape, options: PairOptions | None = None) -> Pair:
        """Two shapes that ``preprocess`` gave, as a pair.

        With ``orient="given"`` they are turned back to the pose in which they were given.

        Raises:
            ArgumentError: if something given is of another kind, or the options want shapes that were preprocessed in
                another way: as clouds, or with another axis up.
        """
        return self._chosen([self._unchosen(source, target, options_of(options, {}))])[0]

    @torch.no_grad()
    def choice_for(
        self, shapes: Sequence[tuple[PreprocessedShape, PreprocessedShape]], options: PairOptions | None = None
    ) -> tuple[Candidate, ...]:
        """Which features, or method without any, suit several pairs of one kind of shapes best together.

        Args:
            shapes: pairs that ``preprocess`` gave, at least one.
            options: of all of them.

        Returns:
            What came into question, the best first; empty where there is no choice. Misfits are medians over the pairs.

        Examples:
            >>> matcher = homolog.Matcher.from_weights()
            >>> source, target = map(matcher.preprocess, homolog.demo_shapes())
            >>> best = matcher.choice_for([(source, target)])[0]
            >>> best.name, matcher.limited_to(best.name).extractor.info.name
            ('people', 'people')
        """
        options = options_of(options, {})
        return self._chosen([self._unchosen(*both, options) for both in shapes])[0].choice

    def _unchosen(self, source: PreprocessedShape, target: PreprocessedShape, options: PairOptions) -> Pair:
        """Two shapes as a pair, with the first features."""
        for side, shape in zip(SIDES, (source, target), strict=True):
            check_kind(side, shape, PreprocessedShape)
            _check_preprocessed(side, shape, options)
        if options.orient == "given" or options.pre_aligned:
            source, target = (shape.as_given(self.extractor) for shape in (source, target))
        method = self.method_of(source.modality, target.modality)
        return Pair(source, target, options, self._resolved, method, self.extractor)

    def _chosen(self, pairs: list[Pair]) -> list[Pair]:
        """Pairs, with one set of options, with the features that know them best together."""
        extractors = () if self.extractor is None else (self.extractor, *self._others)
        options, parts = pairs[0].options, {pair.y for pair in pairs if pair.is_partial}

        def seen(shape: PreprocessedShape, extractor: FeatureExtractor | None) -> PreprocessedShape:
            partial = shape in parts
            known, how = self._seen.setdefault(shape, {}), (extractor, options.orient, partial)
            if how not in known:
                preprocess = replace(self.preprocess, extractor=extractor)
                known[how] = preprocess.again(shape, orient=options.orient, partial=partial)
            return known[how]

        return choose(pairs, extractors, seen, self._draft)

    @torch.no_grad()
    def find(self, pair: Pair) -> Match:
        """Match a pair, without any check of the result."""
        check_kind("pair", pair, Pair)
        aligned = guided(align_partial(orient(pair)))
        return Match.of(aligned, meet_landmarks(aligned, self._maps(aligned)))

    def _draft(self, pair: Pair) -> Match:
        """A match by features alone, the right way round: how it misses the landmarks tells of the features."""
        aligned = align_partial(orient(pair))
        unguided = replace(aligned, options=replace(pair.options, landmarks=None))
        return Match.of(unguided, self._maps(unguided))

    def _maps(self, aligned: Pair) -> PointMaps:
        """The refined maps of a pair that is ready for its method."""
        lent = {f"{name} of {one.name}": t for one in (aligned.x, aligned.y) for name, t in one.tensors().items()}
        with left_unchanged(f"method {aligned.method.name!r}", lent):
            maps = aligned.method(aligned)
        return refine(aligned, checked_maps(aligned, maps))

    def match_pair(self, pair: Pair, *, timings: Timings | None = None) -> Match:
        """Match a pair, and check the result and their units; see ``match``."""
        return self.alternatives(pair, 1, timings=[timings or Timings()])[0]

    @torch.no_grad()
    def alternatives(self, pair: Pair, count: int, *, timings: Sequence[Timings] = ()) -> list[Match]:
        """Matches of the likeliest ways round that lead to different maps, the best first; at most so many.

        Each has its own warnings, and its own margin to the best of the others. The first is that of ``match_pair``.

        Args:
            pair: two preprocessed shapes.
            count: how many, at least 1.
            timings: for each of them, what collects its time and memory.

        Raises:
            ArgumentError: if ``pair`` or ``count`` is of another kind.
            ShapeError: if the shapes cannot be matched, or ``strict`` forbids a warning of the first match.
        """
        check_kind("pair", pair, Pair)
        check_count("count", count)
        timings = timings or [Timings() for _ in range(count)]
        units = unit_warnings(pair)
        with timings[0].measure("map"), blaming(units):
            ways = orientations(pair, count)
            best = self._checked(ways[0], self.find(ways[0]), units)
        if pair.options.strict and best.warnings:
            raise ShapeError(f"{best.warnings[0]} (refused as strict)")
        others = []
        for way, own in zip(ways[1:], timings[1:], strict=False):
            with own.measure("map"):
                others.append(self._checked(way, self.find(way), units))
        return [best, *others]

    def _checked(self, pair: Pair, match: Match, units: tuple[str, ...]) -> Match:
        """A match of a pair, turned as it was matched, with all that there is to warn of."""
        checks = (*guidance_warnings(pair), *part_warnings(pair), *orientation_warnings(match), *mirror_warnings(pair))
        doubts = low_confidence_warnings(match, self.settings.warnings, pair=pair)
        return replace(match, warnings=(*self.warnings, *units, *checks, *doubts))

    def __repr__(self) -> str:
        features = "no features" if self.extractor is None else repr(self.extractor.info.name)
        return f"Matcher({features}, method={self.settings.method!r}, device={str(self.device)!r})"


def _check_preprocessed(side: Side, shape: PreprocessedShape, options: PairOptions) -> None:
    """Refuse options of preprocessing that the shape does not have."""
    if options.is_cloud(side) and shape.modality == "mesh":
        raise ArgumentError(
            f"as_cloud is {options.as_cloud!r}, but the {side} was preprocessed as a mesh; "
            "give as_cloud=True to Matcher.preprocess"
        )
    if options.up(side) not in (PairOptions().up(side), shape.up):
        raise ArgumentError(
            f"{side}_up is {options.up(side)!r}, but the {side} was preprocessed with {shape.up!r} up; "
            f"give up={options.up(side)!r} to Matcher.preprocess"
        )
