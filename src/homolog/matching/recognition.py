"""Which features know two shapes, or whether it is better to do without any. New here.

Features are of the shapes that they were trained on: of people, or of animals. Their orienter tells how well it knows a
shape, by how much it contradicts itself about it. Where none know both shapes of a pair, those are taken that know one
of them well. Where none do, and the two shapes are nearly rigid copies, as bones of one kind are, they are registered;
so are those whose registration hardly contradicts itself, as that of organs. Otherwise the maps that come into question
are made, and the one that contradicts itself least is believed.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from statistics import median
from typing import Any
from weakref import WeakKeyDictionary

import torch

from homolog.core.errors import ShapeError
from homolog.features import FeatureExtractor, Orienter
from homolog.matching.choice import extractor_for, method_between
from homolog.matching.guidance import landmark_misfit
from homolog.matching.misfit import map_misfit
from homolog.matching.placing import align_parts
from homolog.matching.refinement import method_maps, refine
from homolog.matching.result import Match
from homolog.matching.search import orient
from homolog.methods import AUTO, as_method, find_method, registration
from homolog.pairs import Candidate, Method, Pair, PreprocessedShape, Preprocessor

# The method without features for shapes that bend; others are registered.
_SPECTRAL = "axiomatic"


@dataclass(frozen=True, eq=False)
class SeenShapes:
    """Preprocessed shapes with other features than their own, as these find them to stand; each is looked at once.

    Args:
        preprocess: how shapes were made ready.
    """

    preprocess: Preprocessor
    _known: WeakKeyDictionary[PreprocessedShape, dict[Hashable, PreprocessedShape]] = field(
        default_factory=WeakKeyDictionary, repr=False
    )

    def __reduce__(self) -> tuple[type[SeenShapes], tuple[Preprocessor]]:
        """Pickled, for another process, without what is known of shapes."""
        return SeenShapes, (self.preprocess,)

    def seen(self, pair: Pair, extractor: FeatureExtractor | None, method: Method | None = None) -> Pair:
        """A pair with other features, and with a method; by default that for shapes as repair left them."""
        source, target = (self._seen(shape, extractor, pair) for shape in (pair.source, pair.target))
        if method is None:
            method = method_between(
                source.modality, target.modality, pair.method, pair.settings, extractor, parts=pair.are_parts
            )
        return replace(pair, source=source, target=target, method=method, extractor=extractor)

    def _seen(self, shape: PreprocessedShape, extractor: FeatureExtractor | None, pair: Pair) -> PreprocessedShape:
        partial = pair.are_parts or (pair.is_partial and shape is pair.y)
        known, how = self._known.setdefault(shape, {}), (extractor, pair.options.orient, partial)
        if how not in known:
            preprocess = replace(self.preprocess, extractor=extractor)
            known[how] = preprocess.again(shape, orient=pair.options.orient, partial=partial)
        return known[how]


@dataclass(frozen=True, eq=False)
class _Way:
    """Pairs with some features, or a method without any, and what is known of them together."""

    pairs: tuple[Pair, ...]
    candidate: Candidate

    @property
    def method(self) -> str:
        """The name of the method of its pairs."""
        return self.pairs[0].method.name


@torch.no_grad()
def choose(pairs: Sequence[Pair], extractors: Sequence[FeatureExtractor], shapes: SeenShapes) -> list[Pair]:
    """A pair with the features that know it best, or a method without features where none do; or several pairs alike.

    Of several pairs the medians of their misfits are compared, so that a single odd shape does not decide.

    Args:
        pairs: with the first features, and with the same options.
        extractors: features of several kinds of shapes, with an orienter each; the first ones are the usual ones.
        shapes: of the pairs, with other features.
    """
    settings = pairs[0].settings.choice
    first, *others = _suited(extractors, pairs[0])
    usual = _way(pairs if first is extractors[0] else [shapes.seen(pair, first) for pair in pairs])
    ways = [usual]
    if not _know(usual, _misfit_of(usual), settings.known):
        ways += [_way([shapes.seen(pair, extractor) for pair in pairs]) for extractor in others]
        # Those that know the pair by a measure of their own come first.
        ways.sort(key=lambda way: (not _know(way, _misfit_of(way), settings.known_best), _misfit_of(way)))
        may_know = _know(ways[0], _misfit_of(ways[0]), settings.known_best)
        # Maps of two parts contradict themselves wherever these do not overlap.
        if not (may_know and ways[0] is not usual) and not pairs[0].are_parts:
            ways = _unknown(pairs, ways, shapes, maps_tell=not may_know)
    choice = tuple(way.candidate for way in ways)
    return [replace(pair, choice=choice) for pair in ways[0].pairs]


def candidate_of(pair: Pair) -> Candidate:
    """How well a pair's features know it, where they were chosen for many pairs together; or its method without any."""
    chooses = getattr(pair.extractor, "orienter", None) is not None
    return _way([pair]).candidate if chooses else Candidate(pair.method.name)


def _know(way: _Way, misfit: float, most: float) -> bool:
    """Whether features are believed to know a shape: up to a misfit, or what their file says, if that is less."""
    extractor = way.pairs[0].extractor
    assert extractor is not None
    return misfit <= extractor.info.limit(most)


