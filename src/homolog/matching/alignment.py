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
from typing import TypeAlias, TypeVar

import torch
from jaxtyping import Float
from torch import Tensor

from homolog.features import FeatureExtractor
from homolog.geometry import Basis, Operators, some_points
from homolog.maps import Similarity, best_rotation, best_similarity, most_similar, normalised, rigid_motion
from homolog.matching.units import LIKELY_SHARE, has_unknown_units, in_likely_units
from homolog.pairs import AlignmentSettings, Pair, PreprocessedShape, Preprocessor
from homolog.shapes import rotation_about

_T = TypeVar("_T", Basis, Operators)

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
    settings, extractor = pair.settings.alignment, pair.extractor
    if not pair.is_partial or settings is None or extractor is None or not extractor.info.follows_pose:
        return pair
    unknown = has_unknown_units(pair)
    pair = in_likely_units(pair) if unknown else pair
    full, partial = pair.x, pair.y
    basis, given = partial.operators.basis, partial.points_as_given
    starts = tuple(_oriented_starts(full, partial, given, settings, _of_landmarks(pair)))
    found = best_alignment(
        basis,
        extractor,
        full.operators.points,
        full.needed_features(),
        search=extractor.info.partial,
        settings=settings,
        starts=(*starts, *_sized_starts(pair, settings)) if unknown else starts,
        any_size=unknown,
    )
    if found.points is basis.points:
        return pair
    operators = placed(partial.operators, found.points, found.scale)
    features = Preprocessor(extractor=extractor).features(operators, shape=partial.name)
    alignment = best_similarity(given, found.points)
    units = full.operators.scale / (partial.operators.scale * pair.options.partial_scale)  # 1 where they are known
    alignment = replace(alignment, scale=alignment.scale * units)
    aligned = pair.with_y(replace(partial, operators=operators, features=features))
    return replace(aligned, alignment=alignment)


def _sized_starts(pair: Pair, settings: AlignmentSettings) -> Iterator[Start]:
    """A partial shape in unknown units in the sizes that a part may have."""
    given, full = pair.y.points_as_given, pair.x.operators
    own = (pair.y.operators.centre / pair.y.operators.scale).to(given)
    for share in settings.shares:
        scale = math.sqrt(share / LIKELY_SHARE)
        # In one frame but for the unit, sizes are about the origin of the files.
        shift = scale * own - (full.centre / full.scale).to(given) if pair.options.pre_aligned else 0.0
        yield scale * given + shift, scale


def _of_landmarks(pair: Pair) -> Similarity | None:
    """What takes the partial shape as it was given onto the full one by their landmarks."""
    if pair.guidance is None or not pair.guidance.tells_rotation(pair.x.operators, pair.y.operators):
        return None
    starts, ends = pair.y.points_as_given[pair.guidance.y], pair.x.operators.points[pair.guidance.x]
    return best_similarity(starts, ends, pair.guidance.weights)


def _oriented_starts(
    full: PreprocessedShape,
    partial: PreprocessedShape,
    given: Float[Tensor, "n 3"],
    settings: AlignmentSettings,
    known: Similarity | None,
) -> Iterator[Start]:
    """Where landmarks and the features' orienter put the partial shape on the full one, in their size and as given."""
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


def placed(partial: _T, points: Float[Tensor, "n 3"], scale: float) -> _T:
    """The basis or operators of a partial shape in another pose and size, where its points are those."""
    if partial.scatter is not None:  # the signs of a cloud's normals follow the pose; a mesh tells out from in
        partial = partial.turned(best_rotation(partial.points, points))
    return replace(partial.scaled(scale), points=points)


def _moved(points: Float[Tensor, "n 3"], axis: int, degrees: float, scale: float) -> Float[Tensor, "n 3"]:
    """Positions rotated and scaled about their centre."""
    centre = points.mean(dim=0)
    return scale * (points - centre) @ torch.from_numpy(rotation_about(axis, degrees).T).to(points) + centre
