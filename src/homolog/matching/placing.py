"""Where parts lie: aligned by features, and where these are not sure, by the maps of several places. New here.

Features of another place may be as similar. So where the map by the best alignment contradicts itself, other alignments
are moved towards the full shape, among positions, features and normals, and as rigid bodies. Those that bring most of
the partial shape onto the full one get maps, by features, by features and positions, and by closest points. Of all maps
the one that contradicts itself least is taken.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from homolog.core.method_names import own_methods
from homolog.geometry import some_points
from homolog.maps import Similarity, best_similarity, composed, confidence, handedness
from homolog.matching.alignment import Alignment, AlignmentSearch
from homolog.matching.misfit import quality_misfit
from homolog.matching.parts import align_two_parts
from homolog.matching.placed_points import (
    PartSample,
    PlacedPoints,
    lies_apart,
    maps_by_closest_points,
    maps_by_features_and_positions,
    motion_by_closest_points,
    motion_by_counterparts,
    near_one_another,
    spacing_of,
)
from homolog.matching.quality import quality
from homolog.matching.refinement import method_maps, refine
from homolog.matching.result import following_main_component
from homolog.pairs import Pair, PartsSettings, PlacedMapSettings, PlacementSettings, PointMaps


@torch.no_grad()
def align_parts(pair: Pair) -> Pair:
    """The pair with a partial shape where it lies on the full one, or with two parts where they lie on each other.

    As it is where neither shape is partial, or where it has maps; see ``align_partial``. Where maps can tell whether a
    partial shape lies right, the pair has them: not with landmarks, with ``placement=None``, or by methods whose maps
    are of another kind.
    """
    if pair.are_parts:
        return align_two_parts(pair)
    search = AlignmentSearch.of(pair)
    return pair if search is None else _placed(search)


@dataclass(frozen=True, eq=False)
class _Placement:
    """A pair with its partial shape at a place, with maps there, and how much speaks against these."""

    pair: Pair
    misfit: float


@dataclass(frozen=True, eq=False)
class _Motion:
    """Where an alignment is moved to, from where the partial shape was given.

    Args:
        by_features: by counterparts among features, positions and normals.
        by_points: from there by closest points.
        share: of the partial shape's samples that then lie near the full one.
    """

    by_features: Similarity
    by_points: Similarity
    share: float


def _placed(search: AlignmentSearch) -> Pair:
    """The pair where its map contradicts itself least, if maps can tell."""
    pair, settings, found = search.pair, search.pair.settings.placement, search.best()
    can_tell = pair.near_isometric and pair.method.name in own_methods() and pair.method.supports.refinement
    if settings is None or not can_tell or pair.guidance is not None:  # landmarks say themselves where a part lies
        return search.pair_at(found)
    best, weights = _by_features(search, found, settings), _misfit_of(pair, settings)
    first = best
    if first.misfit > weights.sure:
        for other in _others(search, found, settings):
            best = min(best, other, key=lambda each: each.misfit)
            if best.misfit <= weights.sure:
                break
    return best.pair if best.misfit < first.misfit - weights.margin else first.pair


def _others(search: AlignmentSearch, best: Alignment, settings: PlacementSettings) -> Iterator[_Placement]:
    """Other places, with maps: that of a pre-aligned file, and then those that bring most of the part onto the full."""
    given = Alignment(search.pair.y.operators.points)
    if search.pair.options.pre_aligned and not search.any_size and best.points is not given.points:
        found = _by_features(search, given, settings)
        yield replace(found, misfit=found.misfit - settings.given)
    if (oriented := search.oriented()) is not search:
        search, best = oriented, oriented.best()
        yield _by_features(search, best, settings)
    others = search.others(best, followed=settings.followed, apart=settings.apart)
    samples, moved = _Samples.of(search, settings), list[_Motion]()
    for alignment in (best, *others):
        moved.append(samples.moved(alignment))
        if moved[-1].share > settings.enough:
            break
    moved.sort(key=lambda motion: -motion.share)
    for motion in _distinct(moved, search.pair.y.points_as_given, settings):
        yield from _placements(search, motion, settings)
    for alignment in others[: settings.mapped]:
        yield _by_features(search, alignment, settings)


@dataclass(frozen=True, eq=False)
class _Samples:
    """Samples of the full and the partial shape, of which the latter can be put anywhere."""

    search: AlignmentSearch
    x: PlacedPoints
    y: PartSample
    spacing: float

    @classmethod
    def of(cls, search: AlignmentSearch, settings: PlacementSettings) -> _Samples:
        """The samples of a pair."""
        full, parts = search.pair.x, _parts_of(search)
        x = PlacedPoints.of(full).sampled(settings.full_samples, 0)
        spacing = spacing_of(full) * math.sqrt(full.operators.n_points / len(x.points))
        return cls(search, x, PartSample.of(search.pair.y, parts.samples, 1), spacing)

    def moved(self, found: Alignment) -> _Motion:
        """An alignment that is moved towards the full shape."""
        parts, extractor = _parts_of(self.search), self.search.extractor
        to = best_similarity(self.search.pair.y.points_as_given, found.points)
        for reach in parts.reaches:
            to = composed(motion_by_counterparts(self.x, self.y.at(to, extractor), reach, parts, rigid=True)[0], to)
        there = self.y.at(to, extractor)
        motion = motion_by_closest_points(self.x, there, self.spacing, parts, rigid=True)
        share = float(near_one_another(self.x, there.moved(motion), self.spacing)[1].float().mean())
        return _Motion(to, composed(motion, to), share)


def _distinct(motions: list[_Motion], given: Float[Tensor, "n 3"], settings: PlacementSettings) -> list[_Motion]:
    """The first of those that end in different places."""
    kept: list[_Motion] = []
    for motion in motions:
        if lies_apart(motion.by_points(given), (other.by_points(given) for other in kept), settings.apart):
            kept.append(motion)
    return kept[: settings.mapped]


def _placements(search: AlignmentSearch, motion: _Motion, settings: PlacementSettings) -> Iterator[_Placement]:
    """The pair at both ends of a motion, with maps of several kinds."""
    parts = _parts_of(search)
    if motion.share >= settings.rigid:
        yield _rigid_placement(search, motion, settings)
    pair = _at(search, motion.by_features)
    for maps in (maps_by_features_and_positions(pair.x, pair.y, parts), method_maps(pair)):
        yield _judged(search, pair, refine(pair, maps), settings, motion.by_features.scale)


def _rigid_placement(search: AlignmentSearch, motion: _Motion, settings: PlacementSettings) -> _Placement:
    """The pair with the partial shape as a rigid copy of a part of the full one, by closest points."""
    parts, near = _parts_of(search), _at(search, motion.by_points)
    spacing = spacing_of(near.x, near.y)
    last = motion_by_closest_points(PlacedPoints.of(near.x), PlacedPoints.of(near.y), spacing, parts, rigid=True)
    near = _at(search, composed(last, motion.by_points))
    found = _judged(search, near, maps_by_closest_points(near.x, near.y), settings, motion.by_points.scale)
    return replace(found, misfit=found.misfit + _misfit_of(near, settings).closest_points)


def _by_features(search: AlignmentSearch, found: Alignment, settings: PlacementSettings) -> _Placement:
    """The pair at an alignment, with the maps by its features."""
    pair = search.pair_at(found)
    return _judged(search, pair, refine(pair, method_maps(pair)), settings, found.scale)


def _parts_of(search: AlignmentSearch) -> PartsSettings:
    return search.pair.settings.parts or PartsSettings()


def _at(search: AlignmentSearch, to: Similarity) -> Pair:
    return search.pair_at(Alignment(to(search.pair.y.points_as_given), to.scale))


def _judged(
    search: AlignmentSearch, pair: Pair, maps: PointMaps, settings: PlacementSettings, scale: float
) -> _Placement:
    """A pair with its maps, and their misfit."""
    x, y = pair.x.operators.points, pair.y.operators.points
    x_to_y = following_main_component(maps.x_to_y, pair.x.operators)
    y_to_x = following_main_component(maps.y_to_x, pair.y.operators)
    trust = confidence(y, x, y_to_x, x_to_y, settings=pair.settings.confidence)
    figures = quality(pair.y, pair.x, y_to_x, x_to_y, trust)
    some, weights = some_points(len(y), settings.handed_samples).to(y.device), _misfit_of(pair, settings)
    kept = float(handedness(y[some], x[y_to_x[some]], radius=weights.radius))
    misfit = quality_misfit(figures, cycle=weights.cycle, flipped=weights.flipped, torn=weights.torn)
    misfit += weights.coverage * (1 - figures.coverage)
    misfit += weights.handedness * (1 - min(max(kept, -1.0), 1.0))  # more than 1 is a map that stretches
    misfit += 0.0 if search.any_size else weights.size * abs(math.log(scale))
    return _Placement(replace(pair, maps=maps), misfit)


def _misfit_of(pair: Pair, settings: PlacementSettings) -> PlacedMapSettings:
    return settings.meshes if pair.are_meshes else settings.clouds
