"""Aligning two parts of one shape that overlap, and telling whether they lie on each other as rigid bodies. New here.

Each part alone says where it lies on the upright shape: by the features' orienter. There both are compared. Features
alone place a point to a few hundredths of a body, and say little of where the other part ends. Two scans of a body that
holds still, or two fragments, are one rigid body: that is found by iterated closest points (Besl and McKay, 1992) among
positions, features and normals at once, of which positions count ever more. Only counterparts that lead home count, as
others may belong to what the other part lacks.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from homolog.features import FeatureExtractor
from homolog.geometry import Basis, Surface, some_points
from homolog.geometry.projection import SurfaceProjector
from homolog.maps import (
    Similarity,
    best_similarity,
    composed,
    coverage_density,
    cycle_error,
    nearest_neighbour,
    normalised,
    rigid_motion,
)
from homolog.matching.alignment import align_partial, placed
from homolog.pairs import Pair, PartsFit, PartsSettings, PointMaps, PreprocessedShape, Preprocessor
from homolog.shapes import Shape, rotation_about

# Fewer pairs of points tell no motion.
_FEWEST_PAIRS = 10
# By which another start must bring a larger share of the points together.
_CLEARLY = 0.02
# The least barycentric coordinate within a triangle; less is on its edge.
_ON_EDGE = 1e-6
# A point at a boundary lies on the surface that is within this share of what is allowed elsewhere.
_ON_BOUNDARY = 0.1


@torch.no_grad()
def align_parts(pair: Pair) -> Pair:
    """The pair with a partial shape aligned with the full one, or two parts with each other.

    As it is where neither shape is partial; see also ``align_partial``. Two parts are placed on the upright shape where
    the features' orienter knows parts, and the target is then moved onto the source. Their operators' points are no
    longer where ``centre`` and ``scale`` put those of the files.
    """
    if not pair.are_parts:
        return align_partial(pair)
    settings, extractor = pair.settings.parts, pair.extractor
    if settings is None or extractor is None or not extractor.info.follows_pose:
        return pair
    search = _Search(pair, extractor, settings)
    ranked = sorted(map(search.coarse, _starts(pair, settings)), key=lambda found: -found.agreeing)
    ways = (search.finished(found) for found in ranked[: settings.followed])
    first = next(ways)
    if first.fit is not None and first.fit.rigid:
        return first
    return next((way for way in ways if way.fit is not None and way.fit.rigid), first)


@torch.no_grad()
def maps_of_parts(pair: Pair) -> PointMaps:
    """Point maps between two aligned parts: nearest points that face one way, of rigid ones; else by features as well.

    Every point has a counterpart; ``overlap_of_parts`` tells which of them to believe.
    """
    assert pair.fit is not None and pair.settings.parts is not None
    if not pair.fit.rigid:
        return PointMaps(*_bent_maps(pair.x, pair.y, pair.settings.parts))
    x, y = _Points.of(pair.x), _Points.of(pair.y)
    return PointMaps(*_nearest(pair.x, pair.y, *_embedded(x, y, max(_spacing(pair.x), _spacing(pair.y)), normals=1.0)))


def overlap_of_parts(
    pair: Pair, x_to_y: Int[Tensor, " n_x"], y_to_x: Int[Tensor, " n_y"]
) -> tuple[Bool[Tensor, " n_x"], Bool[Tensor, " n_y"]]:
    """Which points of two parts have a counterpart on the other.

    Of rigid parts those that lie on the other's surface. Of others the mass of each part is pushed along its map to the
    other, and smoothed there, as that of a partial shape is to a full one; see ``coverage_density``.

    Args:
        pair: two parts.
        x_to_y: for each point of x a point of y (n_x,).
        y_to_x: for each point of y a point of x (n_y,).
    """
    x, y = pair.x.operators, pair.y.operators
    settings, confidence = pair.settings.parts or PartsSettings(), pair.settings.confidence
    if pair.fit is not None and pair.fit.rigid:
        return _on_each_other(pair.x, pair.y, settings)
    confidence = replace(confidence, smoothing=settings.bent_smoothing)
    on_x: Tensor = coverage_density(x, y.mass, y_to_x, settings=confidence) >= confidence.overlap_threshold
    on_y: Tensor = coverage_density(y, x.mass, x_to_y, settings=confidence) >= confidence.overlap_threshold
    return on_x, on_y


def _starts(pair: Pair, settings: PartsSettings) -> Iterator[_Found]:
    """Where both parts begin: as the orienter finds them, each way with each; else as given, and with one centre."""
    x, y = pair.x, pair.y
    uprights = ([each for each in shape.orientations if each.upright is not None] for shape in (x, y))
    likely = sorted(product(*uprights), key=lambda both: both[0].misfit + both[1].misfit)[: settings.starts]
    for one, other in likely:
        yield _upright(x, y, one.upright, other.upright, settings)  # type: ignore[arg-type]
    if likely:
        return
    as_given = _nothing(x.operators.points)
    yield _Found(as_given, as_given)
    if not pair.options.pre_aligned:
        away = x.points_as_given.mean(dim=0) - y.points_as_given.mean(dim=0)
        yield _Found(as_given, replace(as_given, shift=away))


def _upright(
    x: PreprocessedShape, y: PreprocessedShape, to_x: Similarity, to_y: Similarity, settings: PartsSettings
) -> _Found:
    """Both parts where the orienter puts them; in one scale, unless what it finds differs by more than it errs."""
    if abs(math.log(to_x.scale / to_y.scale)) > math.log(settings.same_units):
        return _Found(to_x, to_y)
    scale = math.sqrt(to_x.scale * to_y.scale)
    return _Found(_rescaled(to_x, scale, x), _rescaled(to_y, scale, y))


def _rescaled(similarity: Similarity, scale: float, shape: PreprocessedShape) -> Similarity:
    """The transform with another scale that takes the middle of a shape to the same place."""
    middle = shape.points_as_given.mean(dim=0)
    return replace(similarity, scale=scale, shift=similarity(middle[None])[0] - scale * similarity.rotation @ middle)


@dataclass(frozen=True, eq=False)
class _Points:
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
    def of(cls, shape: PreprocessedShape) -> _Points:
        """All points of a shape where it lies."""
        points = shape.operators.points
        normals = None if shape.surface is None else torch.from_numpy(shape.surface.vertex_normals).to(points)
        return cls(points, shape.unit_features(), normals)

    def sampled(self, count: int, seed: int) -> _Points:
        """Some of them."""
        kept = some_points(len(self.points), count, seed=seed).to(self.points.device)
        normals = None if self.normals is None else self.normals[kept]
        return _Points(self.points[kept], self.features[kept], normals)

    def moved(self, motion: Similarity) -> _Points:
        """The same points moved, with the features that they had."""
        normals = None if self.normals is None else self.normals @ motion.rotation.T
        return replace(self, points=motion(self.points), normals=normals)


def _embedded(
    x: _Points, y: _Points, reach: float, *, features: float = 0.0, normals: float = 0.0
) -> tuple[Float[Tensor, "n e"], Float[Tensor, "m e"]]:
    """Positions in units of ``reach``, with features and the normals of two meshes by their weights."""
    columns = [[points.points / reach] + ([features * points.features] if features else []) for points in (x, y)]
    if normals and x.normals is not None and y.normals is not None:
        columns = [columns[0] + [normals * x.normals], columns[1] + [normals * y.normals]]
    at_x, at_y = (torch.cat(each, dim=1) for each in columns)
    return at_x, at_y


def _bent_maps(
    x: PreprocessedShape, y: PreprocessedShape, settings: PartsSettings
) -> tuple[Int[Tensor, " n"], Int[Tensor, " m"]]:
    """Maps there and back by features and, less, by positions."""
    embedded = _embedded(_Points.of(x), _Points.of(y), settings.bent_reach, features=settings.features)
    return _nearest(x, y, *embedded)


def _nearest(
    x: PreprocessedShape, y: PreprocessedShape, at_x: Float[Tensor, "n e"], at_y: Float[Tensor, "m e"]
) -> tuple[Int[Tensor, " n"], Int[Tensor, " m"]]:
    """For each point the nearest of the other's main component, there and back."""
    main_x, main_y = (torch.nonzero(shape.operators.in_main_component)[:, 0] for shape in (x, y))
    return main_y[nearest_neighbour(at_x, at_y[main_y]).index], main_x[nearest_neighbour(at_y, at_x[main_x]).index]


