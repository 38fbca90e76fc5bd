"""Which features know two shapes, or whether it is better to do without any. New here.

Features are of the shapes that they were trained on: of people, or of animals. Their orienter tells how well it knows a
shape, by how much it contradicts itself about it. Where no features know a pair, the maps that come into question are
made, and the one that contradicts itself least is believed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from statistics import median

import torch

from homolog.core.errors import ShapeError
from homolog.features import FeatureExtractor, Orienter
from homolog.matching.choice import extractor_for, method_between
from homolog.matching.quality import MapQuality
from homolog.matching.result import Match
from homolog.methods import AUTO, as_method, find_method
from homolog.pairs import Candidate, ChoiceSettings, Method, Pair, PreprocessedShape

# In the order in which they are believed where their maps are as good.
_WITHOUT_FEATURES = ("axiomatic", "registration")
# The energy of an isometry is 1; of a map to one point it is 0.
_LEAST_ENERGY = 0.1

Seen = Callable[[PreprocessedShape, FeatureExtractor | None], PreprocessedShape]
"""A shape with other features than it has, as they find it to stand."""


@dataclass(frozen=True, eq=False)
class _Way:
    """Pairs with some features, or a method without any, and what is known of them together."""

    pairs: tuple[Pair, ...]
    candidate: Candidate


@torch.no_grad()
def choose(
    pairs: Sequence[Pair], extractors: Sequence[FeatureExtractor], seen: Seen, find: Callable[[Pair], Match]
) -> list[Pair]:
    """A pair with the features that know it best, or a method without features where none do; or several pairs alike.

    Of several pairs the medians of their misfits are compared, so that a single odd shape does not decide.

    Args:
        pairs: with the first features, and with the same options.
        extractors: features of several kinds of shapes, with an orienter each; the first ones are the usual ones.
        seen: gives a shape with other features.
        find: makes the map of a pair.
    """
    if len(extractors) < 2:
        return list(pairs)
    settings = pairs[0].settings.choice
    ways = [_way(pairs)]
    if _misfit_of(ways[0]) > settings.known:
        ways += [_way([_with_features(pair, extractor, seen) for pair in pairs]) for extractor in extractors[1:]]
        ways.sort(key=_misfit_of)
    if _misfit_of(ways[0]) > settings.known_best:
        plausible = [way for way in ways if _misfit_of(way) <= settings.plausible]
        tried = _mapped([*plausible, *_without_features(pairs, seen)], find)
        ways = sorted(tried, key=_map_misfit_of) or ways[:1]
    choice = tuple(way.candidate for way in ways)
    return [replace(pair, choice=choice) for pair in ways[0].pairs]


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


def _way(pairs: Sequence[Pair]) -> _Way:
    extractor = pairs[0].extractor
    assert extractor is not None
    orienter: Orienter = extractor.orienter  # type: ignore[attr-defined]
    # Of a partial pair the full shape tells, or part and whole would have to be of one kind of orienter.
    misfits = [
        max(_misfit(shape, orienter) for shape in ([pair.x] if pair.is_partial else [pair.x, pair.y])) for pair in pairs
    ]
    return _Way(tuple(pairs), Candidate(extractor.info.name, median(misfits)))


def _misfit(shape: PreprocessedShape, orienter: Orienter) -> float:
    """How little the orienter knows a shape; where that was trusted to stand, it is asked now."""
    return (shape.orientations or orienter(shape.operators))[0].misfit


def _with_features(pair: Pair, extractor: FeatureExtractor, seen: Seen) -> Pair:
    source, target = seen(pair.source, extractor), seen(pair.target, extractor)
    method = method_between(source.modality, target.modality, pair.method, pair.settings, extractor)
    return replace(pair, source=source, target=target, method=method, extractor=extractor)


def _without_features(pairs: Sequence[Pair], seen: Seen) -> Iterator[_Way]:
    """The pairs with methods that bring what they compare, where one may be chosen."""
    first = pairs[0]
    for name in _WITHOUT_FEATURES if first.settings.method == AUTO else ():
        method = as_method(find_method(name))
        if first.is_partial and not method.supports.partial:
            continue
        extractor = extractor_for(method, None, first.settings, first.source.operators.points.device)
        yield _Way(tuple(_by_method(pair, method, extractor, seen) for pair in pairs), Candidate(name))


def _by_method(pair: Pair, method: Method, extractor: FeatureExtractor | None, seen: Seen) -> Pair:
    source, target = seen(pair.source, extractor), seen(pair.target, extractor)
    return replace(pair, source=source, target=target, method=method, extractor=extractor)


def _mapped(ways: Iterable[_Way], find: Callable[[Pair], Match]) -> Iterator[_Way]:
    """The ways that lead to maps of most pairs, with what these tell."""
    for way in ways:
        misfit = median(_misfit_of_map(pair, find) for pair in way.pairs)
        if misfit < math.inf:
            yield replace(way, candidate=replace(way.candidate, map_misfit=misfit))


def _misfit_of_map(pair: Pair, find: Callable[[Pair], Match]) -> float:
    try:
        quality = find(pair).quality
    except ShapeError:  # what cannot be matched one way may be another way
        return math.inf
    assert quality is not None
    return map_misfit(quality, pair.settings.choice)
