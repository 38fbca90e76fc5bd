"""Which features know two shapes, or whether it is better to do without any. New here.

Features are of the shapes that they were trained on: of people, or of animals. Their orienter tells how well it knows a
shape, by how much it contradicts itself about it. Where no features know a pair, the maps that come into question are
made, and the one that contradicts itself least is believed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import torch

from homolog.core.errors import ShapeError
from homolog.features import FeatureExtractor, Orienter
from homolog.matching.choice import extractor_for, method_between
from homolog.matching.guidance import landmark_misfit
from homolog.matching.quality import MapQuality
from homolog.matching.result import Match
from homolog.methods import AUTO, as_method, find_method
from homolog.pairs import Candidate, ChoiceSettings, Pair, PreprocessedShape

# In the order in which they are believed where their maps are as good.
_WITHOUT_FEATURES = ("axiomatic", "registration")
# The energy of an isometry is 1; of a map to one point it is 0.
_LEAST_ENERGY = 0.1

Seen = Callable[[PreprocessedShape, FeatureExtractor | None], PreprocessedShape]
"""A shape with other features than it has, as they find it to stand."""


@dataclass(frozen=True, eq=False)
class _Way:
    """A pair with some features, or a method without any, and what is known of it."""

    pair: Pair
    candidate: Candidate


@torch.no_grad()
def choose(pair: Pair, extractors: Sequence[FeatureExtractor], seen: Seen, find: Callable[[Pair], Match]) -> Pair:
    """The pair with the features that know it best, or a method without features where none do.

    Args:
        pair: with the first features.
        extractors: features of several kinds of shapes, with an orienter each; the first ones are the usual ones.
        seen: gives a shape with other features.
        find: makes the map of a pair, which need not meet its landmarks: one that misses them is believed less.
    """
    if len(extractors) < 2:
        return pair
    settings = pair.settings.choice
    ways = [_way(pair)]
    if _misfit_of(ways[0]) > settings.known:
        ways += [_way(_with_features(pair, extractor, seen)) for extractor in extractors[1:]]
        ways.sort(key=_misfit_of)
    if _misfit_of(ways[0]) > settings.known_best:
        plausible = [way for way in ways if _misfit_of(way) <= settings.plausible]
        tried = _mapped([*plausible, *_without_features(pair, seen)], find)
        ways = sorted(tried, key=_map_misfit_of) or ways[:1]
    return replace(ways[0].pair, choice=tuple(way.candidate for way in ways))


def map_misfit(quality: MapQuality, settings: ChoiceSettings | None = None) -> float:
    """How much a map contradicts itself: where it tears or turns over, and where there and back ends elsewhere.

    A smooth map tears nowhere, and may be wrong all the same: where it is, triangles are turned over.

    Examples:
        >>> import homolog
        >>> from homolog.matching import map_misfit
        >>> source, target = homolog.demo_shapes()
        >>> right = homolog.match(source, target, weights="people")
        >>> wrong = homolog.match(source, target, method="registration")  # which is for shapes in one pose
        >>> map_misfit(right.quality) < map_misfit(wrong.quality)
        True
    """
    settings = settings or ChoiceSettings()
    figures = quality.mean
    torn = math.log(max(figures.dirichlet_energy, _LEAST_ENERGY))
    return torn + settings.cycle * figures.cycle_error + settings.flipped * (figures.flipped_triangles or 0)


def _misfit_of(way: _Way) -> float:
    return way.candidate.misfit or 0.0


def _map_misfit_of(way: _Way) -> float:
    return way.candidate.map_misfit or 0.0


def _way(pair: Pair) -> _Way:
    assert pair.extractor is not None
    # Of a partial pair the full shape tells, or part and whole would have to be of one kind of orienter.
    shapes = [pair.x] if pair.is_partial else [pair.x, pair.y]
    orienter: Orienter = pair.extractor.orienter  # type: ignore[attr-defined]
    return _Way(pair, Candidate(pair.extractor.info.name, max(_misfit(shape, orienter) for shape in shapes)))


def _misfit(shape: PreprocessedShape, orienter: Orienter) -> float:
    """How little the orienter knows a shape; where that was trusted to stand, it is asked now."""
    return (shape.orientations or orienter(shape.operators))[0].misfit


def _with_features(pair: Pair, extractor: FeatureExtractor, seen: Seen) -> Pair:
    source, target = seen(pair.source, extractor), seen(pair.target, extractor)
    method = method_between(source.modality, target.modality, pair.method, pair.settings, extractor)
    return replace(pair, source=source, target=target, method=method, extractor=extractor)


def _without_features(pair: Pair, seen: Seen) -> Iterator[_Way]:
    """The pair with methods that bring what they compare, where one may be chosen."""
    for name in _WITHOUT_FEATURES if pair.settings.method == AUTO else ():
        method = as_method(find_method(name))
        if pair.is_partial and not method.supports.partial:
            continue
        extractor = extractor_for(method, None, pair.settings, pair.source.operators.points.device)
        source, target = seen(pair.source, extractor), seen(pair.target, extractor)
        way = replace(pair, source=source, target=target, method=method, extractor=extractor)
        yield _Way(way, Candidate(name))


def _mapped(ways: Iterable[_Way], find: Callable[[Pair], Match]) -> Iterator[_Way]:
    """The ways that lead to a map, with what it tells."""
    for way in ways:
        with suppress(ShapeError):  # what cannot be matched one way may be another way
            match = find(way.pair)
            quality = match.quality
            assert quality is not None
            missed = way.pair.settings.guidance.choice * landmark_misfit(way.pair, match)
            told = replace(way.candidate, map_misfit=map_misfit(quality, way.pair.settings.choice) + missed)
            yield replace(way, candidate=told)
