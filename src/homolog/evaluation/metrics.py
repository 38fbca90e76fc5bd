"""Figures that sum up how good a set of point maps is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.integrate import trapezoid
from scipy.sparse.csgraph import connected_components, dijkstra

from homolog.core.errors import DataError
from homolog.geometry import edge_graph, pair_distances, surface_area
from homolog.shapes import Shape, repair

PCK_THRESHOLD = 0.1
"""The correct-points curve runs from zero to this geodesic error, in units of sqrt(area)."""
_CURVE_POINTS = 101
_EXTREMES = 16


def pck_curve(
    errors: Float[np.ndarray, " p"], *, threshold: float = PCK_THRESHOLD
) -> tuple[Float[np.ndarray, " t"], Float[np.ndarray, " t"]]:
    """Share of points with an error of at most each threshold from 0 to ``threshold``: thresholds and shares."""
    thresholds = np.linspace(0.0, threshold, _CURVE_POINTS)
    return thresholds, np.searchsorted(np.sort(errors), thresholds, side="right") / len(errors)


def area_under_pck(errors: Float[np.ndarray, " p"], *, threshold: float = PCK_THRESHOLD) -> float:
    """Area under the correct-points curve, relative to that of a perfect map: between 0 and 1."""
    thresholds, shares = pck_curve(errors, threshold=threshold)
    return float(trapezoid(shares, thresholds) / threshold)


def least_confident_share(
    errors: Float[np.ndarray, " p"], confidences: Float[np.ndarray, " p"], *, fraction: float = 0.2
) -> float:
    """Share of the total error that the least confident ``fraction`` of the points holds; NaN if there is no error."""
    order = np.argsort(confidences, kind="stable")
    least = order[: round(fraction * len(order))]
    total = errors.sum()
    return float(errors[least].sum() / total) if total > 0 else float("nan")


@dataclass(frozen=True)
class Detection:
    """How well something is found, counted in points; add several to pool them.

    Args:
        found: how many points are said to have it.
        true: how many have it.
        both: how many are rightly said to have it.
    """

    found: int
    true: int
    both: int

    @classmethod
    def of(cls, found: Bool[np.ndarray, " p"], true: Bool[np.ndarray, " p"]) -> Detection:
        """Count what is found and what is true of the same points."""
        return cls(int(found.sum()), int(true.sum()), int((found & true).sum()))

    def __add__(self, other: Detection) -> Detection:
        return Detection(self.found + other.found, self.true + other.true, self.both + other.both)

    @property
    def precision(self) -> float | None:
        """Share of the found ones that are true; None if there are none."""
        return self.both / self.found if self.found else None

    @property
    def recall(self) -> float | None:
        """Share of the true ones that are found; None if there are none."""
        return self.both / self.true if self.true else None

    @property
    def f1(self) -> float | None:
        """The harmonic mean of the two; None if nothing is found and nothing is true."""
        return 2 * self.both / (self.found + self.true) if self.found + self.true else None

    @property
    def iou(self) -> float | None:
        """Intersection over union of the found and the true ones; None if there are neither."""
        union = self.found + self.true - self.both
        return self.both / union if union else None

    def to_dict(self) -> dict[str, float | None]:
        """The three figures, and the counts, for JSON."""
        figures = {"precision": self.precision, "recall": self.recall, "f1": self.f1}
        return {**figures, "found": self.found, "true": self.true, "both": self.both}


def geodesic_errors(
    shape: Shape, truth: Int[np.ndarray, " q"], mapped: Int[np.ndarray, " q"]
) -> Float[np.ndarray, " q"]:
    """Distance along a mesh's edges from each true point to the one it was mapped to, in units of sqrt(area).

    The mesh is the repaired one. Between separate pieces, and from points that no face uses, where there is no way
    along the surface, it is the Euclidean one: the least it can be.

    Raises:
        DataError: if the shape has no faces.
        ShapeError: if it cannot be repaired.
    """
    repaired = repair(shape)
    clean = repaired.shape
    if clean.faces is None:
        raise DataError(f"{shape.name} has no faces, but geodesic errors are measured along a surface")
    unit = np.sqrt(surface_area(clean))
    graph = edge_graph(clean.points / unit, clean.faces)
    starts, ends = repaired.clean_index[truth], repaired.clean_index[mapped]
    on_it = (starts >= 0) & (ends >= 0)
    distances = np.full(len(truth), np.inf)
    distances[on_it] = pair_distances(graph, starts[on_it], ends[on_it])
    apart = np.isinf(distances)
    distances[apart] = np.linalg.norm(shape.points[truth[apart]] - shape.points[mapped[apart]], axis=1) / unit
    return distances


def geodesic_diameter(shape: Shape) -> float:
    """The largest distance along a mesh's edges between two of its points, in units of sqrt(area), or a little less.

    Distances are measured from points that lie apart: each is the farthest one from those before it (Gonzalez, 1985).
    Of a mesh in pieces it is the diameter of the one with the most points.

    Raises:
        DataError: if the shape has no faces.
        ShapeError: if it cannot be repaired.
    """
    clean = repair(shape).shape
    if clean.faces is None:
        raise DataError(f"{shape.name} has no faces, but geodesic errors are measured along a surface")
    graph = edge_graph(clean.points / np.sqrt(surface_area(clean)), clean.faces)
    piece = connected_components(graph, directed=False)[1]
    within = piece == np.bincount(piece).argmax()
    start, largest, nearest = int(within.argmax()), 0.0, np.where(within, np.inf, 0.0)
    for _ in range(_EXTREMES):
        distances = np.where(within, dijkstra(graph, indices=start), 0.0)
        nearest = np.minimum(nearest, distances)
        start, largest = int(nearest.argmax()), max(largest, float(distances.max()))
    return largest
