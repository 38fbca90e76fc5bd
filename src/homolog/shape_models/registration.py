"""Registration of a template to one shape."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from homolog.core.choices import KeepClutter, Orient, UseProxy
from homolog.core.errors import ShapeError
from homolog.matching import Match, Matcher, map_misfit, orientation_warnings
from homolog.pairs import Mask, PairOptions
from homolog.shapes import Shape, Up, half_edges, repair
from homolog.transfer import SurfaceMap, SurfaceProjector, surface_map, untangled

# A ratio of lengths. Adults are less than three times as large as children, and units differ by ten or more.
_MUCH_LARGER = 5.0
# Each point of a cloud is joined to this many nearest ones in place of edges.
_NEAREST = 6
# The largest ratio of the 95th to the 5th percentile of edge stretches: good maps between bodies have less than 3, maps
# between kinds of shapes that the weights do not know 6 to 10.
_UNEVEN = 5.0
_LEAST_RATIO = 1e-6


@dataclass(frozen=True)
class Figures:
    """Quality of a registration, computed without ground truth; see ``docs/conventions.md``.

    Args:
        confidence: mean of both directions.
        coverage: share of the area that is hit, mean of both shapes.
        cycle_error: mean distance of a point to its image under both maps, in units of sqrt(area), mean of both shapes.
        dirichlet_energy: of the point maps, relative to the identity's, mean of both directions.
        flipped_triangles: share of the template's triangles that are flipped on the shape; None for clouds.
        edges_5: 5th percentile of the stretch of edges (length on the shape over length on the template), over its
            median; for a template without faces, of the distances between each point and its six nearest ones.
        edges_95: the 95th percentile likewise. Both are None in records of earlier versions.
        ambiguous_orientation: whether another way round of the shape leads to another map, and fits nearly as well.
        map_misfit: how much the point maps contradict themselves, see ``homolog.matching.map_misfit``.
        adapted: whether they are those of the network that was adapted to all shapes; None where none was.
    """

    confidence: float
    coverage: float
    cycle_error: float
    dirichlet_energy: float
    flipped_triangles: float | None
    edges_5: float | None
    edges_95: float | None
    ambiguous_orientation: bool = False
    map_misfit: float | None = None
    adapted: bool | None = None

    @property
    def unevenness(self) -> float:
        """The ratio of the 95th to the 5th percentile of edge stretches; 1 if unknown."""
        if self.edges_5 is None or self.edges_95 is None:
            return 1.0
        return self.edges_95 / max(self.edges_5, _LEAST_RATIO)

    def low_confidence_warnings(self) -> tuple[str, ...]:
        """A warning if the points are unevenly spread on the shape, which does not occur in good maps of a mesh.

        For clouds there is none: on clouds of organs the true correspondence is as uneven (5 to 9 on lungs).
        """
        if self.flipped_triangles is None or self.unevenness <= _UNEVEN:
            return ()
        return (
            "the match has low confidence: its points come in clumps and gaps (edges are stretched by "
            f"{self.edges_5:.2g} to {self.edges_95:.2g} times the median, in good maps by 0.5 to 1.5)",
        )


@dataclass(frozen=True, eq=False)
class Registered:
    """The template's points on a shape.

    Args:
        points: one for each template point, on the shape's surface, in its coordinates (n, 3).
        figures: quality of the match.
        warnings: for the user, a line each.
        match: of the template and the shape, which the points were made from; None where they come from elsewhere.
    """

    points: Float[np.ndarray, "n 3"]
    figures: Figures
    warnings: tuple[str, ...]
    match: Match | None = None

    @property
    def matched_by(self) -> str:
        """What found the point maps: a method, and the features that it compares; empty where that is not known."""
        if self.match is None:
            return ""
        features = self.match.report["features"]
        return self.match.method if features is None else f"{self.match.method}, {features['name']}"


class Template:
    """A template that is registered to shapes; it is prepared once.

    Args:
        shape: as it was read.
        matcher: that finds the point maps.
        up: which of its axes points up.
        as_cloud: match without its faces.
        orient: ``"auto"`` finds which way round shapes are, ``"given"`` trusts their coordinates.
        clutter: whether what does not belong to shapes is set apart; the template itself is taken as it is.
        proxy: whether a surface around a mesh is matched in its place; see ``homolog.pairs.PairOptions``.
        adapted: a second matcher; of the maps of both, that is taken which contradicts itself less.
        mask: how much its points count; those with 0 are not matched, and follow the others smoothly.

    Raises:
        ShapeError: if it cannot be used, or repair removes some of its points.

    Examples:
        >>> template = Template(homolog.read_shape("template.ply"), matcher)  # doctest: +SKIP
        >>> template.registered_to(homolog.read_shape("scan.ply")).points  # doctest: +SKIP
    """

    def __init__(
        self,
        shape: Shape,
        matcher: Matcher,
        *,
        up: Up = "y",
        as_cloud: bool = False,
        orient: Orient = "auto",
        clutter: KeepClutter = "remove",
        proxy: UseProxy = "auto",
        adapted: Matcher | None = None,
        mask: Mask | None = None,
    ) -> None:
        check_template(shape)
        self.projector, self.kept = SurfaceProjector(shape), None if mask is None else mask.kept
        self.matchers = (matcher, *(() if adapted is None else (adapted,)))
        self.options = PairOptions(orient=orient, clutter=clutter, proxy=proxy)
        self.prepared = [
            each.preprocess(
                shape, up=up, as_cloud=as_cloud, orient=orient, clutter="keep", proxy=proxy, mask=mask, label="template"
            )
            for each in self.matchers
        ]

    def registered_to(
        self, shape: Shape, *, up: Up = "y", as_cloud: bool = False, strict: bool = False, mask: Mask | None = None
    ) -> Registered:
        """Match a shape, and register the template's surface to it smoothly.

        Args:
            shape: as it was read.
            up: which of its axes points up.
            as_cloud: match without its faces.
            strict: refuse shapes that need repair or would get a warning.
            mask: how much its points count; no template point is registered to those with 0.

        Raises:
            ArgumentError: if the mask is none of this shape.
            ShapeError: if the shape cannot be used, or is refused.
        """
        options = replace(self.options, strict=strict)
        subjects = [
            matcher.preprocess(
                shape,
                up=up,
                as_cloud=as_cloud,
                orient=options.orient,
                clutter=options.clutter,
                proxy=options.proxy,
                strict=strict,
                mask=mask,
                label="shape",
            )
            for matcher in self.matchers
        ]
        target = SurfaceProjector(shape if mask is None else mask.applied_to(shape))
        units = self._unit_warnings(target)
        if strict and units:
            raise ShapeError(f"{shape.name}: {units[0]} (refused as strict)")
        tried = []
        for matcher, template, subject in zip(self.matchers, self.prepared, subjects, strict=True):
            match = matcher.match_pair(matcher.paired(template, subject, options))
            tried.append((map_misfit(match, matcher.settings.choice), match))
        misfit, found = min(tried, key=lambda each: each[0])  # of equal ones the first
        smooth = untangled(surface_map(self.projector, target, found))
        adapted = None if len(tried) < 2 else found is tried[1][1]
        figures = _figures(smooth, found, misfit, adapted=adapted, kept=self.kept)
        uneven = figures.low_confidence_warnings()
        if strict and uneven:
            raise ShapeError(f"{shape.name}: {uneven[0]} (refused as strict)")
        points = smooth.positions
        if self.kept is not None:
            points = np.where(self.kept[:, None], points, smooth.extended)
        return Registered(points, figures, (*units, *_match_warnings(found), *uneven), found)

    def _unit_warnings(self, target: SurfaceProjector) -> tuple[str, ...]:
        """A warning if a shape is so much larger or smaller that its unit seems to differ."""
        ratio = target.unit / self.projector.unit
        if 1 / _MUCH_LARGER < ratio < _MUCH_LARGER:
            return ()
        return (
            f"it is {ratio:.3g} times as large as the template: their units seem to differ; convert one of them, "
            "or it outweighs all others in the mean and modes",
        )


def check_template(shape: Shape) -> None:
    """Refuse a template some of whose points repair removes: they would have no counterpart on any shape.

    Raises:
        ShapeError: naming how many, and what to do.
    """
    left_out = int((repair(shape).clean_index < 0).sum())
    if left_out:
        raise ShapeError(
            f"{shape.name}: points that can have no counterpart, as no face uses them or they are not finite: "
            f"{left_out} (homolog info shows them); remove them, or give another template"
        )


def _match_warnings(found: Match) -> list[str]:
    """The warnings of a match; that of an ambiguous orientation says what to do with a registered shape."""
    of_orientation = orientation_warnings(found)
    told = (
        "which way round the shape is is ambiguous: another rotation leads to another registration, and fits nearly as "
        "well; look at it, or turn the files alike and trust them (orient='given')"
    )
    return [told if warning in of_orientation else warning for warning in found.warnings]


def _figures(
    smooth: SurfaceMap, found: Match, misfit: float, *, adapted: bool | None, kept: Bool[np.ndarray, " n"] | None
) -> Figures:
    assert found.quality is not None
    mean, flipped = found.quality.mean, smooth.flipped_triangles
    if flipped is not None and kept is not None and smooth.source.shape.faces is not None:
        flipped = flipped[kept[smooth.source.repaired.kept][smooth.source.shape.faces].all(axis=1)]
    low, high = _edge_spread(smooth)
    return Figures(
        confidence=mean.confidence,
        coverage=mean.coverage,
        cycle_error=mean.cycle_error,
        dirichlet_energy=mean.dirichlet_energy,
        flipped_triangles=None if flipped is None else float(flipped.mean()),
        edges_5=low,
        edges_95=high,
        ambiguous_orientation=bool(orientation_warnings(found)),
        map_misfit=misfit,
        adapted=adapted,
    )


def _edge_spread(smooth: SurfaceMap) -> tuple[float, float]:
    """The 5th and 95th percentile of edge stretches, relative to the median."""
    shape = smooth.source.shape
    # Of a mesh the sides of all triangles, those between two of them twice.
    edges = _neighbours(shape.points) if shape.faces is None else half_edges(shape.faces)
    registered = smooth.positions[smooth.source.repaired.kept]
    now, before = (
        np.linalg.norm(np.diff(points[edges], axis=1)[:, 0], axis=1) for points in (registered, shape.points)
    )
    known = (before > 0) & np.isfinite(now)
    low, middle, high = np.percentile(now[known] / before[known], [5, 50, 95])
    # Where most points collapsed to a few ones the median is 0, and JSON has no infinity.
    middle = max(middle, _LEAST_RATIO * high, np.finfo(float).tiny)
    return float(low / middle), float(high / middle)


def _neighbours(points: Float[np.ndarray, "n 3"]) -> Int[np.ndarray, "e 2"]:
    """Pairs of each point and its nearest ones, in place of a cloud's edges."""
    count = min(_NEAREST, len(points) - 1)
    near = KDTree(points).query(points, k=count + 1)[1]
    pairs = np.stack([np.repeat(np.arange(len(points)), count + 1), near.ravel()], axis=1)
    return np.asarray(pairs[pairs[:, 0] != pairs[:, 1]])
