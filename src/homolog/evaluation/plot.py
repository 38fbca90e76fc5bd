"""The PCK curve as a picture."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from homolog.core.files import atomic_path, expanded
from homolog.core.plots import check_plot
from homolog.evaluation.metrics import PCK_THRESHOLD, area_under_pck, pck_curve
from homolog.evaluation.result import Evaluation

PckCurve = tuple[ArrayLike, ArrayLike, float]
"""Thresholds, shares of points, and the area under the curve."""


def plot_pck(path: str | Path, evaluations: Mapping[str, Evaluation]) -> None:
    """Draw the share of correct points against the error, a curve for each evaluation.

    Args:
        path: where to, as ``.png``, ``.pdf`` or ``.svg``.
        evaluations: of geodesic errors, by the names that the legend shows.

    Raises:
        ArgumentError: if there is no such format.
        MissingExtraError: if matplotlib is not installed.
    """
    errors = {name: evaluation.errors for name, evaluation in evaluations.items()}
    plot_pck_curves(path, {name: (*pck_curve(each), area_under_pck(each)) for name, each in errors.items()})


def plot_pck_curves(path: str | Path, curves: Mapping[str, PckCurve]) -> None:
    """As ``plot_pck``, of curves that are known: thresholds, shares and the area, by the names of the legend."""
    with _axes(path) as axes:
        for name, (thresholds, shares, area) in curves.items():
            axes.plot(thresholds, 100 * np.asarray(shares), label=f"{name}: {area:.3f}")
        axes.set(xlabel="geodesic error / sqrt(area)", ylabel="correct points (%)")
        axes.set(xlim=(0, PCK_THRESHOLD), ylim=(0, 100))
        axes.legend(loc="lower right", title="area under the curve", fontsize="small")


def plot_errors(path: str | Path, curves: Mapping[str, Mapping[float, float]], *, along: str) -> None:
    """Draw mean errors against something, a curve for each name.

    Args:
        path: as with ``plot_pck``.
        curves: by the names that the legend shows: error by abscissa.
        along: what the abscissas are.

    Raises:
        ArgumentError: if there is no such format.
        MissingExtraError: if matplotlib is not installed.
    """
    with _axes(path) as axes:
        for name, errors in curves.items():
            places = sorted(errors)
            axes.plot(places, [errors[place] for place in places], marker="o", label=name)
        axes.set(xlabel=along, ylabel="mean error x100", ylim=(0, None))
        axes.locator_params(axis="x", nbins=5)  # more would overlap
        axes.legend(fontsize="small")


@contextmanager
def _axes(path: str | Path) -> Iterator[Any]:
    """Axes to draw on; the picture is written when the block ends."""
    check_plot(path)
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5, 4), layout="constrained")
    axes = figure.add_subplot()
    axes.grid(alpha=0.3)
    yield axes
    with atomic_path(path) as temporary:
        figure.savefig(temporary, format=expanded(path).suffix.lower()[1:], dpi=200)
