"""How much a map contradicts itself. New here."""

from __future__ import annotations

import math

from homolog.core.errors import ArgumentError
from homolog.matching.quality import Quality
from homolog.matching.result import Match
from homolog.pairs import ChoiceSettings

# The energy of an isometry is 1; of a map to one point it is 0.
_LEAST_ENERGY = 0.1


def map_misfit(match: Match, settings: ChoiceSettings | None = None) -> float:
    """How much a map contradicts itself: where it tears or turns over, and its cycle error.

    A smooth map tears nowhere, and may be wrong all the same: where it is, triangles are turned over.

    Args:
        match: with figures of quality.
        settings: what these count.

    Raises:
        ArgumentError: if the match has no figures of quality, as one that was read from another program's file.

    Examples:
        >>> import homolog
        >>> from homolog.matching import map_misfit
        >>> source, target = homolog.demo_shapes()
        >>> right = homolog.match(source, target, weights="people")
        >>> wrong = homolog.match(source, target, method="registration")  # which is for shapes in one pose
        >>> map_misfit(right) < map_misfit(wrong)
        True
    """
    if match.quality is None:
        raise ArgumentError("the match has no figures of quality; give one of homolog.match or Matcher")
    settings = settings or ChoiceSettings()
    return quality_misfit(match.quality.mean, cycle=settings.cycle, flipped=settings.flipped)


def quality_misfit(figures: Quality, *, cycle: float, flipped: float, torn: float = 1.0) -> float:
    """The same of figures of quality, by the weights of the cycle error, of flipped triangles, and of tearing."""
    energy = max(figures.dirichlet_energy, _LEAST_ENERGY)
    return torn * math.log(energy) + cycle * figures.cycle_error + flipped * (figures.flipped_triangles or 0)
