"""Points of a part at a place, with features and normals, and the motions that bring them to those of another shape.

They are iterated closest points (Besl and McKay, 1992): among positions, features and normals at once, or among
positions and normals alone.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import TypeVar

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from homolog.features import FeatureExtractor
from homolog.geometry import Basis, Operators, some_points
from homolog.maps import (
    Similarity,
    best_rotation,
    best_similarity,
    composed,
    cycle_error,
    nearest_neighbour,
    normalised,
    rigid_motion,
)
from homolog.pairs import PartsSettings, PointMaps, PreprocessedShape, Preprocessor
from homolog.shapes import rotation_about

_T = TypeVar("_T", Basis, Operators)

# Fewer pairs of points tell no motion.
_FEWEST_PAIRS = 10
# By which another start must bring a larger share of the points together.
_CLEARLY = 0.02


def placed(partial: _T, points: Float[Tensor, "n 3"], scale: float) -> _T:
    """The basis or operators of a partial shape in another pose and size, where its points are those."""
    if partial.scatter is not None:  # the signs of a cloud's normals follow the pose; a mesh tells out from in
        partial = partial.turned(best_rotation(partial.points, points))
    return replace(partial.scaled(scale), points=points)


def placed_shape(
    shape: PreprocessedShape, points: Float[Tensor, "n 3"], scale: float, extractor: FeatureExtractor
) -> PreprocessedShape:
    """A shape whose points are those, with what its lengths were multiplied by, and the features of that pose."""
    operators = placed(shape.operators, points, scale)
    return replace(
        shape, operators=operators, features=Preprocessor(extractor=extractor).features(operators, shape=shape.name)
    )


@dataclass(frozen=True, eq=False)
class PlacedPoints:
    """Points of a part at a place, with what is compared there.

    Args:
        points: positions (n, 3).
        features: of unit norm (n, d).
        normals: of a mesh (n, 3); None of a cloud, whose normals have no sign.
    """

    points: Float[Tensor, "n 3"]
    features: Float[Tensor, "n d"]
    normals: Float[Tensor, "n 3"] | None

    @classmethod
    def of(cls, shape: PreprocessedShape) -> PlacedPoints:
        """All points of a shape where it lies."""
        points = shape.operators.points
        normals = None if shape.surface is None else torch.from_numpy(shape.surface.vertex_normals).to(points)
        return cls(points, shape.unit_features(), normals)

    def sampled(self, count: int, seed: int) -> PlacedPoints:
        """Some of them."""
        kept = some_points(len(self.points), count, seed=seed).to(self.points.device)
        normals = None if self.normals is None else self.normals[kept]
        return PlacedPoints(self.points[kept], self.features[kept], normals)

    def moved(self, motion: Similarity) -> PlacedPoints:
        """The same points moved, with the features that they had."""
        normals = None if self.normals is None else self.normals @ motion.rotation.T
        return replace(self, points=motion(self.points), normals=normals)


@dataclass(frozen=True, eq=False)
class PartSample:
    """Some points of a part, that can be put anywhere."""

    shape: PreprocessedShape
    kept: Int[Tensor, " s"]
    basis: Basis

    @classmethod
    def of(cls, shape: PreprocessedShape, count: int, seed: int) -> PartSample:
        """So many points of a part."""
        kept = some_points(shape.operators.n_points, count, seed=seed).to(shape.operators.points.device)
        return cls(shape, kept, shape.operators.basis.sampled(kept))

    def at(self, to: Similarity, extractor: FeatureExtractor) -> PlacedPoints:
        """These points moved from where they were given, with the features of that pose."""
        points = to(self.shape.points_as_given[self.kept])
        features = normalised(extractor(placed(self.basis, points, to.scale)))
        if self.shape.surface is None:
            return PlacedPoints(points, features, None)
        normals = torch.from_numpy(self.shape.surface.vertex_normals).to(points)[self.kept]
        return PlacedPoints(points, features, normals @ self.shape.rotation.to(normals) @ to.rotation.T)


def embedded(
    x: PlacedPoints, y: PlacedPoints, reach: float, *, features: float = 0.0, normals: float = 0.0
) -> tuple[Float[Tensor, "n e"], Float[Tensor, "m e"]]:
    """Positions in units of ``reach``, with features and the normals of two meshes by their weights."""
    columns = [[points.points / reach] + ([features * points.features] if features else []) for points in (x, y)]
    if normals and x.normals is not None and y.normals is not None:
        columns = [columns[0] + [normals * x.normals], columns[1] + [normals * y.normals]]
    at_x, at_y = (torch.cat(each, dim=1) for each in columns)
    return at_x, at_y


def motion_by_counterparts(
    x: PlacedPoints, y: PlacedPoints, reach: float, settings: PartsSettings, *, rigid: bool
) -> tuple[Similarity, float]:
    """The motion of y towards x by counterparts that lead home, and the share of points that have one."""
    at_x, at_y = embedded(x, y, reach, features=settings.features, normals=settings.normals)
    y_to_x, x_to_y = nearest_neighbour(at_y, at_x).index, nearest_neighbour(at_x, at_y).index
    homes = cycle_error(y.points, y_to_x, x_to_y), cycle_error(x.points, x_to_y, y_to_x)
    good_y, good_x = (home < max(settings.least_home, reach / 2) for home in homes)
    starts = torch.cat([y.points[good_y], y.points[x_to_y[good_x]]])
    ends = torch.cat([x.points[y_to_x[good_y]], x.points[good_x]])
    return _motion_between(starts, ends, rigid=rigid), float(torch.cat([good_y, good_x]).float().mean())


def motion_by_closest_points(
    x: PlacedPoints, y: PlacedPoints, spacing: float, settings: PartsSettings, *, rigid: bool
) -> Similarity:
    """The motion that brings y nearest to x, by closest points within ever fewer spacings.

    Features may be wrong alike everywhere, so it begins from some turns as well, on samples.
    """
    some_x, some_y = x.sampled(settings.samples, 0), y.sampled(settings.samples, 1)
    reaches = [max(reach, 2 * spacing) for reach in settings.reaches]
    motion, best = no_motion(x.points), -1.0
    for number, start in enumerate(_turns(y, settings.turn)):
        # Within a wide reach, what a part lacks draws it away from where features put it.
        way = _followed(some_x, some_y, start, reaches if number else reaches[-1:], rigid=rigid)
        share = float(torch.cat(near_one_another(some_x, some_y.moved(way), reaches[-1])).float().mean())
        if share > best + _CLEARLY:  # the first start is that of features
            motion, best = way, share
    for spacings in settings.closest:
        motion = composed(_closest(x, y.moved(motion), spacings * spacing, rigid=rigid), motion)
    return motion


def near_one_another(x: PlacedPoints, y: PlacedPoints, reach: float) -> tuple[Bool[Tensor, " n"], Bool[Tensor, " m"]]:
    """Which points of both have a near one on the other that faces the same way."""
    at_x, at_y = embedded(x, y, reach, normals=1.0)
    return nearest_neighbour(at_x, at_y).value < 1, nearest_neighbour(at_y, at_x).value < 1


def maps_by_features_and_positions(x: PreprocessedShape, y: PreprocessedShape, settings: PartsSettings) -> PointMaps:
    """Point maps between shapes that lie on each other: by features and, less, by positions."""
    at = embedded(PlacedPoints.of(x), PlacedPoints.of(y), settings.bent_reach, features=settings.features)
    return _nearest(x, y, *at)


def maps_by_closest_points(x: PreprocessedShape, y: PreprocessedShape) -> PointMaps:
    """Point maps between shapes that lie on each other as rigid bodies: closest points that face one way."""
    spacing = spacing_of(x, y)
    return _nearest(x, y, *embedded(PlacedPoints.of(x), PlacedPoints.of(y), spacing, normals=1.0))


def lies_apart(points: Float[Tensor, "n 3"], others: Iterable[Float[Tensor, "n 3"]], apart: float) -> bool:
    """Whether points lie farther than that, on average, from where they lie at all other places."""
    return all((points - other).norm(dim=1).mean() > apart for other in others)


def spacing_of(*shapes: PreprocessedShape) -> float:
    """The typical distance between neighbouring points, sqrt(area / n), of the coarsest of some shapes."""
    return max(float((shape.operators.mass.sum() / shape.operators.n_points).sqrt()) for shape in shapes)


def no_motion(like: Tensor) -> Similarity:
    """The transform that leaves all points where they are."""
    return Similarity(torch.eye(3), 1.0, torch.zeros(3)).to(like)


def _nearest(
    x: PreprocessedShape, y: PreprocessedShape, at_x: Float[Tensor, "n e"], at_y: Float[Tensor, "m e"]
) -> PointMaps:
    """For each point the nearest of the other's main component, there and back."""
    main_x, main_y = (torch.nonzero(shape.operators.in_main_component)[:, 0] for shape in (x, y))
    return PointMaps(
        main_y[nearest_neighbour(at_x, at_y[main_y]).index], main_x[nearest_neighbour(at_y, at_x[main_x]).index]
    )


