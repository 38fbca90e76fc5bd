"""Making shapes from shapes: noise, and samples."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int

from homolog.core.errors import bad_value
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


def farthest_points(points: Float[np.ndarray, "n 3"], count: int, *, seed: int) -> Int[np.ndarray, " count"]:
    """Indices of evenly spread points, in ascending order: each is the farthest from those chosen before.

    Gonzalez, "Clustering to minimize the maximum intercluster distance", 1985. Costs ``count * n`` distances.

    Args:
        points: to choose from.
        count: how many; at least 1 and at most n.
        seed: of the first point, which is drawn at random.

    Raises:
        ArgumentError: if there are not so many points.
    """
    if not 1 <= count <= len(points):
        raise bad_value("count", count, f"from 1 to the number of points, {len(points)}")
    chosen = np.empty(count, dtype=np.int64)
    chosen[0] = np.random.default_rng(seed).integers(len(points))
    distance = np.full(len(points), np.inf)
    axes = np.ascontiguousarray(points.T)
    for i in range(1, count):
        distance[chosen[i - 1]] = -1  # not even another point in the same place brings it back
        x, y, z = axes - axes[:, chosen[i - 1], None]
        np.minimum(distance, x * x + y * y + z * z, out=distance)
        chosen[i] = distance.argmax()
    return np.sort(chosen)
