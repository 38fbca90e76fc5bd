"""How good the maps of a match are, as far as they themselves tell."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from functools import partial
from statistics import fmean
from typing import Annotated, Any

from annotated_types import Ge, Le
from jaxtyping import Float, Int
from torch import Tensor

from homolog.core.errors import ArgumentError
from homolog.core.settings import NotNegative
from homolog.maps import coverage, cycle_error, dirichlet_energy, flipped_triangles
from homolog.pairs import SIDES, PreprocessedShape

_Share = Annotated[float, Ge(0), Le(1)]
# Of the edges, which right maps of animals tear: between legs, and at the roots of horns and ears.
_WORST = 0.01


@dataclass(frozen=True)
class Quality:
    """Figures of the map that leaves a shape, and of what the map back makes of that shape; independent of its size.

    Args:
        coverage: share of the shape's area that the map back hits, 0 to 1; see ``homolog.maps.coverage``.
        cycle_error: mean Euclidean distance between a point and where it comes back to, in units of sqrt(area).
        dirichlet_energy: of the map, relative to the identity's: 1 for an isometry, more where it tears.
        flipped_triangles: share of the shape's triangles that the map turns over, 0 to 1; None where either is a cloud.
        confidence: mean confidence, 0 to 1.
        dirichlet_energy_99: the Dirichlet energy without the hundredth of the edges that add most to it: a good map
            may tear a few. None of a match that an earlier version wrote.
    """

    coverage: _Share
    cycle_error: NotNegative
    dirichlet_energy: NotNegative
    flipped_triangles: _Share | None
    confidence: _Share
    dirichlet_energy_99: NotNegative | None = None


MEASURES = tuple(field.name for field in fields(Quality))
"""The names of the figures of quality."""


@dataclass(frozen=True)
class MapQuality:
    """Figures of a match without ground truth, of both sides; None for a shape of which the other is but a part."""

    source: Quality | None
    target: Quality | None

    def __post_init__(self) -> None:
        if self.source is None and self.target is None:
            raise ArgumentError("source and target are both None, but the quality of one of them must be known")

    @property
    def mean(self) -> Quality:
        """Each figure on average over both sides, or of the one that there is."""
        sides = [side for side in (self.source, self.target) if side is not None]
        flips = [side.flipped_triangles for side in sides if side.flipped_triangles is not None]
        energies: list[Any] = [side.dirichlet_energy_99 for side in sides]
        return Quality(
            coverage=fmean(side.coverage for side in sides),
            cycle_error=fmean(side.cycle_error for side in sides),
            dirichlet_energy=fmean(side.dirichlet_energy for side in sides),
            flipped_triangles=fmean(flips) if flips else None,
            confidence=fmean(side.confidence for side in sides),
            dirichlet_energy_99=None if None in energies else fmean(energies),
        )

    def inverse(self) -> MapQuality:
        """The same with source and target exchanged."""
        return MapQuality(self.target, self.source)

    def to_dict(self) -> dict[str, dict[str, float | None] | None]:
        """Figures for JSON, side by side."""
        return asdict(self)

    @classmethod
    def from_dict(cls, figures: Mapping[str, Any]) -> MapQuality:
        """What ``to_dict`` gave."""
        sides = [figures[side] for side in SIDES]
        return cls(*(None if one is None else Quality(**{name: one.get(name) for name in MEASURES}) for one in sides))


def quality(
    shape: PreprocessedShape,
    other: PreprocessedShape,
    there: Int[Tensor, " n"],
    back: Int[Tensor, " n_other"],
    confidences: Float[Tensor, " n"],
) -> Quality:
    """Figures of the map ``there`` from a shape to another, given the map back; both between the clean shapes.

    Args:
        shape: where the map begins.
        other: where it leads to.
        there: for each point of the shape its counterpart; none is missing.
        back: likewise for the other shape.
        confidences: in each entry of ``there``.
    """
    points, x, y = shape.operators.points, shape.surface, other.surface
    flipped = None if x is None or y is None else float(flipped_triangles(x, y, there.cpu().numpy()).mean())
    energy = partial(
        dirichlet_energy, shape.operators, other.operators.points, there, spacing_y=other.operators.mass.sqrt()
    )
    return Quality(
        coverage=coverage(shape.operators, other.operators, back),
        cycle_error=float(cycle_error(points, there, back).mean()),
        dirichlet_energy=energy(),
        flipped_triangles=flipped,
        confidence=float(confidences.mean()),
        dirichlet_energy_99=energy(left_out=_WORST),
    )
