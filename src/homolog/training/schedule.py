"""How the learning rate changes from step to step."""

from __future__ import annotations

import math

from homolog.training.settings import OptimiserSettings

# A one-cycle schedule begins at this share of the highest learning rate, and rises for this share of all steps.
_CYCLE_START = 1 / 25
_CYCLE_RISE = 0.3


def learning_rate(settings: OptimiserSettings, step: int, steps: int) -> float:
    """The learning rate of a step, which counts from 0, of so many.

    The one-cycle schedule is that of Smith and Topin, "Super-Convergence", 2018.
    """
    if settings.schedule == "one-cycle":
        rise = settings.warmup_steps or math.ceil(_CYCLE_RISE * steps)
        start, share = _CYCLE_START, _half_cosine((step + 1) / rise)
    else:
        rise = settings.warmup_steps
        start, share = 0.0, (step + 1) / max(rise, 1)
    if step < rise:
        return settings.learning_rate * (start + (1 - start) * share)
    if settings.schedule == "constant":
        return settings.learning_rate
    return settings.learning_rate * _half_cosine(1 - (step - rise) / max(steps - rise, 1))


def _half_cosine(share: float) -> float:
    """Rises from 0 to 1 as ``share`` does, slowly at both ends."""
    return (1 - math.cos(math.pi * share)) / 2
