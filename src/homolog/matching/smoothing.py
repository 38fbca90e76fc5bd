"""Refined point maps without their slides along the surface: shapes are deformed onto each other. New here.

Eigenfunctions of shapes of other proportions do not correspond: refinement that compares them leads even the true map
away. Shapes that are deformed onto each other along the maps, as rigidly as may be, have no such bias.
"""

from __future__ import annotations

from itertools import cycle

import torch

from homolog.geometry.deformation import DeformedTemplate
from homolog.matching.deformable import DeformableShape, Deformation, HeldLandmarks
from homolog.pairs import Pair, PointMaps, PreprocessedShape

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
    held, weight = HeldLandmarks.of(pair), settings.points_mesh if pair.are_meshes else settings.points_cloud
    ways = [
        Deformation(
            one,
            other,
            both=not pair.is_partial,
            held=held,
            template=DeformedTemplate(one.projector, other.projector, rounds=settings.rounds, free_rounds=_FREE_ROUNDS),
        )
        for one, other in both_ways
    ]
    normals = [settings.normals] * settings.deformations
    if held is not None:
        normals[-1] = held.normals(settings.normals)
    found, side = {x: maps.x_to_y, y: maps.y_to_x}, 0
    for way, stiffness, normal in zip(cycle(ways), settings.schedule(), normals):
        there, back = found[way.one], found[way.other]
        found[way.one], found[way.other], side = way.led(
            there, back, weight=weight, stiffness=stiffness, normals=normal, side=side
        )
    return PointMaps(found[x], found[y])


def _rank(shape: PreprocessedShape) -> tuple[int, float]:
    """Which of two shapes is deformed first, whichever is the source: that of fewer points, or of lower frequencies."""
    return shape.operators.n_points, float(shape.operators.eigenvalues.sum())
