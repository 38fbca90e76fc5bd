"""Errors of a match against ground truth, and features of its shapes, to be shown as colours."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree

from homolog.core.progress import Timings
from homolog.datasets import Truth
from homolog.evaluation import geodesic_errors
from homolog.matching import Match, Matcher
from homolog.pairs import PairOptions, Side
from homolog.shapes import Shape

# How far, in diagonals of the bounding box, a point takes its error from the nearest point that the truth names.
_REACH = 0.03


def map_errors(result: Match, truth: Truth) -> tuple[dict[Side, Float[np.ndarray, " n"]], str]:
    """The error of each point's match against ground truth, per side, and the unit.

    The error of a source point is measured on the target, and the reverse. Between two meshes it is geodesic, in
    hundredths of the square root of the area of the shape that it is measured on; where a cloud takes part it is
    Euclidean, in hundredths of the diagonal of that shape's bounding box. Points that the truth does not name have the
    error of the nearest one that it does, unless that is far. It is NaN for others, and without a counterpart.

    Args:
        result: the match.
        truth: which point of the source each point of the target truly is.
    """
    found = result
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
    if geodesic:
        apart = geodesic_errors(other, true, found[asked])
    else:
        apart = np.linalg.norm(other.points[true] - other.points[found[asked]], axis=1) / _diagonal(other.points)
    errors = np.full(shape.n_points, np.nan)
    errors[asked] = 100 * apart
    filled = _filled(shape.points, errors)
    filled[found < 0] = np.nan
    return filled


def _filled(points: Float[np.ndarray, "n 3"], values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    known = np.flatnonzero(np.isfinite(values))
    if not len(known):
        return values
    distance, nearest = KDTree(points[known]).query(points)
    return np.where(distance <= _REACH * _diagonal(points), values[known[nearest]], np.nan)


def _diagonal(points: Float[np.ndarray, "n 3"]) -> float:
    return float(np.linalg.norm(np.ptp(points, axis=0)))


def pair_features(
    result: Match, matcher: Matcher, *, timings: Timings | None = None
) -> tuple[Float[np.ndarray, "n_source d"], Float[np.ndarray, "n_target d"]]:
    """The features of a match's shapes, computed with the options in its report; NaN for points that repair left out.

    Raises:
        ArgumentError, ShapeError: as ``Matcher.pair`` does.
    """
    given = result.report.get("options", {})
    options = {field.name: given[field.name] for field in fields(PairOptions) if field.name in given}
    pair, _ = matcher.pair(result.source, result.target, **{**options, "strict": False}, timings=timings)
    source, target = (
        shape.repaired.to_original(shape.needed_features().float().cpu().numpy())
        for shape in (pair.source, pair.target)
    )
    return source, target
