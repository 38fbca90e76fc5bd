"""Creases at joints: where a skin that follows two bones folds into itself, it is smoothed until it does not."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool

from homolog.geometry.surface import Surface
from homolog.synthesis.remeshing import neighbours_middle
from homolog.synthesis.self_intersections import self_intersecting_faces

_ROUNDS, _STEPS, _STEP = 6, 4, 0.5


def without_creases(surface: Surface, movable: Bool[np.ndarray, " n"]) -> Surface:
    """Smooth a closed surface where it passes through itself, and one triangle around.

    Args:
        surface: the skin.
        movable: which vertices may move; what they do not reach, as a finger in the palm, stays as it is.
    """
    for _ in range(_ROUNDS):
        crossing = self_intersecting_faces(surface)
        near = np.isin(surface.faces, surface.faces[crossing]).any(axis=1)
        moves = np.zeros(len(surface.vertices), dtype=bool)
        moves[surface.faces[near]] = True
        moves &= movable
        if not moves.any():
            break
        for _ in range(_STEPS):
            steps = _STEP * (neighbours_middle(surface) - surface.vertices)
            surface = Surface(surface.vertices + moves[:, None] * steps, surface.faces)
    return surface
