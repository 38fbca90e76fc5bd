"""Aligning a partial shape with the full one by a similarity transform. New here.

Features follow from positions, and a scan seldom stands as the same part of the full shape does. The map itself, good
enough here and there, says where the partial shape belongs; from there on features, and so the map, are better. This is
iterated closest points (Besl and McKay, 1992) with the most similar features in place of the closest points.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import torch
from jaxtyping import Float
from torch import Tensor

from homolog.features import FeatureExtractor
from homolog.geometry import Basis, some_points
from homolog.maps import Similarity, best_similarity, most_similar, normalised, rigid_motion
from homolog.matching.placed_points import lies_apart, placed, placed_shape
from homolog.matching.units import LIKELY_SHARE, has_unknown_units, in_likely_units
from homolog.pairs import AlignmentSettings, Pair, PreprocessedShape, Preprocessor
from homolog.shapes import rotation_about

Start: TypeAlias = tuple[Float[Tensor, "n 3"], float]
"""Positions of a partial shape in the full shape's coordinates, and what its lengths were multiplied by."""

# Centres this near to one another are the same.
_SAME_CENTRE = 1e-3


@dataclass(frozen=True, eq=False)
class Alignment:
    """A pose and size of the partial shape.

    Args:
        points: its positions there, in the full shape's normalised coordinates (n, 3).
        scale: what its lengths were multiplied by.
        similarity: mean cosine between its features there and the most similar ones of the full shape.
    """

    points: Float[Tensor, "n 3"]
    scale: float = 1.0
    similarity: float = -math.inf


@torch.no_grad()
def align_partial(pair: Pair) -> Pair:
    """The pair with its partial shape rotated, moved and scaled to fit the features of the full shape best.

    The pair as it is, where neither shape is partial, the features do not follow the pose, or the settings say so. The
    operators' points are then no longer where ``centre`` and ``scale`` put those of the file.
    """
    search = AlignmentSearch.of(pair)
    return pair if search is None else search.pair_at(search.best())


@dataclass(frozen=True, eq=False)
class AlignmentSearch:
    """The search for where the partial shape of a pair lies on the full one, by features.

    Args:
        pair: its partial shape, if it is in unknown units, is in likely ones.
        extractor: of its features, which follow the pose.
        settings: of the search.
        starts: positions and sizes to start from, besides those given.
        any_size: the size as given means nothing.
    """

    pair: Pair
    extractor: FeatureExtractor
    settings: AlignmentSettings
    starts: tuple[Start, ...]
    any_size: bool

    @classmethod
    def of(cls, pair: Pair) -> AlignmentSearch | None:
        """The search for a pair; None where there is nothing to look for."""
        settings, extractor = pair.settings.alignment, pair.extractor
        if not pair.is_partial or pair.maps is not None or settings is None or extractor is None:
            return None
        if not extractor.info.follows_pose:
            return None
        unknown = has_unknown_units(pair)
        pair = in_likely_units(pair) if unknown else pair
        starts = tuple(_oriented_starts(pair.x, pair.y, settings, _of_landmarks(pair)))
        starts = (*starts, *_sized_starts(pair, settings)) if unknown else starts
        return cls(pair, extractor, settings, starts, unknown)

    def best(self) -> Alignment:
        """The best alignment; see ``best_alignment``."""
        return best_alignment(
            self.pair.y.operators.basis,
            self.extractor,
            self.pair.x.operators.points,
            self.pair.x.needed_features(),
            search=self.extractor.info.partial,
            settings=self.settings,
            starts=self.starts,
            any_size=self.any_size,
        )

    def others(self, best: Alignment, *, followed: int, apart: float) -> list[Alignment]:
        """Alignments elsewhere, the most similar first: from all starts, those that are the most promising.

        Args:
            best: the one that is known.
            followed: how many starts are followed.
            apart: by how much the points of two alignments must differ on average.
        """
        x, y = self.pair.x, self.pair.y.operators.basis
        looked = _Search(y, self.extractor, x.operators.points, x.needed_features(), self.settings)
        starts = [*([] if self.any_size else [(y.points, 1.0)]), *self.starts]
        if self.extractor.info.partial and not self.any_size:
            unturned, *turned = self.settings.rotations
            starts += [(_moved(y.points, *rotation, 1.0), 1.0) for rotation in turned]
            starts += [(_moved(y.points, *unturned, scale), scale) for scale in self.settings.scales]
        kept = [best]
        for found in looked.ends([looked.at(*start) for start in starts], followed):
            if lies_apart(found.points, (other.points for other in kept), apart):
                kept.append(found)
        return kept[1:]

    def oriented(self) -> AlignmentSearch:
        """The search for the same pair turned as the orienter finds its full shape to stand, though poses were trusted.

        It is the same one where the orienter was asked before, or there is none.
        """
        pair, x, y = self.pair, self.pair.x, self.pair.y
        if x.orientations or getattr(self.extractor, "orienter", None) is None:
            return self
        preprocess = Preprocessor(extractor=self.extractor, orientation=pair.settings.orientation)
        full, partial = preprocess.again(x), preprocess.again(y, partial=True)
        if not full.orientations:
            return self
        # Both turn alike, as they lie in one frame.
        turned = pair.with_y(partial.turned(full.rotation, self.extractor))
        turned = replace(turned, target=full) if turned.x is turned.target else replace(turned, source=full)
        return AlignmentSearch.of(turned) or self

    def pair_at(self, found: Alignment) -> Pair:
        """The pair with its partial shape there."""
        pair, y = self.pair, self.pair.y
        if found.points is y.operators.points:
            return pair
        units = pair.x.operators.scale / (y.operators.scale * pair.options.partial_scale)  # 1 where they are known
        # Where poses are trusted, the full shape may have been turned for its features' sake alone.
        lies = found.points @ pair.x.rotation.to(found.points) if pair.options.orient == "given" else found.points
        alignment = best_similarity(y.points_as_given, lies)
        alignment = replace(alignment, scale=alignment.scale * units)
        aligned = pair.with_y(placed_shape(y, found.points, found.scale, self.extractor))
        return replace(aligned, alignment=alignment)


