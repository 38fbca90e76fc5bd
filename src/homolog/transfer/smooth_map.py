"""Smooth maps between surfaces: for each point of one shape a point on the other's surface, made from point maps.

A point map leads from vertex to vertex, so that it folds and tears at the size of the triangles. Here the source is
registered non-rigidly to the target along both point maps (``homolog.geometry.deformation``), and then projected onto
the target's surface.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
import torch
from jaxtyping import Bool, Float, Int

from homolog.core.errors import ArgumentError
from homolog.geometry import Surface, unit
from homolog.geometry.deformation import DeformedTemplate, WeightedPairs
from homolog.geometry.projection import SurfacePoints, SurfaceProjector
from homolog.maps import best_similarity
from homolog.matching import Match
from homolog.shapes import Shape, components

_LEAST_CONFIDENCE = 0.01


class SurfaceMap:
    """A map from the points of one shape to the surface of another.

    Args:
        source: the shape that the map leads from.
        target: the shape that the map leads to.
        positions: the deformed position of each source point, in the target's coordinates; it is projected onto the
            target. NaN for a point without a counterpart (n, 3).
        orientation: the relative orientation of the triangles: 1 if both are counter-clockwise seen from the same side,
            -1 if from opposite sides, 0 if unknown.
        extended: where the deformation takes each source point, also those without a counterpart, which follow the
            others smoothly (n, 3); by default ``positions``.
    """

    def __init__(
        self,
        source: SurfaceProjector,
        target: SurfaceProjector,
        positions: Float[np.ndarray, "n 3"],
        *,
        orientation: int = 0,
        extended: Float[np.ndarray, "n 3"] | None = None,
    ) -> None:
        self.source, self.target, self.orientation = source, target, orientation
        self.extended = positions if extended is None else extended
        normals = None
        if orientation:  # those of the deformed source, oriented as the target
            assert source.shape.faces is not None
            drawn = np.where(np.isfinite(positions), positions, self.extended)
            deformed = Surface(np.nan_to_num(drawn[source.repaired.kept]), source.shape.faces)
            normals = source.repaired.to_original(orientation * deformed.vertex_normals, fill=0.0)
        self.surface_points: SurfacePoints = target.project(positions, normals)
        """The image of each source point, in barycentric coordinates of the target."""

    @cached_property
    def positions(self) -> Float[np.ndarray, "n 3"]:
        """The image of each source point, in the target's coordinates; NaN without a counterpart."""
        return self.target.positions(self.surface_points)

    @cached_property
    def flipped_triangles(self) -> Bool[np.ndarray, " m"] | None:
        """Which triangles of the repaired source are flipped on the target; None where either is a cloud.

        A triangle is flipped if its normal points away from the target's normal below it. Where the orientation is
        unknown, the majority of the triangles is taken to be unflipped.
        """
        below = self.target.normals(self.surface_points)
        if below is None or self.source.surface is None:
            return None
        kept, faces = self.source.repaired.kept, self.source.surface.faces
        deformed = Surface(self.positions[kept], faces)
        agreement = np.sign(np.einsum("mk,mk->m", deformed.face_vectors, below[kept][faces].sum(axis=1)))
        return np.asarray(agreement * (self.orientation or np.sign(np.nansum(agreement))) < 0)

    def apply(self, points: SurfacePoints) -> SurfacePoints:
        """Map any points of the source's surface to the target, continuously across its triangles.

        A point is invalid if the corner with the largest weight has no counterpart; of the other corners, those without
        a counterpart are left out of the mean.
        """
        known = self.surface_points.valid[points.corners] & ~np.isnan(points.weights)
        weights = np.where(known, points.weights, 0.0)
        largest = np.nan_to_num(points.weights).argmax(axis=1)
        valid = known[np.arange(len(known)), largest]
        with np.errstate(invalid="ignore"):
            weights = weights / weights.sum(axis=1, keepdims=True)
        kept = SurfacePoints(points.corners, weights).masked(valid)
        normals = None
        if self.orientation and self._normals is not None:
            normals = unit(np.nan_to_num(kept.interpolate(self._normals)))
        return self.target.project(kept.interpolate(self.positions), normals)

    @cached_property
    def _normals(self) -> Float[np.ndarray, "n 3"] | None:
        found = self.target.normals(self.surface_points)
        return None if found is None else np.where(self.surface_points.valid[:, None], found, 0.0)


