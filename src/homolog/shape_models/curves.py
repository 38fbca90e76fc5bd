"""Compactness, generalisation and specificity of a shape model, as a table and as a picture."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from homolog.core.errors import needs_extra
from homolog.core.files import atomic_path, write_csv
from homolog.statistics import Curve, Rows, ShapeModel, compactness, generalisation, specificity

_COLUMNS = (
    "modes",
    "variance",
    "deviation",
    "compactness",
    "generalisation",
    "generalisation_error",
    "specificity",
    "specificity_error",
)
# A model of two shapes has one mode, and none once one of them is left out.
_FEWEST_TO_LEAVE_ONE_OUT = 3
_INK = ("#2d6898", "#b4531f", "#3d7a4a")


@dataclass(frozen=True, eq=False)
class Curves:
    """The quality of a model by its number of modes.

    Args:
        model: the model.
        compactness: share of the variance (k,).
        generalisation: leave-one-out distance, without a new alignment; None for two shapes.
        specificity: distance of random shapes from the nearest given one.
    """

    model: ShapeModel
    compactness: Float[np.ndarray, " k"]
    generalisation: Curve | None
    specificity: Curve

    @classmethod
    def of(cls, model: ShapeModel, points: Rows, *, seed: int) -> Curves:
        """The curves of a model and the aligned shapes that it was made of."""
        enough = len(points) >= _FEWEST_TO_LEAVE_ONE_OUT
        left_out = generalisation(points, model) if enough else None
        return cls(model, compactness(model), left_out, specificity(model, points, seed=seed))

    def rows(self) -> list[list[float | int | None]]:
        """A row per number of modes; None beyond the end of a curve."""
        model, left = self.model, self.generalisation
        columns = [model.variances, model.deviations, self.compactness]
        columns += [np.zeros(0)] * 2 if left is None else [left.mean, left.error]
        columns += [self.specificity.mean, self.specificity.error]
        return [
            [count + 1, *(float(column[count]) if count < len(column) else None for column in columns)]
            for count in range(len(model.variances))
        ]

    def write_table(self, path: Path) -> None:
        """Write the rows as CSV with a header."""
        write_csv(path, [_COLUMNS, *self.rows()])

    def write_picture(self, path: Path) -> None:
        """Plot the three curves side by side, with bands of one standard error.

        Raises:
            MissingExtraError: without the extra ``collection``.
        """
        with needs_extra("pictures of curves", "collection"):
            from matplotlib.backends.backend_agg import FigureCanvasAgg
            from matplotlib.figure import Figure
        figure = Figure(figsize=(10.5, 3.2), layout="constrained")
        FigureCanvasAgg(figure)
        panels = figure.subplots(1, 3)
        _draw(panels[0], "Compactness", Curve(100 * self.compactness, np.zeros_like(self.compactness)), 0)
        panels[0].set_ylabel("% of the variance")
        panels[0].set_ylim(0, 102)
        _draw(panels[1], "Generalisation", self.generalisation, 1)
        panels[1].set_ylabel("distance from a shape left out")
        _draw(panels[2], "Specificity", self.specificity, 2)
        panels[2].set_ylabel("distance of random shapes")
        with atomic_path(path) as temporary:
            figure.savefig(temporary, dpi=120, format="png", metadata={"Software": None})


def _draw(panel: Any, title: str, curve: Curve | None, number: int) -> None:
    panel.set_title(title, fontsize=11)
    panel.set_xlabel("modes")
    panel.spines[["top", "right"]].set_visible(False)
    if curve is None:
        panel.text(0.5, 0.5, "needs three shapes", ha="center", va="center", transform=panel.transAxes, color="0.4")
        return
    modes, colour = np.arange(1, len(curve.mean) + 1), _INK[number]
    panel.fill_between(modes, curve.mean - curve.error, curve.mean + curve.error, color=colour, alpha=0.2, linewidth=0)
    panel.plot(modes, curve.mean, color=colour, marker="o" if len(modes) < 30 else "", markersize=3)
    panel.set_ylim(bottom=0)
    panel.set_xlim(left=0, right=len(modes) + 1)
    panel.xaxis.get_major_locator().set_params(integer=True)