@dataclass(frozen=True, eq=False)
class _Found:
    """Where both parts go from where they were given, and the share of samples that were led home there."""

    x: Similarity
    y: Similarity
    agreeing: float = 0.0

    @property
    def one_scale(self) -> bool:
        """Whether both have one scale, which is kept."""
        return math.isclose(self.x.scale, self.y.scale, rel_tol=1e-6)


@dataclass(frozen=True, eq=False)
class _Search:
    """The search for the motion that brings the target of a pair onto the source."""

    pair: Pair
    extractor: FeatureExtractor
    settings: PartsSettings

    def coarse(self, start: _Found) -> _Found:
        """From a start, on samples, whose features are computed anew in each step."""
        x, y = (_Sample.of(shape, self.settings.samples, seed) for seed, shape in enumerate((self.pair.x, self.pair.y)))
        at_x, found = x.at(start.x, self.extractor), start
        for reach in self.settings.reaches:
            motion, agreeing = self._motion(at_x, y.at(found.y, self.extractor), reach, rigid=start.one_scale)
            found = _Found(start.x, composed(motion, found.y), agreeing)
        return found

    def finished(self, found: _Found) -> Pair:
        """The pair with both parts there, moved by closest points where they are rigid, and how well they fit."""
        pair, extractor = self.pair, self.extractor
        x, y = _moved_to(pair.x, found.x, extractor), _moved_to(pair.y, found.y, extractor)
        motion = self._closest(_Points.of(x), _Points.of(y), max(_spacing(x), _spacing(y)), rigid=found.one_scale)
        nearer = _moved_to(pair.y, composed(motion, found.y), extractor)
        fit = self._fit(x, nearer)
        y = nearer if fit.rigid else y
        alignment = best_similarity(pair.y.points_as_given, found.x.inverse()(y.operators.points))
        return replace(pair, source=x, target=y, alignment=alignment, fit=fit)

    def _fit(self, x: PreprocessedShape, y: PreprocessedShape) -> PartsFit:
        """The shares of both that lie on the other, near where features would have their counterparts."""
        there, back = _bent_maps(x, y, self.settings)
        at_x, at_y = x.operators.points, y.operators.points
        agree = ((at_x - at_y[there]).norm(dim=1), (at_y - at_x[back]).norm(dim=1))
        on = _on_each_other(x, y, self.settings)
        shares = [
            float((lies & (away < self.settings.agreeing)).float().mean()) for lies, away in zip(on, agree, strict=True)
        ]
        return PartsFit(*shares, rigid=min(shares) >= self.settings.least_rigid)

    def _motion(self, x: _Points, y: _Points, reach: float, *, rigid: bool) -> tuple[Similarity, float]:
        """The motion of y towards x by counterparts that lead home, and the share of points that have one."""
        settings = self.settings
        at_x, at_y = _embedded(x, y, reach, features=settings.features, normals=settings.normals)
        y_to_x, x_to_y = nearest_neighbour(at_y, at_x).index, nearest_neighbour(at_x, at_y).index
        homes = cycle_error(y.points, y_to_x, x_to_y), cycle_error(x.points, x_to_y, y_to_x)
        good_y, good_x = (home < max(settings.least_home, reach / 2) for home in homes)
        starts = torch.cat([y.points[good_y], y.points[x_to_y[good_x]]])
        ends = torch.cat([x.points[y_to_x[good_y]], x.points[good_x]])
        return _motion_between(starts, ends, rigid=rigid), float(torch.cat([good_y, good_x]).float().mean())

    def _closest(self, x: _Points, y: _Points, spacing: float, *, rigid: bool) -> Similarity:
        """The motion that brings y nearest to x, by closest points within ever fewer spacings.

        Features may be wrong alike everywhere, so it begins from some turns as well, on samples.
        """
        some_x, some_y = x.sampled(self.settings.samples, 0), y.sampled(self.settings.samples, 1)
        reaches = [max(reach, 2 * spacing) for reach in self.settings.reaches]
        motion, best = _nothing(x.points), -1.0
        for number, start in enumerate(_turns(y, self.settings.turn)):
            # Within a wide reach, what a part lacks draws it away from where features put it.
            way = _followed(some_x, some_y, start, reaches if number else reaches[-1:], rigid=rigid)
            share = _share_near(some_x, some_y.moved(way), reaches[-1])
            if share > best + _CLEARLY:  # the first start is that of features
                motion, best = way, share
        for spacings in self.settings.closest:
            motion = composed(_closest(x, y.moved(motion), spacings * spacing, rigid=rigid), motion)
        return motion


