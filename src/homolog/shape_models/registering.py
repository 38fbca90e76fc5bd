"""Placing a template's points on one shape."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree

from homolog.core.errors import ShapeError
from homolog.matching import Match, Matcher
from homolog.pairs import PairOptions
from homolog.shapes import Shape, Up, repair
from homolog.transfer import SurfaceMap, SurfaceProjector, surface_map, untangled

# In length. Grown bodies are not three times as large as children's, and units differ by ten or more.
_MUCH_LARGER = 5.0
# Of a cloud's points: what lies so near stands in for what edges join.
_NEAREST = 6
# How many times as long as others some edges may come out, from 5th to 95th percentile: good maps between bodies stay
# below 3; between kinds of shapes that the weights do not know it is 6 to 10.
_UNEVEN = 5.0
_LEAST_RATIO = 1e-6


@dataclass(frozen=True)
class Figures:
    """How good a shape's match to the template is, as far as it itself tells; see ``docs/conventions.md``.

    Args:
        confidence: mean one, of both directions.
        coverage: share of the area that is hit, on average over both shapes.
        cycle_error: mean distance between a point and where it comes back to, in units of sqrt(area), likewise.
        dirichlet_energy: of the point maps, relative to the identity's, likewise.
        flipped_triangles: share of the template's triangles that lie turned over on the shape; None for clouds.
        edges_5: 5th percentile of the edges' lengths on the shape over those of the template, over the median of these;
            of a template without faces, of the distances between each point and the six nearest to it.
        edges_95: likewise the 95th. Both are None where an earlier version left them out.
    """

    confidence: float
    coverage: float
    cycle_error: float
    dirichlet_energy: float
    flipped_triangles: float | None
    edges_5: float | None
    edges_95: float | None

    @property
    def unevenness(self) -> float:
        """How many times as long as others some edges came out, by the percentiles; 1 if these are not known."""
        if self.edges_5 is None or self.edges_95 is None:
            return 1.0
        return self.edges_95 / max(self.edges_5, _LEAST_RATIO)

    def doubts(self) -> tuple[str, ...]:
        """A warning if points have come to lie in clumps, and far apart elsewhere, as no good map of a mesh lays them.

        Between true places on clouds of organs neighbours are as uneven, 5 to 9 on lungs: there it says nothing.
        """
        if self.flipped_triangles is None or self.unevenness <= _UNEVEN:
            return ()
        return (
            "the match is doubtful: its points come in clumps and gaps (edges are stretched by "
            f"{self.edges_5:.2g} to {self.edges_95:.2g} times the median, of good maps by 0.5 to 1.5)",
        )


@dataclass(frozen=True, eq=False)
class Registered:
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
        self.projector = SurfaceProjector(shape)
        self.matcher = matcher
        self.prepared = matcher.preprocess(shape, up=up, as_cloud=as_cloud, label="template")

    def registered_to(self, shape: Shape, *, up: Up = "y", as_cloud: bool = False, strict: bool = False) -> Registered:
        """Match a shape, and lay the template's points smoothly over its surface.

        Args:
            shape: as it was read.
            up: which of its axes points up.
            as_cloud: match without its faces.
            strict: refuse anything to repair or to warn of.

        Raises:
            ShapeError: if the shape cannot be used, or is refused.
        """
        subject = self.matcher.preprocess(shape, up=up, as_cloud=as_cloud, strict=strict, label="shape")
        goal = SurfaceProjector(shape)
        units = self._units_that_differ(goal)
        if strict and units:
            raise ShapeError(f"{shape.name}: {units[0]} (refused as strict)")
        found = self.matcher.match_pair(self.matcher.paired(self.prepared, subject, PairOptions(strict=strict)))
        smooth = untangled(surface_map(self.projector, goal, found))
        figures = _figures(smooth, found)
        uneven = figures.doubts()
        if strict and uneven:
            raise ShapeError(f"{shape.name}: {uneven[0]} (refused as strict)")
        return Registered(smooth.positions, figures, (*units, *found.warnings, *uneven))

    def _units_that_differ(self, goal: SurfaceProjector) -> tuple[str, ...]:
        """What to tell the user of a shape so much larger or smaller that it would outweigh all others in a model."""
        ratio = goal.unit / self.projector.unit
        if 1 / _MUCH_LARGER < ratio < _MUCH_LARGER:
            return ()
        return (
            f"it is {ratio:.3g} times as large as the template: their units seem to differ; convert one of them, "
            "or it outweighs all others in the mean and modes",
        )


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


def _figures(smooth: SurfaceMap, found: Match) -> Figures:
    assert found.quality is not None
    mean, flipped = found.quality.mean, smooth.flipped_triangles
    low, high = _edge_spread(smooth)
    return Figures(
        confidence=mean.confidence,
        coverage=mean.coverage,
        cycle_error=mean.cycle_error,
        dirichlet_energy=mean.dirichlet_energy,
        flipped_triangles=None if flipped is None else float(flipped.mean()),
        edges_5=low,
        edges_95=high,
    )


def _edge_spread(smooth: SurfaceMap) -> tuple[float, float]:
    """Percentiles of how much the template's edges are lengthened, relative to the median edge."""
    shape = smooth.source.shape
    edges = _neighbours(shape.points) if shape.faces is None else _sides(shape.faces)
    laid = smooth.positions[smooth.source.repaired.kept]
    now, before = (np.linalg.norm(np.diff(points[edges], axis=1)[:, 0], axis=1) for points in (laid, shape.points))
    low, middle, high = np.percentile(now[before > 0] / before[before > 0], [5, 50, 95])
    # Where most points came to lie in a few places the median is nothing, and JSON knows no infinity.
    middle = max(middle, _LEAST_RATIO * high, np.finfo(float).tiny)
    return float(low / middle), float(high / middle)


def _sides(faces: Int[np.ndarray, "m 3"]) -> Int[np.ndarray, "e 2"]:
    """The sides of all triangles, those between two of them twice."""
    return np.stack([faces, np.roll(faces, 1, axis=1)], axis=2).reshape(-1, 2)


def _neighbours(points: Float[np.ndarray, "n 3"]) -> Int[np.ndarray, "e 2"]:
    """Each point with those nearest to it, which stand in for a cloud's edges."""
    count = min(_NEAREST, len(points) - 1)
    near = KDTree(points).query(points, k=count + 1)[1]
    pairs = np.stack([np.repeat(np.arange(len(points)), count + 1), near.ravel()], axis=1)
    return np.asarray(pairs[pairs[:, 0] != pairs[:, 1]])
