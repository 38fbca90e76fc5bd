"""Making shapes from shapes: noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from homolog.errors import bad_value
from homolog.shapes.shape import Shape


def add_noise(shape: Shape, sigma: float, *, seed: int) -> Shape:
    """Move every point by independent Gaussian noise, the same in all directions.

    Args:
        shape: a mesh or a point cloud; not changed.
        sigma: standard deviation along each axis, in the shape's own units.
        seed: the same seed gives the same noise.

    Raises:
        ArgumentError: if ``sigma`` is negative or not finite.
    """
    if not 0 <= sigma < np.inf:
        raise bad_value("sigma", sigma, "a finite number of at least 0")
    noise = np.random.default_rng(seed).normal(scale=sigma, size=shape.points.shape)
    return replace(shape, points=shape.points + noise)
