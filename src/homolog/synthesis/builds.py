"""Body parameters: sex, age, muscle, weight, height and proportions, sampled by a quasi-random sequence."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

Build = Mapping[str, float]
"""Anny's body parameters, from 0 to 1 each: gender 0 is male, 1 female; age 0 a baby, 1/3 a child, 2/3 young, 1 old."""

PARAMETERS = ("gender", "age", "muscle", "weight", "height", "proportions")

# Quantiles at even steps from 0 to 1, of parameters that are not uniform. Two thirds of the bodies are adults, a third
# babies, children and adolescents; most are clearly male or clearly female; two fifths each are thin and heavy.
_QUANTILES = {
    "age": (0.03, 0.33, 0.6, 0.7, 0.8, 0.9, 1.0),
    "gender": (0.0, 0.05, 0.15, 0.85, 0.95, 1.0),
    "weight": (0.0, 0.12, 0.3, 0.7, 0.93, 1.0),
}


def draw_build(seed: int, index: int) -> dict[str, float]:
    """Sample the parameters of one body of an endless low-discrepancy sequence.

    Multiples of powers of the generalised golden ratio (M. Roberts, "The unreasonable effectiveness of quasirandom
    sequences", 2018), each shifted by a number that depends on the seed.
    """
    dimensions = len(PARAMETERS)
    steps = _golden_ratio(dimensions) ** -np.arange(1.0, dimensions + 1.0)
    shift = np.random.default_rng(seed).random(dimensions)
    shares = dict(zip(PARAMETERS, (shift + (index + 1) * steps) % 1.0, strict=True))
    return {name: round(_quantile(name, float(share)), 6) for name, share in shares.items()}


def _golden_ratio(dimensions: int) -> float:
    """The positive root of x^(d + 1) = x + 1."""
    ratio = 2.0
    for _ in range(64):
        ratio = (1.0 + ratio) ** (1.0 / (dimensions + 1))
    return ratio


def _quantile(name: str, share: float) -> float:
    values = _QUANTILES.get(name, (0.0, 1.0))
    return float(np.interp(share, np.linspace(0.0, 1.0, len(values)), values))


def toward_mean(build: Build, share: float) -> dict[str, float]:
    """Interpolate between the mean build, at 0, and a build, at 1."""
    return {name: round(0.5 + share * (value - 0.5), 6) for name, value in build.items()}
