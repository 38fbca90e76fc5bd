"""Refined point maps without their slides along the surface: shapes are deformed onto each other. New here.

Eigenfunctions of shapes of other proportions do not correspond: refinement that compares them leads even the true map
away. Shapes that are deformed onto each other along the maps, as rigidly as may be, have no such bias.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import cycle

import torch
from jaxtyping import Int
from torch import Tensor

from homolog.geometry.deformation import DeformedTemplate
from homolog.matching.deformable import DeformableShape, HeldLandmarks
from homolog.pairs import Pair, PointMaps, PreprocessedShape, SmoothingSettings

# Of the rounds of a deformation: in so many, point maps alone pull.
_FREE_ROUNDS = 1


@torch.no_grad()
def smoothed(pair: Pair, maps: PointMaps) -> PointMaps:
    """Refined point maps, led by deformations: of full shapes each onto the other in turn, or of a part onto its whole.

    One shape is deformed onto the other along both maps, as rigidly as may be, and drawn to the other's surface; a part
    along its own map. Points of both then go to the nearest one, by place and normal together. The next deformation is
    along these maps, of two full shapes the other way round. Landmarks are held in each, and met by its maps. Maps that
    were not refined are left as they are.

    Args:
        pair: of full shapes, or of a part and its whole; the maps of two parts stay.
        maps: between its repaired shapes.
    """
    settings, refined = pair.settings.smoothing, pair.near_isometric and pair.method.supports.refinement
    if settings is None or pair.settings.refinement is None or pair.are_parts or not refined:
        return maps
    x, y = DeformableShape.of(pair)
    first, second = (y, x) if pair.is_partial or _rank(pair.x) > _rank(pair.y) else (x, y)
    both_ways = [(first, second)] if pair.is_partial else [(first, second), (second, first)]
    held = HeldLandmarks.of(pair)
    ways = [_Way(pair, settings, one, other, held) for one, other in both_ways]
    stiffnesses, normals = settings.schedule(), [settings.normals] * settings.deformations
    if held is not None and held.uncertainties.any():
        normals[-1] = 0.0  # by how much a landmark is missed in the end is a matter of places alone
    found, side = {x: maps.x_to_y, y: maps.y_to_x}, 0
    for way, stiffness, weight in zip(cycle(ways), stiffnesses, normals):
        one, other = way.one, way.other
        found[one], found[other], side = way.led(found[one], found[other], stiffness, weight, side)
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
    held: HeldLandmarks | None

    @cached_property
    def template(self) -> DeformedTemplate:
        ends = self.one.projector, self.other.projector
        return DeformedTemplate(*ends, rounds=self.settings.rounds, free_rounds=_FREE_ROUNDS)

    def led(
        self, there: Int[Tensor, " n"], back: Int[Tensor, " m"], stiffness: float, normals: float, side: int
    ) -> tuple[Int[Tensor, " n"], Int[Tensor, " m"], int]:
        """Both maps once the shape is deformed along them, and the relative orientation, found where it is 0."""
        weight = self.settings.points_mesh if self.pair.are_meshes else self.settings.points_cloud
        one, other, held = self.one, self.other, self.held
        pairs = one.pairs_with(other, there, back, weight=weight, both=not self.pair.is_partial)
        pairs = pairs if held is None else held.among(pairs, one, other)
        side, positions = self.template.solve(pairs, stiffness=stiffness, orientation=side)
        positions = positions if held is None else held.pulled(positions, one, other)
        on_other, of_other = one.beside(other, positions, side=side, normals=normals)
        led, led_back = other.nearest(on_other, of_other), one.nearest(of_other, on_other)
        if held is not None:
            led, led_back = held.met(led, one, other), held.met(led_back, other, one)
        return torch.from_numpy(led).to(there.device), torch.from_numpy(led_back).to(there.device), side
