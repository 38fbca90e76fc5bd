"""Telling a shape from its mirror image: two files of which one has left and right exchanged. New here."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from homolog.geometry import some_points
from homolog.maps import closest_point_rotations
from homolog.pairs import Pair, PreprocessedShape

_FEW, _MANY = 500, 2000
# Samples of one surface, drawn apart, have about these mean squared distances: twice the square of half a spacing.
_SAME_FEW, _SAME_MANY = 2e-3, 5e-4
# What is a mirror image fits mirrored so much better, in squared distances, than as it is. Symmetric shapes do not.
_CLEARLY_BETTER = 0.25


def mirror_warnings(pair: Pair) -> tuple[str, ...]:
    """Say if two shapes are one and the same, but for a reflection; see ``are_mirror_images``.

    Returns:
        At most one line; none where one of them was reflected.
    """
    if pair.options.mirror is not None or not are_mirror_images(pair):
        return ()
    return ("the source seems to be the mirror image of the target; reflect one of them, by mirror='source'",)


@torch.no_grad()
def are_mirror_images(pair: Pair) -> bool:
    """Whether two shapes are one and the same, but for a reflection; two that are symmetric are not.

    Args:
        pair: two shapes, turned as they are matched; of partial ones it cannot be told.
    """
    if pair.options.partial is not None:
        return False
    x, y = pair.source.operators.points, pair.target.operators.points
    reflected = x * x.new_tensor([-1.0, 1, 1])
    # Upright shapes are reflected in their own plane of symmetry; of others, any rotation may follow.
    starts = torch.eye(3).to(x)[None] if _stands(pair.source) and _stands(pair.target) else None
    rotation, misfit = closest_point_rotations(_samples(reflected, _FEW), _samples(y, _FEW), starts=starts)[0]
    if misfit > _SAME_FEW or (misfit := _misfit(reflected, y, rotation)) > _SAME_MANY:
        return False
    rotation, _ = closest_point_rotations(_samples(x, _FEW), _samples(y, _FEW), starts=starts)[0]
    return misfit <= _CLEARLY_BETTER * _misfit(x, y, rotation)


def _stands(shape: PreprocessedShape) -> bool:
    """Whether a shape stands as its features' orienter would have it: the search may have taken another pose."""
    return any(torch.equal(found.rotation, shape.rotation) for found in shape.orientations)


def _misfit(x: Float[Tensor, "n 3"], y: Float[Tensor, "m 3"], start: Float[Tensor, "3 3"]) -> float:
    found = closest_point_rotations(_samples(x, _MANY), _samples(y, _MANY), starts=start[None], last_steps=8)
    return found[0][1]


def _samples(points: Float[Tensor, "n 3"], count: int) -> Float[Tensor, "s 3"]:
    return points[some_points(len(points), count).to(points.device)]