def surface_map(source: Shape | SurfaceProjector, target: Shape | SurfaceProjector, found: Match) -> SurfaceMap:
    """Turn point maps into a smooth map between surfaces, by non-rigid registration.

    Args:
        source: the shape that the map is to lead from, in any state.
        target: the shape that the map is to lead to.
        found: point maps between the two; ``found.inverse()`` for the other way.

    Returns:
        A point on the target's surface for each source point that ``found`` has a counterpart for.

    Raises:
        ArgumentError: if the point maps are those of other shapes, or no point has a counterpart.
        ShapeError: if a shape cannot be repaired, or is too degenerate for a Laplacian.

    Examples:
        >>> smooth = surface_map(source, target, homolog.match(source, target))  # doctest: +SKIP
        >>> smooth.positions  # of each source point, on the target's surface  # doctest: +SKIP
    """
    ends = [shape if isinstance(shape, SurfaceProjector) else SurfaceProjector(shape) for shape in (source, target)]
    source, target = ends
    template, pairs = DeformedTemplate(source, target), _weighted_pairs(source, target, found)
    orientation, deformed = template.solve(pairs)
    whole = _with_loose_components(template, deformed, held=pairs.held(template.count))
    extended = source.repaired.to_original(whole, fill=np.nan)
    positions = np.where((found.source_to_target >= 0)[:, None], extended, np.nan)
    return SurfaceMap(source, target, positions, orientation=orientation, extended=extended)


def _with_loose_components(
    template: DeformedTemplate, positions: Float[np.ndarray, "n 3"], *, held: Bool[np.ndarray, " n"]
) -> Float[np.ndarray, "n 3"]:
    """The positions, with components that no pair holds moved as one body with the points that have pairs."""
    component = components(template.ends[0], template.ends[1], template.count)
    loose = ~np.isin(component, component[held])
    if not loose.any():
        return positions
    rest, now = (torch.tensor(each) for each in (template.source.shape.points, positions))
    return np.where(loose[:, None], best_similarity(rest[held], now[held])(rest).numpy(), positions)


def _weighted_pairs(source: SurfaceProjector, target: SurfaceProjector, found: Match) -> WeightedPairs:
    """The pairs of both directions, weighted by confidence; each direction has a total weight of at most one."""
    for projector, indices, other in (
        (source, found.source_to_target, target),
        (target, found.target_to_source, source),
    ):
        if len(indices) != projector.given.n_points or indices.max(initial=-1) >= other.given.n_points:
            raise ArgumentError(
                f"the point maps are not those of {projector.given.name}; give the shapes that were matched"
            )
    forward = _between_repaired(source, target, found.source_to_target)
    backward = _between_repaired(target, source, found.target_to_source)
    (leave,), (arrive,) = np.nonzero(forward >= 0), np.nonzero(backward >= 0)
    if not len(leave) + len(arrive):
        raise ArgumentError(f"no point of {source.given.name} has a counterpart, so that nothing can be transferred")
    confidences = (found.source_confidence[source.repaired.kept], found.target_confidence[target.repaired.kept])
    forward_weights, backward_weights = (each.clip(_LEAST_CONFIDENCE) / len(each) for each in confidences)
    return WeightedPairs(
        np.concatenate([leave, backward[arrive]]),
        target.shape.points[np.concatenate([forward[leave], arrive])],
        np.concatenate([forward_weights[leave], backward_weights[arrive]]),
    )


def _between_repaired(
    source: SurfaceProjector, target: SurfaceProjector, indices: Int[np.ndarray, " n"]
) -> Int[np.ndarray, " k"]:
    """A point map between the shapes as given, as a point map between the repaired shapes."""
    given = indices[source.repaired.kept]
    return np.asarray(np.where(given >= 0, target.repaired.clean_index[given], -1))