def _followed(x: _Points, y: _Points, motion: Similarity, reaches: Sequence[float], *, rigid: bool) -> Similarity:
    """Where closest points within each reach lead from a start."""
    for reach in reaches:
        motion = composed(_closest(x, y.moved(motion), reach, rigid=rigid), motion)
    return motion


def _turns(y: _Points, degrees: float) -> Iterator[Similarity]:
    """No motion, and turns about the middle of a part, to either side of each axis."""
    yield _nothing(y.points)
    middle = y.points.mean(dim=0)
    for axis, sign in product(range(3), (-1, 1)):
        turn = torch.from_numpy(rotation_about(axis, sign * degrees)).to(middle)
        yield Similarity(turn, 1.0, middle - turn @ middle)


def _share_near(x: _Points, y: _Points, reach: float) -> float:
    """The share of the points of both that have a near one on the other which faces the same way."""
    at_x, at_y = _embedded(x, y, reach, normals=1.0)
    near = [nearest_neighbour(*both).value < 1 for both in ((at_x, at_y), (at_y, at_x))]
    return float(torch.cat(near).float().mean())


@dataclass(frozen=True, eq=False)
class _Sample:
    """Some points of a part, that can be put anywhere."""

    shape: PreprocessedShape
    kept: Int[Tensor, " s"]
    basis: Basis

    @classmethod
    def of(cls, shape: PreprocessedShape, count: int, seed: int) -> _Sample:
        kept = some_points(shape.operators.n_points, count, seed=seed).to(shape.operators.points.device)
        return cls(shape, kept, shape.operators.basis.sampled(kept))

    def at(self, to: Similarity, extractor: FeatureExtractor) -> _Points:
        """These points moved from where they were given, with the features of that pose."""
        points = to(self.shape.points_as_given[self.kept])
        features = normalised(extractor(placed(self.basis, points, to.scale)))
        if self.shape.surface is None:
            return _Points(points, features, None)
        normals = torch.from_numpy(self.shape.surface.vertex_normals).to(points)[self.kept]
        return _Points(points, features, normals @ self.shape.rotation.to(normals) @ to.rotation.T)


