"""The PCK curve as a picture."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from homolog.core.errors import bad_choice, needs_extra
from homolog.core.files import atomic_path, expanded
from homolog.evaluation.metrics import PCK_THRESHOLD, area_under_pck, pck_curve
from homolog.evaluation.result import Evaluation

_SUFFIXES = (".png", ".pdf", ".svg")


def plot_pck(path: str | Path, evaluations: Mapping[str, Evaluation]) -> None:
    """Draw the share of correct points against the error, a curve for each evaluation.

    Args:
        path: where to, as ``.png``, ``.pdf`` or ``.svg``.
        evaluations: of geodesic errors, by the names that the legend shows.

    Raises:
        ArgumentError: if there is no such format.
        MissingExtraError: if matplotlib is not installed.
    """
    suffix = expanded(path).suffix.lower()
    if suffix not in _SUFFIXES:
        raise bad_choice("--plot", suffix, _SUFFIXES)
    with needs_extra("a plot", "plot"):
        from matplotlib.figure import Figure
    figure = Figure(figsize=(5, 4), layout="constrained")
    axes = figure.add_subplot()
    for name, evaluation in evaluations.items():
        thresholds, shares = pck_curve(evaluation.errors)
        axes.plot(thresholds, 100 * shares, label=f"{name}: {area_under_pck(evaluation.errors):.3f}")
    axes.set(xlabel="geodesic error / sqrt(area)", ylabel="correct points (%)", xlim=(0, PCK_THRESHOLD), ylim=(0, 100))
    axes.legend(loc="lower right", title="area under the curve")
    axes.grid(alpha=0.3)
    with atomic_path(path) as temporary:
        figure.savefig(temporary, format=suffix[1:], dpi=200)