def _sized_starts(pair: Pair, settings: AlignmentSettings) -> Iterator[Start]:
    """A partial shape in unknown units in the sizes that a part may have."""
    given, full = pair.y.points_as_given, pair.x.operators
    full_rotation = pair.x.rotation.to(given)
    own = (pair.y.operators.centre / pair.y.operators.scale).to(given)
    for share in settings.shares:
        scale = math.sqrt(share / LIKELY_SHARE)
        # In one frame but for the unit, sizes are about the origin of the files.
        shift = scale * own - (full.centre / full.scale).to(given) if pair.options.pre_aligned else 0.0
        points = scale * given + shift
        # In one frame, both are turned alike.
        yield points @ full_rotation.T if pair.options.pre_aligned else points, scale


def _of_landmarks(pair: Pair) -> Similarity | None:
    """What takes the partial shape as it was given onto the full one by their landmarks."""
    if pair.guidance is None or not pair.guidance.tells_rotation(pair.x.operators, pair.y.operators):
        return None
    starts, ends = pair.y.points_as_given[pair.guidance.y], pair.x.operators.points[pair.guidance.x]
    return best_similarity(starts, ends, pair.guidance.weights)


def _oriented_starts(
    full: PreprocessedShape,
    partial: PreprocessedShape,
    settings: AlignmentSettings,
    known: Similarity | None,
) -> Iterator[Start]:
    """Where landmarks and the features' orienter put the partial shape on the full one, in their size and as given."""
    given = partial.points_as_given
    if known is not None:
        yield from _both_sizes(known(given), known.scale)
    if not full.orientations or full.orientations[0].upright is None:
        return
    onto_full = full.orientations[0].upright.inverse()
    for orientation in partial.orientations[: settings.orientations]:
        if orientation.upright is None:
            continue
        points = onto_full(orientation.upright(given)) @ full.rotation.to(given).T
        yield from _both_sizes(points, orientation.upright.scale * onto_full.scale)


def _both_sizes(points: Float[Tensor, "n 3"], scale: float) -> Iterator[Start]:
    """Positions in the size that was found, and in the given one."""
    yield points, scale
    centre = points.mean(dim=0)
    yield (points - centre) / scale + centre, 1.0


def best_alignment(
    partial: Basis,
    extractor: FeatureExtractor,
    full: Float[Tensor, "m 3"],
    full_features: Float[Tensor, "m d"],
    *,
    search: bool,
    settings: AlignmentSettings | None = None,
    starts: Sequence[Start] = (),
    any_size: bool = False,
) -> Alignment:
    """The pose and size in which a partial shape's features resemble those of the full shape the most.

    Each step, the partial shape follows the rigid motion towards the points of the full one with the most similar
    features. It starts as it is given, and with both centres in one place.

    Args:
        partial: in the full shape's scale.
        extractor: of features that follow the pose.
        full: positions of the full shape.
        full_features: there.
        search: where the partial shape does not come to resemble the full one, start anew with it larger or smaller, as
            it may be of another individual, and then rotated. That is for networks that know partial shapes: to others,
            a wrong pose is often as good as the right one.
        settings: of the search.
        starts: positions and sizes to start from as well. Where there are some, no rotations are tried.
        any_size: the size as given means nothing: only the other starts count, and the size that is found is refined.
    """
    settings = settings or AlignmentSettings()
    looked = _Search(partial, extractor, full, full_features, settings)
    unturned, *turned = settings.rotations
    best = looked.followed([looked.at(*start) for start in starts] if any_size else [looked.at(partial.points)])
    if starts and not any_size:
        best = _clearly_better(looked.followed([looked.at(*start) for start in starts]), best, settings.margin)
    if search and best.similarity < settings.similar:
        sizes = [(scale * best.scale, _moved(best.points, *unturned, scale)) for scale in settings.scales]
        others = [looked.at(points, scale) for scale, points in sizes]
        best = _clearly_better(looked.followed(others), best, settings.margin)
    if search and best.similarity < settings.similar and not starts:
        scales = dict.fromkeys((1.0, best.scale))
        others = [looked.at(_moved(partial.points, *rotation, scale), scale) for scale in scales for rotation in turned]
        best = _clearly_better(looked.followed(others), best, settings.margin)
    return looked.resized(best) if any_size else best


