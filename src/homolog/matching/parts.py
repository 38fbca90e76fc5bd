"""Aligning two parts of one shape that overlap, and telling whether they lie on each other as rigid bodies. New here.

Each part alone says where it lies on the upright shape: by the features' orienter. There both are compared. Features
alone place a point to a few hundredths of a body, and say little of where the other part ends. Two scans of a body that
holds still, or two fragments, are one rigid body: that is found by iterated closest points (Besl and McKay, 1992) among
positions, features and normals at once, of which positions count ever more. Only counterparts that lead home count, as
others may belong to what the other part lacks.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import torch
from jaxtyping import Bool, Int
from torch import Tensor

from homolog.features import FeatureExtractor
from homolog.geometry import Surface
from homolog.geometry.projection import SurfaceProjector
from homolog.maps import Similarity, best_similarity, composed, coverage_density
from homolog.matching.placed_points import (
    PartSample,
    PlacedPoints,
    maps_by_closest_points,
    maps_by_features_and_positions,
    motion_by_closest_points,
    motion_by_counterparts,
    no_motion,
    placed_shape,
    spacing_of,
)
from homolog.pairs import Pair, PartsFit, PartsSettings, PointMaps, PreprocessedShape
from homolog.shapes import Shape

# The least barycentric coordinate within a triangle; less is on its edge.
_ON_EDGE = 1e-6
# A point at a boundary lies on the surface that is within this share of what is allowed elsewhere.
_ON_BOUNDARY = 0.1


@torch.no_grad()
def align_two_parts(pair: Pair) -> Pair:
    """A pair of two parts with these aligned with each other.

    They are placed on the upright shape where the features' orienter knows parts, and the target is then moved onto the
    source. Their operators' points are no longer where ``centre`` and ``scale`` put those of the files.
    """
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
    if pair.fit.rigid:
        return maps_by_closest_points(pair.x, pair.y)
    return maps_by_features_and_positions(pair.x, pair.y, pair.settings.parts)


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
    as_given = no_motion(x.operators.points)
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
        x, y = (
            PartSample.of(shape, self.settings.samples, seed) for seed, shape in enumerate((self.pair.x, self.pair.y))
        )
        at_x, found = x.at(start.x, self.extractor), start
        for reach in self.settings.reaches:
            motion, agreeing = motion_by_counterparts(
                at_x, y.at(found.y, self.extractor), reach, self.settings, rigid=start.one_scale
            )
            found = _Found(start.x, composed(motion, found.y), agreeing)
        return found

    def finished(self, found: _Found) -> Pair:
        """The pair with both parts there, moved by closest points where they are rigid, and how well they fit."""
        pair, extractor = self.pair, self.extractor
        x, y = _moved(pair.x, found.x, extractor), _moved(pair.y, found.y, extractor)
        spacing, rigid = spacing_of(x, y), found.one_scale
        motion = motion_by_closest_points(PlacedPoints.of(x), PlacedPoints.of(y), spacing, self.settings, rigid=rigid)
        nearer = _moved(pair.y, composed(motion, found.y), extractor)
        fit = self._fit(x, nearer)
        y = nearer if fit.rigid else y
        alignment = best_similarity(pair.y.points_as_given, found.x.inverse()(y.operators.points))
        return replace(pair, source=x, target=y, alignment=alignment, fit=fit)

    def _fit(self, x: PreprocessedShape, y: PreprocessedShape) -> PartsFit:
        """The shares of both that lie on the other, near where features would have their counterparts."""
        maps = maps_by_features_and_positions(x, y, self.settings)
        at_x, at_y = x.operators.points, y.operators.points
        agree = ((at_x - at_y[maps.x_to_y]).norm(dim=1), (at_y - at_x[maps.y_to_x]).norm(dim=1))
        on = _on_each_other(x, y, self.settings)
        shares = [
            float((lies & (away < self.settings.agreeing)).float().mean()) for lies, away in zip(on, agree, strict=True)
        ]
        return PartsFit(shares[0], shares[1], rigid=min(shares) >= self.settings.least_rigid)


def _moved(shape: PreprocessedShape, to: Similarity, extractor: FeatureExtractor) -> PreprocessedShape:
    """A shape moved from where it was given."""
    return placed_shape(shape, to(shape.points_as_given), to.scale, extractor)


def _on_each_other(
    x: PreprocessedShape, y: PreprocessedShape, settings: PartsSettings
) -> tuple[Bool[Tensor, " n"], Bool[Tensor, " m"]]:
    """Which points of either part lie on the other's surface."""
    are_meshes = x.surface is not None and y.surface is not None
    spacings = settings.overlap if are_meshes else settings.overlap_of_clouds
    reach = spacings * spacing_of(x, y)
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
