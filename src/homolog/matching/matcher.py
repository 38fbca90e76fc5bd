"""The road of a match.

Pair -> orientation -> alignment -> features of landmarks -> method -> refinement -> landmarks met -> match -> warnings.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import Any

import torch
from numpy.typing import ArrayLike

from homolog.core.arguments import check_count, check_kind, given_or_default
from homolog.core.errors import ArgumentError, ShapeError
from homolog.core.pretrained import AUTO_WEIGHTS
from homolog.core.progress import Timings
from homolog.features import FeatureExtractor, FeatureInfo
from homolog.geometry import compute_operators
from homolog.matching.choice import features_of_weights
from homolog.matching.extra_parts import without_extra_parts
from homolog.matching.feature_choice import FeatureChoice
from homolog.matching.guidance import guided, meet_landmarks
from homolog.matching.inputs import options_of, read_inputs, with_inputs
from homolog.matching.placing import align_parts
from homolog.matching.refinement import method_maps, refine
from homolog.matching.result import Match
from homolog.matching.search import orient, orientations
from homolog.matching.smoothing import smoothed
from homolog.matching.units import unit_warnings
from homolog.matching.warnings import blaming, match_warnings
from homolog.pairs import Device, MatcherSettings, Method, OperatorSource, Pair, PairOptions, PreprocessedShape, Side
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
        self.settings = given_or_default("settings", settings, MatcherSettings)
        self.feature_choice = FeatureChoice.of(features, info, self.settings, device=device, operators=operators)
        self.preprocess, self.warnings = self.feature_choice.preprocess, self.feature_choice.warnings
        self.extractor, self.device = self.preprocess.extractor, self.preprocess.device

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
        check_kind("weights", weights, PathLike, str)
        features = features_of_weights(weights, settings)
        return cls(features, settings=settings, device=device, operators=operators)

    def with_extractor(self, extractor: FeatureExtractor) -> Matcher:
        """A matcher that differs in its features alone."""
        return Matcher(extractor, settings=self.settings, device=self.device, operators=self.preprocess.source)

    def limited_to(self, name: str) -> Matcher:
        """A matcher that makes no choice: it uses these features of its own, or this method, for every pair.

        Its matches tell how well these know each pair, and warn where they do not.

        Args:
            name: of the features, or of a method that needs none, as ``FeatureChoice.candidates`` tells it.
        """
        named = {each.info.name: each for each in self.feature_choice.extractors}
        settings = self.feature_choice.settings
        settings = settings if name in named else replace(settings, method=name)
        limited = Matcher(named.get(name), settings=settings, device=self.device, operators=self.preprocess.source)
        limited.feature_choice = replace(limited.feature_choice, limited=True)
        return limited

    def method_of(self, source: Modality, target: Modality, *, parts: bool = False) -> Method:
        """How two shapes of these modalities, or two parts, are matched; see ``MatcherSettings``."""
        return self.feature_choice.method_of(source, target, parts=parts)

    def describe(self) -> dict[str, Any]:
        """Features, settings and device, for reports."""
        return {**self.feature_choice.to_dict(), "device": str(self.device)}

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
        timings, options = timings or Timings(), options_of(options, words)
        self.feature_choice.check(options, features)  # before anything is read
        (first, second), files = read_inputs(source, target, timings)
        return self.feature_choice.pair_of(first, second, options, features=features, timings=timings), files

    @torch.no_grad()
    def paired(self, source: PreprocessedShape, target: PreprocessedShape, options: PairOptions | None = None) -> Pair:
        """Two shapes that ``preprocess`` gave, as a pair.

        With ``orient="given"`` they are turned back to the pose in which they were given.

        Raises:
            ArgumentError: if something given is of another kind, or the options want shapes that were preprocessed in
                another way: as clouds, or with another axis up.
        """
        return self.feature_choice.best_for([self.feature_choice.usual_pair(source, target, options)])[0]

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
            ArgumentError: if ``pair`` or ``count`` is of another kind, or there are not so many ``timings``.
            ShapeError: if the shapes cannot be matched, or ``strict`` forbids a warning of the first match.
        """
        check_kind("pair", pair, Pair)
        check_count("count", count)
        timings = timings or [Timings() for _ in range(count)]
        if len(timings) != count:
            raise ArgumentError(f"timings are {len(timings)}, but must be {count}, one for each of so many matches")
        units = unit_warnings(pair)
        with timings[0].measure("map"), blaming(units):
            ways = orientations(pair, count)
            best = self._checked(ways[0], units)
        if pair.options.strict and best.warnings:
            raise ShapeError(f"{best.warnings[0]} (refused as strict)")
        others = []
        for way, own in zip(ways[1:], timings[1:], strict=False):
            with own.measure("map"):
                others.append(self._checked(way, units))
        return [best, *others]

    @torch.no_grad()
    def find(self, pair: Pair) -> Match:
        """Match a pair, without any check of the result."""
        check_kind("pair", pair, Pair)
        pair = guided(align_parts(orient(pair)))
        maps = meet_landmarks(pair, pair.maps or refine(pair, method_maps(pair)))
        pair, maps = without_extra_parts(pair, maps, self.preprocess)
        return Match.of(pair, smoothed(pair, maps), judged=maps)

    def _checked(self, pair: Pair, units: tuple[str, ...]) -> Match:
        """A match with all that there is to warn of."""
        match = self.find(pair)
        return replace(match, warnings=(*self.warnings, *units, *match_warnings(pair, match)))

    def __repr__(self) -> str:
        features = "no features" if self.extractor is None else repr(self.extractor.info.name)
        return f"Matcher({features}, method={self.settings.method!r}, device={str(self.device)!r})"