def _clearly_better(other: Alignment, best: Alignment, margin: float) -> Alignment:
    return other if other.similarity > best.similarity + margin else best


@dataclass(frozen=True, eq=False)
class _Step:
    """An alignment that was looked at, and the motion towards where the partial shape seems to belong from there."""

    alignment: Alignment
    rotation: Float[Tensor, "3 3"]
    shift: Float[Tensor, " 3"]


class _Search:
    """Samples of both shapes, and how well alignments fit."""

    def __init__(
        self,
        partial: Basis,
        extractor: FeatureExtractor,
        full: Float[Tensor, "m 3"],
        full_features: Float[Tensor, "m d"],
        settings: AlignmentSettings,
    ) -> None:
        self._some = some_points(partial.n_points, settings.partial_samples).to(partial.points.device)
        among = some_points(len(full), settings.full_samples).to(partial.points.device)
        self._basis, self._extractor, self._settings = partial.sampled(self._some), extractor, settings
        self._positions, self._candidates = full[among], normalised(full_features[among])
        self._centre = full.mean(dim=0)

    def at(self, points: Float[Tensor, "n 3"], scale: float = 1.0) -> list[_Step]:
        """A start, and the same with both centres in one place."""
        away = self._centre - points.mean(dim=0)
        starts = (points, points + away) if away.norm() > _SAME_CENTRE else (points,)
        return [self._step(start, scale) for start in starts]

    def followed(self, starts: Sequence[Sequence[_Step]]) -> Alignment:
        """The best alignment on the ways from those starts that are the most promising."""
        ranked = sorted(starts, key=lambda steps: -max(step.alignment.similarity for step in steps))
        promising = itertools.chain.from_iterable(ranked[: self._settings.followed])
        ways = (alignment for step in promising for alignment in self._way(step))
        return max(ways, key=lambda alignment: alignment.similarity)

    def ends(self, starts: Sequence[Sequence[_Step]], count: int) -> list[Alignment]:
        """The best alignment on each of the most promising ways, the most similar first."""
        steps = sorted(itertools.chain.from_iterable(starts), key=lambda step: -step.alignment.similarity)
        ends = (max(self._way(step), key=lambda found: found.similarity) for step in steps[:count])
        return sorted(ends, key=lambda found: -found.similarity)

    def resized(self, best: Alignment) -> Alignment:
        """The best alignment in sizes near that of one."""
        for step in self._settings.size_steps:
            for factor in (step, 1 / step):
                while True:
                    scaled = _moved(best.points, 0, 0, factor)
                    other = self.followed([[self._step(scaled, factor * best.scale)]])
                    if other.similarity <= best.similarity:
                        break
                    best = other
        return best

    def _way(self, step: _Step) -> Iterator[Alignment]:
        """An alignment, and those that each lie where the one before it seems to belong."""
        yield step.alignment
        for _ in range(self._settings.steps - 1):
            step = self._step(step.alignment.points @ step.rotation.T + step.shift, step.alignment.scale)
            yield step.alignment

    def _step(self, points: Float[Tensor, "n 3"], scale: float) -> _Step:
        some = points[self._some]
        features = self._extractor(placed(self._basis, some, scale))
        found = most_similar(normalised(features), self._candidates)
        alignment = Alignment(points, scale, float(found.value.mean()))
        return _Step(alignment, *rigid_motion(some, self._positions[found.index]))


def _moved(points: Float[Tensor, "n 3"], axis: int, degrees: float, scale: float) -> Float[Tensor, "n 3"]:
    """Positions rotated and scaled about their centre."""
    centre = points.mean(dim=0)
    return scale * (points - centre) @ torch.from_numpy(rotation_about(axis, degrees).T).to(points) + centre