def _followed(
    x: PlacedPoints, y: PlacedPoints, motion: Similarity, reaches: Sequence[float], *, rigid: bool
) -> Similarity:
    """Where closest points within each reach lead from a start."""
    for reach in reaches:
        motion = composed(_closest(x, y.moved(motion), reach, rigid=rigid), motion)
    return motion


def _turns(y: PlacedPoints, degrees: float) -> Iterator[Similarity]:
    """No motion, and turns about the middle of a part, to either side of each axis."""
    yield no_motion(y.points)
    middle = y.points.mean(dim=0)
    for axis, sign in product(range(3), (-1, 1)):
        turn = torch.from_numpy(rotation_about(axis, sign * degrees)).to(middle)
        yield Similarity(turn, 1.0, middle - turn @ middle)


def _motion_between(starts: Float[Tensor, "p 3"], ends: Float[Tensor, "p 3"], *, rigid: bool) -> Similarity:
    """The robust rigid motion that takes points to others, or the similarity transform near it."""
    if len(starts) < _FEWEST_PAIRS:
        return no_motion(starts)
    rotation, shift = rigid_motion(starts, ends)
    if rigid:
        return Similarity(rotation, 1.0, shift)
    missed = (starts @ rotation.T + shift - ends).norm(dim=1)
    return best_similarity(starts, ends, 1 / (1 + (missed / missed.median().clamp(min=1e-6)) ** 2))


def _closest(x: PlacedPoints, y: PlacedPoints, reach: float, *, rigid: bool) -> Similarity:
    """The motion of y towards x by closest points that are no farther than ``reach``, both ways."""
    at_x, at_y = embedded(x, y, reach, normals=1.0)
    y_to_x, x_to_y = nearest_neighbour(at_y, at_x), nearest_neighbour(at_x, at_y)
    near_y, near_x = y_to_x.value < 1, x_to_y.value < 1
    starts = torch.cat([y.points[near_y], y.points[x_to_y.index[near_x]]])
    ends = torch.cat([x.points[y_to_x.index[near_y]], x.points[near_x]])
    return _motion_between(starts, ends, rigid=rigid)