def _moved_to(shape: PreprocessedShape, to: Similarity, extractor: FeatureExtractor) -> PreprocessedShape:
    """A shape moved from where it was given, with the features of that pose."""
    operators = placed(shape.operators, to(shape.points_as_given), to.scale)
    return replace(
        shape, operators=operators, features=Preprocessor(extractor=extractor).features(operators, shape=shape.name)
    )


def _motion_between(starts: Float[Tensor, "p 3"], ends: Float[Tensor, "p 3"], *, rigid: bool) -> Similarity:
    """The robust rigid motion that takes points to others, or the similarity transform near it."""
    if len(starts) < _FEWEST_PAIRS:
        return _nothing(starts)
    rotation, shift = rigid_motion(starts, ends)
    if rigid:
        return Similarity(rotation, 1.0, shift)
    missed = (starts @ rotation.T + shift - ends).norm(dim=1)
    return best_similarity(starts, ends, 1 / (1 + (missed / missed.median().clamp(min=1e-6)) ** 2))


def _closest(x: _Points, y: _Points, reach: float, *, rigid: bool) -> Similarity:
    """The motion of y towards x by closest points that are no farther than ``reach``, both ways."""
    at_x, at_y = _embedded(x, y, reach, normals=1.0)
    y_to_x, x_to_y = nearest_neighbour(at_y, at_x), nearest_neighbour(at_x, at_y)
    near_y, near_x = y_to_x.value < 1, x_to_y.value < 1
    starts = torch.cat([y.points[near_y], y.points[x_to_y.index[near_x]]])
    ends = torch.cat([x.points[y_to_x.index[near_y]], x.points[near_x]])
    return _motion_between(starts, ends, rigid=rigid)


def _on_each_other(
    x: PreprocessedShape, y: PreprocessedShape, settings: PartsSettings
) -> tuple[Bool[Tensor, " n"], Bool[Tensor, " m"]]:
    """Which points of either part lie on the other's surface."""
    are_meshes = x.surface is not None and y.surface is not None
    spacings = settings.overlap if are_meshes else settings.overlap_of_clouds
    reach = spacings * max(_spacing(x), _spacing(y))
    return _lies_on(x, y, reach), _lies_on(y, x, reach)


def _lies_on(one: PreprocessedShape, other: PreprocessedShape, reach: float) -> Bool[Tensor, " n"]:
    """Which points of a part are within reach of the other part's surface that faces the same way.

    Points beyond its boundary have a point of the boundary for nearest one.
    """
    points = one.operators.points.double().cpu().numpy()
    surface = SurfaceProjector(Shape(other.operators.points.double().cpu().numpy(), other.repaired.shape.faces))
    normals = None if one.surface is None else one.surface.vertex_normals
    nearest = surface.project(points, normals)
    away = np.linalg.norm(points - surface.positions(nearest), axis=1)
    lies = away < reach
    if other.surface is not None:
        within = nearest.weights > _ON_EDGE
        beyond = ~within.all(axis=1) & (_on_boundary(other.surface)[nearest.corners] | ~within).all(axis=1)
        lies &= ~beyond | (away < _ON_BOUNDARY * reach)
    return torch.from_numpy(lies).to(one.operators.points.device)


def _on_boundary(surface: Surface) -> Bool[np.ndarray, " n"]:
    """Which vertices of a mesh lie on its boundary: those of edges of one triangle alone."""
    edges = np.sort(surface.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    unique, counts = np.unique(edges, axis=0, return_counts=True)
    found = np.zeros(len(surface.vertices), dtype=bool)
    found[unique[counts == 1]] = True
    return found


def _spacing(shape: PreprocessedShape) -> float:
    """The typical distance between neighbouring points: sqrt(area / n)."""
    return float((shape.operators.mass.sum() / shape.operators.n_points).sqrt())


def _nothing(like: Tensor) -> Similarity:
    return Similarity(torch.eye(3), 1.0, torch.zeros(3)).to(like)
