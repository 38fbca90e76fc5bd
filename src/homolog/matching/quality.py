"""How good the maps of a match are, as far as they themselves tell."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from statistics import fmean
from typing import Any

from jaxtyping import Float, Int
from torch import Tensor

from homolog.geometry import Surface
from homolog.maps import coverage, cycle_error, dirichlet_energy, flipped_triangles
from homolog.pairs import SIDES, PreprocessedShape


@dataclass(frozen=True)
class Quality:
    """Figures of the map that leaves a shape, and of what the map back makes of that shape; independent of its size.

    Args:
        coverage: share of the shape's area that the map back hits, 0 to 1; see ``homolog.maps.coverage``.
        cycle_error: mean Euclidean distance between a point and where it comes back to, in units of sqrt(area).
        dirichlet_energy: of the map, relative to the identity's: 1 for an isometry, more where it tears.
        flipped_triangles: share of the shape's triangles that the map turns over, 0 to 1; None where either is a cloud.
        confidence: mean confidence, 0 to 1.
    """

    coverage: float
    cycle_error: float
    dirichlet_energy: float
    flipped_triangles: float | None
    confidence: float


MEASURES = tuple(field.name for field in fields(Quality))
"""The names of the figures of quality."""


@dataclass(frozen=True)
class MapQuality:
    """Figures of a match without ground truth, of both sides; None for a shape of which the other is but a part."""

    source: Quality | None
    target: Quality | None

    @property
    def mean(self) -> Quality:
        """Each figure on average over both sides, or of the one that there is."""
        sides = [side for side in (self.source, self.target) if side is not None]
        flips = [side.flipped_triangles for side in sides if side.flipped_triangles is not None]
        return Quality(
            coverage=fmean(side.coverage for side in sides),
            cycle_error=fmean(side.cycle_error for side in sides),
            dirichlet_energy=fmean(side.dirichlet_energy for side in sides),
            flipped_triangles=fmean(flips) if flips else None,
            confidence=fmean(side.confidence for side in sides),
        )

    def inverse(self) -> MapQuality:
        """The same with source and target exchanged."""
        return MapQuality(self.target, self.source)

    def to_dict(self) -> dict[str, dict[str, float | None] | None]:
        """Figures for JSON, side by side."""
        return asdict(self)

    @classmethod
    def from_dict(cls, figures: Mapping[str, Any]) -> MapQuality:
        """What ``to_dict`` gave; anything else is a KeyError, a TypeError or a ValueError."""
        return cls(*(None if figures[side] is None else _quality_of(figures[side]) for side in SIDES))


def _quality_of(figures: Mapping[str, Any]) -> Quality:
    flips = figures["flipped_triangles"]
    numbers = {name: float(figures[name]) for name in MEASURES if name != "flipped_triangles"}
    return Quality(**numbers, flipped_triangles=None if flips is None else float(flips))


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
    points = shape.operators.points
    return Quality(
        coverage=coverage(shape.operators, other.operators, back),
        cycle_error=float(cycle_error(points, there, back).mean()),
        dirichlet_energy=dirichlet_energy(
            shape.operators, other.operators.points, there, spacing_y=other.operators.mass.sqrt()
        ),
        flipped_triangles=_share_flipped(shape, other, there),
        confidence=float(confidences.mean()),
    )


def _share_flipped(shape: PreprocessedShape, other: PreprocessedShape, there: Int[Tensor, " n"]) -> float | None:
    x, y = _surface(shape), _surface(other)
    return None if x is None or y is None else float(flipped_triangles(x, y, there.cpu().numpy()).mean())


def _surface(preprocessed: PreprocessedShape) -> Surface | None:
    faces = preprocessed.repaired.shape.faces
    return None if faces is None else Surface(preprocessed.operators.points.double().cpu().numpy(), faces)
