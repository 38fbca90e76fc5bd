"""Placing a template's points on one shape."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from homolog.errors import ShapeError
from homolog.matching import Correspondence, Matcher
from homolog.shapes import Shape, Up, repair
from homolog.transfer import PlaceFinder, SurfaceMap, surface_map, untangled

# In length. Grown bodies are not three times as large as children's, and units differ by ten or more.
_MUCH_LARGER = 5.0


@dataclass(frozen=True)
class Figures:
    """How good a shape's match to the template is, as far as it itself tells; see ``docs/conventions.md``.

    Args:
        confidence: mean one, of both directions.
        coverage: share of the area that is hit, on average over both shapes.
        there_and_back: mean distance between a point and where it comes back to, in units of sqrt(area), likewise.
        dirichlet_energy: of the point maps, relative to the identity's, likewise.
        flipped_triangles: share of the template's triangles that lie turned over on the shape; None for clouds.
        edges_5: 5th percentile of the edges' lengths on the shape over those of the template, over the median of these.
        edges_95: likewise the 95th; both None for a template without faces.
    """

    confidence: float
    coverage: float
    there_and_back: float
    dirichlet_energy: float
    flipped_triangles: float | None
    edges_5: float | None
    edges_95: float | None


@dataclass(frozen=True, eq=False)
class Placed:
    """The template's points on a shape.

    Args:
        points: in the template's numbering, on the shape's surface, in its coordinates (n, 3).
        figures: how good the match is.
        warnings: what the user should know, a line each.
    """

    points: Float[np.ndarray, "n 3"]
    figures: Figures
    warnings: tuple[str, ...]


class Template:
    """A template, made ready to be matched to many shapes.

    Args:
        shape: as it was read.
        matcher: what matches.
        up: which of its axes points up.
        as_cloud: match without its faces.

    Raises:
        ShapeError: if it cannot be used, or has points that can have no place on another shape.
    """

    def __init__(self, shape: Shape, matcher: Matcher, *, up: Up = "y", as_cloud: bool = False) -> None:
        check_template(shape)
        self.finder = PlaceFinder(shape)
        self.matcher = matcher
        self.prepared = matcher.prepare(shape, up=up, as_cloud=as_cloud, label="template")

    def placed_on(self, shape: Shape, *, up: Up = "y", as_cloud: bool = False, strict: bool = False) -> Placed:
        """Match a shape, and lay the template's points smoothly over its surface.

        Args:
            shape: as it was read.
            up: which of its axes points up.
            as_cloud: match without its faces.
            strict: refuse anything to repair or to warn of.

        Raises:
            ShapeError: if the shape cannot be used, or is refused.
        """
        subject = self.matcher.prepare(shape, up=up, as_cloud=as_cloud, strict=strict, label="shape")
        goal = PlaceFinder(shape)
        units = self._units_that_differ(goal)
        if strict and units:
            raise ShapeError(f"{shape.name}: {units[0]} (refused as strict)")
        found = self.matcher.match_checked(self.prepared, subject, strict=strict)
        smooth = untangled(surface_map(self.finder, goal, found))
        return Placed(smooth.positions, _figures(smooth, found), (*units, *found.warnings))

    def _units_that_differ(self, goal: PlaceFinder) -> tuple[str, ...]:
        """What to tell the user of a shape so much larger or smaller that it would outweigh all others in a model."""
        ratio = goal.unit / self.finder.unit
        if 1 / _MUCH_LARGER < ratio < _MUCH_LARGER:
            return ()
        return (f"it is {ratio:.3g} times as large as the template: their units seem to differ; convert one of them",)


def check_template(shape: Shape) -> None:
    """Refuse a template of which repair leaves points out: they would have a place on no shape.

    Raises:
        ShapeError: naming how many, and what to do.
    """
    left_out = int((repair(shape).clean_index < 0).sum())
    if left_out:
        raise ShapeError(
            f"{shape.name} has {left_out} points that can have no place on another shape, as no face uses them or "
            "they are no numbers (homolog info tells); take them out, or give another template"
        )


def _figures(smooth: SurfaceMap, found: Correspondence) -> Figures:
    assert found.quality is not None
    mean, flipped = found.quality.mean, smooth.flipped_triangles
    low, high = _edge_spread(smooth)
    return Figures(
        confidence=mean.confidence,
        coverage=mean.coverage,
        there_and_back=mean.there_and_back,
        dirichlet_energy=mean.dirichlet_energy,
        flipped_triangles=None if flipped is None else float(flipped.mean()),
        edges_5=low,
        edges_95=high,
    )


def _edge_spread(smooth: SurfaceMap) -> tuple[float | None, float | None]:
    """Percentiles of how much the template's edges are lengthened, relative to the median edge."""
    surface = smooth.start.surface
    if surface is None:
        return None, None
    laid = smooth.positions[smooth.start.repaired.kept]
    now, before = (
        np.linalg.norm(points[surface.faces] - points[np.roll(surface.faces, 1, axis=1)], axis=2)
        for points in (laid, surface.vertices)
    )
    low, middle, high = np.percentile(now / before, [5, 50, 95])
    return float(low / middle), float(high / middle)
