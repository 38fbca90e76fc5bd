"""Which way round a synthetic shape stands."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from homolog.core.choices import Turn

_DIGITS = 3


def drawn_turn(turn: Turn, generator: np.random.Generator) -> list[float]:
    """Draw a rotation, as its axis times its angle in degrees, with three digits.

    Args:
        turn: "none", about the "vertical" axis (y), or "any" rotation, all of them as likely.
        generator: of random numbers.

    Examples:
        >>> drawn_turn("none", np.random.default_rng(0))
        [0.0, 0.0, 0.0]
    """
    if turn == "none":
        return [0.0, 0.0, 0.0]
    if turn == "vertical":
        return [0.0, round(float(generator.uniform(-180.0, 180.0)), _DIGITS), 0.0]
    vector = Rotation.from_quat(generator.normal(size=4)).as_rotvec(degrees=True)
    return [float(value) for value in vector.round(_DIGITS)]


def turned(points: Float[np.ndarray, "n 3"], turn: Sequence[float]) -> Float[np.ndarray, "n 3"]:
    """Points after a rotation about the origin, given as its axis times its angle in degrees.

    Examples:
        >>> turned(np.array([[1.0, 0.0, 0.0]]), [0.0, 0.0, 90.0]).round(6) + 0.0
        array([[0., 1., 0.]])
    """
    return np.asarray(Rotation.from_rotvec(turn, degrees=True).apply(points))
