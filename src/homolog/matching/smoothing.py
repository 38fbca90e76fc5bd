"""Refined point maps without their slides along the surface: shapes are deformed onto each other. New here.

Eigenfunctions of shapes of other proportions do not correspond: refinement that compares them leads even the true map
away. Shapes that are deformed onto each other along the maps, as rigidly as may be, have no such bias.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import cycle

import numpy as np
import torch
from jaxtyping import Float, Int
from scipy.spatial import KDTree
from torch import Tensor

from homolog.geometry.deformation import DeformedTemplate, WeightedPairs
from homolog.geometry.projection import SurfaceProjector
from homolog.maps import ConfidenceSettings, confidence, neighbourhoods
from homolog.pairs import Pair, PointMaps, PreprocessedShape, SmoothingSettings

# A pair of points that is not trusted at all still counts this much.
_LEAST_CONFIDENCE = 0.01
# Of the rounds of a deformation: in so many, point maps alone pull.
_FREE_ROUNDS = 1


@dataclass(frozen=True, eq=False)
class DeformableShape:
    """A shape that is deformed, or onto which another one is.

    Args:
        shape: preprocessed.
        settings: of the confidence in its maps.
    """

    shape: PreprocessedShape
    settings: ConfidenceSettings

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

    def trust(
        self, other: DeformableShape, there: Int[Tensor, " n"], back: Int[Tensor, " m"]
    ) -> Float[np.ndarray, " n"]:
        """The confidence in each entry of its map to another shape."""
        points = self.shape.operators.points, other.shape.operators.points
        found = confidence(*points, there, back, settings=self.settings, near=self._near)
        return np.asarray(found.cpu().numpy())

    @cached_property
    def _near(self) -> Int[Tensor, "n j"]:
        return neighbourhoods(self.shape.operators.points, self.settings.n_neighbours)

    def pairs_with(
        self,
        other: DeformableShape,
        there: Int[Tensor, " n"],
        back: Int[Tensor, " m"],
        *,
        weight: float,
        both: bool = True,
    ) -> WeightedPairs:
        """The pairs of two point maps by their confidence; each map has a total weight of at most ``weight``.

        Args:
            other: the shape that this one is deformed onto.
            there: for each of its points one of the other's (n,).
            back: the way back (m,).
            weight: of all pairs of a map, where the surface that pulls beside them has one.
            both: those of the way back, too, which a part of the other has for some of its points alone.
        """
        target, to = other.projector.shape.points, there.cpu().numpy()
        found = [(np.arange(len(to)), target[to], self.trust(other, there, back))]
        if both:
            found.append((back.cpu().numpy(), target, other.trust(self, back, there)))
        points, positions, trusts = zip(*found, strict=True)
        weights = [weight * trust.clip(_LEAST_CONFIDENCE) / len(trust) for trust in trusts]
        return WeightedPairs(np.concatenate(points), np.concatenate(positions), np.concatenate(weights))

    def beside(
        self, other: DeformableShape, positions: Float[np.ndarray, "n 3"], *, side: int, normals: float
    ) -> tuple[Float[np.ndarray, "n e"], Float[np.ndarray, "m e"]]:
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
        return np.concatenate(own, axis=1), np.concatenate(others, axis=1)

    def nearest(self, points: Float[np.ndarray, "m e"], own: Float[np.ndarray, "n e"]) -> Int[np.ndarray, " m"]:
        """For each point of another shape the nearest of its own, by embeddings of both."""
        found: np.ndarray = self.main[KDTree(own[self.main]).query(points)[1]]
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
    x, y = (DeformableShape(shape, pair.settings.confidence) for shape in (pair.x, pair.y))
    first, second = (y, x) if pair.is_partial or _rank(pair.x) > _rank(pair.y) else (x, y)
    both_ways = [(first, second)] if pair.is_partial else [(first, second), (second, first)]
    ways = [_Way(pair, settings, one, other) for one, other in both_ways]
    found, side = {x: maps.x_to_y, y: maps.y_to_x}, 0
    for way, stiffness in zip(cycle(ways), settings.schedule()):
        one, other = way.one, way.other
        found[one], found[other], side = way.led(found[one], found[other], stiffness, side)
    return PointMaps(found[x], found[y])


def _rank(shape: PreprocessedShape) -> tuple[int, float]:
    """Which of two shapes is deformed first, whichever is the source: that of fewer points, or of lower frequencies."""
    return shape.operators.n_points, float(shape.operators.eigenvalues.sum())


@dataclass(frozen=True, eq=False)
class _Way:
    """One shape that is deformed onto the other of a pair, again and again."""

    pair: Pair
    settings: SmoothingSettings
    one: DeformableShape
    other: DeformableShape

    @cached_property
    def template(self) -> DeformedTemplate:
        ends = self.one.projector, self.other.projector
        return DeformedTemplate(*ends, rounds=self.settings.rounds, free_rounds=_FREE_ROUNDS)

    def led(
        self, there: Int[Tensor, " n"], back: Int[Tensor, " m"], stiffness: float, side: int
    ) -> tuple[Int[Tensor, " n"], Int[Tensor, " m"], int]:
        """Both maps once the shape is deformed along them, and the relative orientation, found where it is 0."""
        weight = self.settings.points_mesh if self.pair.are_meshes else self.settings.points_cloud
        pairs = self.one.pairs_with(self.other, there, back, weight=weight, both=not self.pair.is_partial)
        side, positions = self.template.solve(pairs, stiffness=stiffness, orientation=side)
        on_other, of_other = self.one.beside(self.other, positions, side=side, normals=self.settings.normals)
        found = self.other.nearest(on_other, of_other), self.one.nearest(of_other, on_other)
        led, led_back = (torch.from_numpy(each).to(there.device) for each in found)
        return led, led_back, side
