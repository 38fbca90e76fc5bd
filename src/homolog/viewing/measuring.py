"""What is computed of a result for its view: errors of its maps, and features of its shapes."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree

from homolog.core.progress import Timings
from homolog.datasets import Truth
from homolog.evaluation import geodesic_errors
from homolog.matching import Matcher, MatchResult, Side
from homolog.shapes import Shape
from homolog.viewing.scene import SIDES

# How far, in diagonals of the bounding box, a point takes its error from the nearest point that the truth names.
_REACH = 0.03


def map_errors(result: MatchResult, truth: Truth) -> tuple[dict[Side, Float[np.ndarray, " n"]], str]:
    """The error of each point's match, and the unit: that of the source's points on the target, and the reverse.

    Between two meshes it is geodesic, in hundredths of the square root of the area of the shape that it is measured on;
    where a cloud takes part it is straight, in hundredths of the diagonal of that shape's bounding box. Points that the
    truth does not name have the error of the nearest one that it does, unless that is far; NaN is the error of those
    without, and of points without a counterpart.

    Args:
        result: the match.
        truth: which point of the source each point of the target truly is.
    """
    found = result.found
    geodesic = result.source.faces is not None and result.target.faces is not None
    sides: dict[Side, np.ndarray] = {
        "source": _errors(
            result.source, result.target, (truth.source, truth.target), found.source_to_target, geodesic=geodesic
        ),
        "target": _errors(
            result.target, result.source, (truth.target, truth.source), found.target_to_source, geodesic=geodesic
        ),
    }
    return sides, "% of \N{SQUARE ROOT}area" if geodesic else "% of the diagonal"


def _errors(
    shape: Shape,
    other: Shape,
    truth: tuple[Int[np.ndarray, " q"], Int[np.ndarray, " q"]],
    found: Int[np.ndarray, " n"],
    *,
    geodesic: bool,
) -> Float[np.ndarray, " n"]:
    """Per point of ``shape``: how far on ``other`` it is matched from where it truly is."""
    matched = found[truth[0]] >= 0
    asked, true = truth[0][matched], truth[1][matched]
    measure = geodesic_errors if geodesic else _straight_errors
    errors = np.full(shape.n_points, np.nan)
    errors[asked] = 100 * measure(other, true, found[asked])
    filled = _filled(shape.points, errors)
    filled[found < 0] = np.nan
    return filled


def _straight_errors(
    shape: Shape, truth: Int[np.ndarray, " q"], mapped: Int[np.ndarray, " q"]
) -> Float[np.ndarray, " q"]:
    distances: np.ndarray = np.linalg.norm(shape.points[truth] - shape.points[mapped], axis=1) / _diagonal(shape.points)
    return distances


def _filled(points: Float[np.ndarray, "n 3"], values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    known = np.flatnonzero(np.isfinite(values))
    if not len(known):
        return values
    distance, nearest = KDTree(points[known]).query(points)
    return np.where(distance <= _REACH * _diagonal(points), values[known[nearest]], np.nan)


def _diagonal(points: Float[np.ndarray, "n 3"]) -> float:
    return float(np.linalg.norm(np.ptp(points, axis=0)))


def pair_features(
    result: MatchResult, matcher: Matcher, *, timings: Timings | None = None
) -> tuple[Float[np.ndarray, "n_source d"], Float[np.ndarray, "n_target d"]]:
    """The features of a result's shapes, prepared as the report says that they were; NaN for points left out.

    Raises:
        ArgumentError, ShapeError: as ``Matcher.prepare_pair`` does.
    """
    options = _options(result.report)
    ups = options.pop("up")
    pair = matcher.prepare_pair(
        result.source, result.target, **options, source_up=ups["source"], target_up=ups["target"], timings=timings
    )
    source, target = (side.repaired.to_original(side.features.float().cpu().numpy()) for side in pair)
    return source, target


def _options(report: dict[str, Any]) -> dict[str, Any]:
    """How the shapes were prepared for their match; a match without options was made with the usual ones."""
    given = report.get("options", {})
    usual = {
        "as_cloud": None,
        "partial": None,
        "partial_scale": 1.0,
        "pre_aligned": False,
        "up": dict.fromkeys(SIDES, "y"),
    }
    return {name: given.get(name, value) for name, value in usual.items()}
