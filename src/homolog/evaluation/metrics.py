"""Figures that sum up how good a set of point maps is."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.integrate import trapezoid

# The correct-points curve runs from zero to this geodesic error, in units of sqrt(area).
PCK_THRESHOLD = 0.1
_CURVE_POINTS = 101


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
