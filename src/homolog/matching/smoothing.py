"""Refined point maps without their slides along the surface: shapes are deformed onto each other. New here.

Eigenfunctions of shapes of other proportions do not correspond: refinement that compares them leads even the true map
away. Shapes that are deformed onto each other along the maps, as rigidly as may be, have no such bias.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import cycle, islice

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from homolog.geometry.deformation import DeformedTemplate, WeightedPairs
from homolog.geometry.projection import SurfaceProjector
from homolog.maps import ConfidenceSettings, confidence, nearest_neighbour
from homolog.pairs import Pair, PointMaps, PreprocessedShape, SmoothingSettings

# A pair of points that is not trusted at all still counts this much.
_LEAST_CONFIDENCE = 0.01


@dataclass(frozen=True, eq=False)
class DeformableShape:
    """A shape that is deformed, or onto which another one is.

    Args:
        shape: preprocessed.
    """

    shape: PreprocessedShape

    @cached_property
    def projector(self) -> SurfaceProjector:
        """Its repaired points and surface."""
        return SurfaceProjector(self.shape.repaired.shape)

    @cached_property
    def main(self) -> Int[np.ndarray, " m"]:
        """The points that others are mapped to."""
        return np.flatnonzero(self.shape.operators.in_main_component.cpu().numpy())

    @cached_property
    def normals(self) -> Float[np.ndarray, "n 3"] | None:
        """Of the points of a mesh."""
        surface = self.projector.surface
        return None if surface is None else surface.vertex_normals

    def pairs_with(
        self,
        other: DeformableShape,
        there: Int[Tensor, " n"],
        back: Int[Tensor, " m"],
        *,
        settings: ConfidenceSettings,
        weight: float,
        both: bool = True,
    ) -> WeightedPairs:
        """The pairs of two point maps by their confidence; each map has a total weight of at most ``weight``.

        Args:
            other: the shape that this one is deformed onto.
            there: for each of its points one of the other's (n,).
            back: the way back (m,).
            settings: of the confidence.
            weight: of all pairs of a map, where the surface that pulls beside them has one.
            both: those of the way back, too, which a part of the other has for some of its points alone.
        """
        own, others = self.shape.operators.points, other.shape.operators.points
        target, to = other.projector.shape.points, there.cpu().numpy()
        found = [(np.arange(len(to)), target[to], confidence(own, others, there, back, settings=settings))]
        if both:
            found.append((back.cpu().numpy(), target, confidence(others, own, back, there, settings=settings)))
        points, positions, trusts = zip(*found, strict=True)
        weights = [weight * trust.cpu().numpy().clip(_LEAST_CONFIDENCE) / len(trust) for trust in trusts]
        return WeightedPairs(np.concatenate(points), np.concatenate(positions), np.concatenate(weights))

    def beside(
        self, other: DeformableShape, positions: Float[np.ndarray, "n 3"], *, side: int, normals: float
    ) -> tuple[Float[Tensor, "n e"], Float[Tensor, "m e"]]:
        """Its points where they lie on the other, and those of the other, as embeddings by place and normal.

        Args:
            other: the shape that it was deformed onto.
            positions: where its points then lie, in the other's coordinates (n, 3).
            side: the relative orientation of both meshes; 0 where it is unknown, so that places alone are compared.
            normals: distance, in units of sqrt(area), that weighs as much as a difference of one in unit normals.
        """
        target, unit = other.projector.shape.points, other.shape.operators.scale
        middle = target.mean(axis=0)
        own, others = [(positions - middle) / unit], [(target - middle) / unit]
        if side and normals and self.projector.surface is not None and other.normals is not None:
            own.append(normals * side * replace(self.projector.surface, vertices=positions).vertex_normals)
            others.append(normals * other.normals)
        like = other.shape.operators.points
        deformed, rest = (torch.from_numpy(np.concatenate(parts, axis=1)).to(like) for parts in (own, others))
        return deformed, rest

    def nearest(self, points: Float[Tensor, "m e"], own: Float[Tensor, "n e"]) -> Int[np.ndarray, " m"]:
        """For each point of another shape the nearest of its own, by embeddings of both."""
        found: np.ndarray = self.main[nearest_neighbour(points, own[torch.from_numpy(self.main)]).index.cpu().numpy()]
        return found


@torch.no_grad()
def smoothed(pair: Pair, maps: PointMaps) -> PointMaps:
    """Refined point maps, led by deformations: of full shapes each onto the other in turn, or of a part onto its whole.

    One shape is deformed onto the other along both maps, as rigidly as may be, and drawn to the other's surface; a part
    along its own map. Points of both then go to the nearest one, by place and normal together. The next deformation is
    along these maps, of two full shapes the other way round. Maps that were not refined are left as they are, and so
    are those with landmarks, which have a deformation of their own.

    Args:
        pair: of full shapes, or of a part and its whole; the maps of two parts stay.
        maps: between its repaired shapes.
    """
    settings, refined = pair.settings.smoothing, pair.near_isometric and pair.method.supports.refinement
    is_apart = pair.are_parts or pair.guidance is not None
    if settings is None or pair.settings.refinement is None or is_apart or not refined:
        return maps
    x, y = DeformableShape(pair.x), DeformableShape(pair.y)
    first, second = (y, x) if pair.is_partial or _rank(pair.x) > _rank(pair.y) else (x, y)
    ways = [(first, second)] if pair.is_partial else [(first, second), (second, first)]
    templates = [
        DeformedTemplate(one.projector, other.projector, stiffness=settings.stiffness, rounds=settings.rounds)
        for one, other in ways
    ]
    found = {x: maps.x_to_y, y: maps.y_to_x}
    for (one, other), template in islice(cycle(zip(ways, templates, strict=True)), settings.deformations):
        found[one], found[other] = _led(pair, settings, template, one, other, found[one], found[other])
    return PointMaps(found[x], found[y])


def _rank(shape: PreprocessedShape) -> tuple[int, float]:
    """Which of two shapes is deformed first, whichever is the source: that of fewer points, or of lower frequencies."""
    return shape.operators.n_points, float(shape.operators.eigenvalues.sum())


def _led(
    pair: Pair,
    settings: SmoothingSettings,
    template: DeformedTemplate,
    one: DeformableShape,
    other: DeformableShape,
    there: Int[Tensor, " n"],
    back: Int[Tensor, " m"],
) -> tuple[Int[Tensor, " n"], Int[Tensor, " m"]]:
    """Both maps once one shape is deformed onto the other along them."""
    weight = settings.points_mesh if pair.are_meshes else settings.points_cloud
    confidences, both = pair.settings.confidence, not pair.is_partial
    pairs = one.pairs_with(other, there, back, settings=confidences, weight=weight, both=both)
    side, positions = template.solve(pairs)
    on_other, of_other = one.beside(other, positions, side=side, normals=settings.normals)
    found = other.nearest(on_other, of_other), one.nearest(of_other, on_other)
    led, led_back = (torch.from_numpy(each).to(there.device) for each in found)
    return led, led_back
