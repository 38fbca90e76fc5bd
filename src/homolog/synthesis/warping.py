"""Smooth random warps of space, which stretch a shape unevenly and fold nothing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

# Waves of each velocity field.
_WAVES = 64
# Of each field: how far it reaches, and its standard deviation, in units of the size of the shape.
_FIELDS = ((0.6, 0.08), (0.25, 0.025))
# The standard deviation of the logarithm of the stretch along each of three axes.
_STRETCH = 0.12
# Steps in which points flow.
_STEPS = 8


@dataclass(frozen=True, eq=False)
class Warp:
    """A stretch along three axes, and a flow along a smooth velocity field that stays the same.

    The flow of a smooth field has a smooth inverse (V. Arsigny et al., "A Log-Euclidean framework for statistics on
    diffeomorphisms", MICCAI 2006), so that nothing passes through itself. The field is a Gaussian process, by random
    Fourier features (A. Rahimi and B. Recht, "Random features for large-scale kernel machines", NIPS 2007).

    Args:
        axes: of the stretch, in columns.
        logarithms: of the stretch along each of them.
        waves: wave vectors.
        phases: of each wave.
        amounts: velocity that each wave adds.

    Examples:
        >>> rng = np.random.default_rng(0)
        >>> points = rng.normal(size=(100, 3))
        >>> warp = Warp.drawn(2.0, rng)
        >>> bool(np.abs(warp(points, 0.0) - points).max() < 1e-12)
        True
        >>> bool(np.linalg.norm(warp(points) - points, axis=1).mean() > 0.1)
        True
    """

    axes: Float[np.ndarray, "3 3"]
    logarithms: Float[np.ndarray, " 3"]
    waves: Float[np.ndarray, "w 3"]
    phases: Float[np.ndarray, " w"]
    amounts: Float[np.ndarray, "w 3"]

    @classmethod
    def drawn(cls, size: float, generator: np.random.Generator) -> Warp:
        """Draw a warp for shapes of a size, such as the square root of their area."""
        axes = Rotation.from_quat(generator.normal(size=4)).as_matrix()
        logarithms = generator.normal(0, _STRETCH, 3)
        count = len(_FIELDS) * _WAVES
        reach, deviation = np.repeat(np.array(_FIELDS) * size, _WAVES, axis=0).T[:, :, None]
        waves = generator.normal(size=(count, 3)) / reach
        phases = generator.uniform(0, 2 * np.pi, count)
        amounts = generator.normal(size=(count, 3)) * deviation * np.sqrt(2 / _WAVES)
        return cls(axes, logarithms, waves, phases, amounts)

    def __call__(self, points: Float[np.ndarray, "n 3"], strength: float = 1.0) -> Float[np.ndarray, "n 3"]:
        """Where points go; at strength 0 they stay."""
        stretch = self.axes * np.exp(strength * self.logarithms) @ self.axes.T
        moved = points @ stretch
        for _ in range(_STEPS):
            moved = moved + strength / _STEPS * (np.cos(moved @ self.waves.T + self.phases) @ self.amounts)
        return np.asarray(moved)