def _unknown(pairs: Sequence[Pair], ways: list[_Way], shapes: SeenShapes, *, maps_tell: bool) -> list[_Way]:
    """The ways for pairs that no features know both shapes of, the best first.

    Features that know one of the two are taken; else some pairs are registered, and of others maps tell.
    """
    settings = pairs[0].settings.choice
    if half_known := [way for way in ways if _know(way, _least_misfit_of(way), settings.known)]:
        # The other shape is of that kind, too, with an odd pose or mesh. Wrong maps by closest points tear less.
        best = min(half_known, key=_least_misfit_of)
        return [best, *(way for way in ways if way is not best)]
    registered = [_started(way) for way in _without_features(pairs, shapes, registration.METHOD.name)]
    near_rigid = [pair.start is not None and pair.start.near_rigid for way in registered for pair in way.pairs]
    if near_rigid and median(near_rigid) == 1:  # most of them
        # One pair keeps its map, so that the map's misfit costs nothing; of several it would be made for that alone.
        return [*((list(_mapped(registered)) if len(pairs) == 1 else []) or registered), *ways]
    if not maps_tell:
        return ways
    registered = list(_mapped(registered))
    if registered and _map_misfit_of(registered[0]) <= settings.registered:
        return [*registered, *ways]
    plausible = [way for way in ways if _misfit_of(way) <= settings.plausible]
    others = _without_features(pairs, shapes, _SPECTRAL)
    return sorted([*_mapped([*plausible, *others]), *registered], key=_map_misfit_of) or ways[:1]


def _started(way: _Way) -> _Way:
    """Pairs that are to be registered, with their orientation and where registration begins, for what comes later."""

    def found(pair: Pair) -> Pair:
        try:
            return registration.started(replace(orient(pair), before_search=pair))
        except ShapeError:
            return pair

    return replace(way, pairs=tuple(map(found, way.pairs)))


def _suited(extractors: Sequence[FeatureExtractor], pair: Pair) -> list[FeatureExtractor]:
    """The features in the order in which they are asked: of partial pairs those that know parts come first.

    Of those that have one orienter, and so know the same shapes, the first suit the pair.
    """
    wants_parts = pair.is_partial or pair.are_parts
    found: list[FeatureExtractor] = []
    for extractor in sorted(extractors, key=lambda each: each.info.partial != wants_parts):
        if not any(_have_one_orienter(extractor, other) for other in found):
            found.append(extractor)
    return found


def _have_one_orienter(one: FeatureExtractor, other: FeatureExtractor) -> bool:
    """Whether they have the same, or one has the other's, trained on for its own shapes."""
    if one.info.lender == other.info.name or other.info.lender == one.info.name:
        return True
    networks: list[Any] = [getattr(_orienter_of(each), "network", None) for each in (one, other)]
    if None in networks:  # an orienter of somebody's own
        return False
    first, second = (network.state_dict() for network in networks)
    return first.keys() == second.keys() and all(torch.equal(first[name], second[name]) for name in first)


def _orienter_of(extractor: FeatureExtractor) -> Orienter:
    """Of features to choose from, which have one each."""
    orienter: Orienter = extractor.orienter  # type: ignore[attr-defined]
    return orienter


def _misfit_of(way: _Way) -> float:
    return way.candidate.misfit or 0.0


def _least_misfit_of(way: _Way) -> float:
    return way.candidate.least_misfit or 0.0


def _map_misfit_of(way: _Way) -> float:
    return way.candidate.map_misfit or 0.0


def _way(pairs: Sequence[Pair]) -> _Way:
    """Pairs with some features, and how little these know them: their orienter is asked where it was not before."""
    extractor = pairs[0].extractor
    assert extractor is not None
    orienter = _orienter_of(extractor)
    # Of a partial pair the full shape tells, or part and whole would have to be of one kind of orienter.
    misfits = [
        [
            (shape.orientations or orienter(shape.operators))[0].misfit
            for shape in ([pair.x] if pair.is_partial else [pair.x, pair.y])
        ]
        for pair in pairs
    ]
    most, least = median(map(max, misfits)), median(map(min, misfits))
    return _Way(tuple(pairs), Candidate(extractor.info.name, most, least_misfit=least))


def _without_features(pairs: Sequence[Pair], shapes: SeenShapes, name: str) -> list[_Way]:
    """The pairs with a method that brings what it compares; none where it cannot be chosen."""
    first, method = pairs[0], as_method(find_method(name))
    if first.settings.method != AUTO or (first.is_partial and not method.supports.partial):
        return []
    extractor = extractor_for(method, None, first.settings, first.source.operators.points.device)
    return [_Way(tuple(shapes.seen(pair, extractor, method) for pair in pairs), Candidate(name))]


def _mapped(ways: Iterable[_Way]) -> Iterator[_Way]:
    """The ways that lead to maps of most pairs, with what these tell."""
    for way in ways:
        tried = [_tried(pair) for pair in way.pairs]
        misfit = median(misfit for _, misfit in tried)
        if misfit < math.inf:
            pairs = tuple(pair for pair, _ in tried)
            yield replace(way, pairs=pairs, candidate=replace(way.candidate, map_misfit=misfit))


def _tried(pair: Pair) -> tuple[Pair, float]:
    """How much the map by features alone contradicts itself, and how far it misses the landmarks.

    A map that was made to meet the landmarks would say nothing of the features. Without any, the pair keeps the map,
    unless both shapes are parts.
    """
    try:
        oriented = orient(pair)
        aligned = align_parts(oriented)
        unguided = replace(aligned, options=replace(pair.options, landmarks=None))
        maps = unguided.maps or refine(unguided, method_maps(unguided))
        match = Match.of(unguided, maps)
    except ShapeError:  # what cannot be matched one way may be another way
        return pair, math.inf
    missed = pair.settings.guidance.choice * landmark_misfit(pair, match)
    misfit = map_misfit(match, pair.settings.choice) + missed
    if not pair.are_parts and pair.options.landmarks is None:
        before = None if pair.is_partial else pair.before_search or pair  # a part has no other ways round
        pair = replace(aligned, maps=maps, before_search=before)
    return pair, misfit
