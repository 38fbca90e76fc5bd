"""Who a body is: sex, age, muscle, weight, height and proportions, spread evenly over all there are."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

Build = Mapping[str, float]
"""Anny's body parameters, from 0 to 1 each: gender 0 is male, 1 female; age 0 a baby, 1/3 a child, 2/3 young, 1 old."""

PARAMETERS = ("gender", "age", "muscle", "weight", "height", "proportions")

# Quantiles at even steps from 0 to 1, of what is not spread evenly. Two thirds of the bodies are adults, a third
# babies, children and adolescents; most are clearly male or clearly female; two fifths each are thin and heavy.
_QUANTILES = {
    "age": (0.03, 0.33, 0.6, 0.7, 0.8, 0.9, 1.0),
    "gender": (0.0, 0.05, 0.15, 0.85, 0.95, 1.0),
    "weight": (0.0, 0.12, 0.3, 0.7, 0.93, 1.0),
}


def draw_build(seed: int, index: int) -> dict[str, float]:
    """Draw the parameters of one body of an endless sequence that covers them evenly from the start.

    Multiples of powers of the generalised golden ratio (M. Roberts, "The unreasonable effectiveness of quasirandom
    sequences", 2018), each shifted by a number that depends on the seed.
    """
    dimensions = len(PARAMETERS)
    steps = _golden_ratio(dimensions) ** -np.arange(1.0, dimensions + 1.0)
    shift = np.random.default_rng(seed).random(dimensions)
    drawn = dict(zip(PARAMETERS, (shift + (index + 1) * steps) % 1.0, strict=True))
    return {name: round(_quantile(float(share), _QUANTILES.get(name, (0.0, 1.0))), 6) for name, share in drawn.items()}


def _golden_ratio(dimensions: int) -> float:
    """The positive root of x^(d + 1) = x + 1."""
    ratio = 2.0
    for _ in range(64):
        ratio = (1.0 + ratio) ** (1.0 / (dimensions + 1))
    return ratio


def _quantile(share: float, values: tuple[float, ...]) -> float:
    return float(np.interp(share, np.linspace(0.0, 1.0, len(values)), values))


def nearer_the_mean(build: Build, share: float) -> dict[str, float]:
    """A build between the mean one, at 0, and itself, at 1."""
    return {name: round(0.5 + share * (value - 0.5), 6) for name, value in build.items()}
