"""The registered shapes of a shape model as arrays: aligned points and their principal modes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int, UInt8
from scipy.stats import rankdata

from homolog.core.files import write_npy_rows
from homolog.core.settings import CountOrZero, Settings
from homolog.matching import position_colours
from homolog.shape_models.folder import MASK, Outcome, ShapeModelFolder
from homolog.shapes import Shape, Up, drawable, stand_upright
from homolog.statistics import Aligned, FileRows, ShapeModel, generalised_procrustes, principal_modes

MOST_MODES = 100
"""The number of modes of a model of more than 200 shapes; of fewer it has all."""
_FEW = 200


@dataclass(frozen=True)
class ModelSettings(Settings):
    """Settings of the statistics.

    Args:
        scale: normalise the size of the shapes in the Procrustes alignment.
        seed: of the random shapes that measure specificity.
        template_up: the axis of the template, and so of the mean, that points up.
        shapes_up: the axis of the shapes that points up.
    """

    scale: bool = False
    seed: CountOrZero = 0
    template_up: Up = "y"
    shapes_up: Up = "y"


class RegisteredShapes:
    """All that the files of a shape model are made of.

    Args:
        folder: of the registered shapes.
        template: as it was read.
        outcomes: of all shapes, registered or not.
        settings: of the statistics.
        weights: how much the template's points count, 0 for those that take no part; by default all alike (n,).
    """

    def __init__(
        self,
        folder: ShapeModelFolder,
        template: Shape,
        outcomes: Sequence[Outcome],
        settings: ModelSettings,
        weights: Float[np.ndarray, " n"] | None = None,
    ) -> None:
        self.folder, self.template, self.outcomes, self.settings = folder, drawable(template), outcomes, settings
        self.weights = weights
        self.kept = np.ones(template.n_points, dtype=bool) if weights is None else weights > 0
        self.registered = [outcome for outcome in outcomes if outcome.figures is not None]
        self.names = [outcome.subject.name for outcome in self.registered]
        self.row_of = {name: row for row, name in enumerate(self.names)}

    @cached_property
    def points(self) -> Float[np.ndarray, "s n 3"] | FileRows:
        """The template's points on the registered shapes, of which there must be at least one (s, n, 3).

        Raises:
            DataError: if a file has another number of points than the template.
        """
        return self.folder.points(self.names, self.template.n_points)

    def write_points(self, path: Path) -> None:
        """Write the points into a file, shape by shape, and read them from there from now on.

        Raises:
            DataError: as ``points``.
        """
        each = self.folder.each_points(self.names, self.template.n_points)
        self.points = FileRows(write_npy_rows(path, each, len(self.names)))

    @property
    def adaptation(self) -> dict[str, Any] | None:
        """Of which shapes the map by the adapted weights was kept, and of which not; None where there are none."""
        known = {one.subject.name: one.figures.adapted for one in self.registered if one.figures is not None}
        if all(adapted is None for adapted in known.values()):
            return None
        return {
            "weights": None if (file := self.folder.weights()) is None else file.name,
            "kept": [name for name, adapted in known.items() if adapted],
            "not_kept": [name for name, adapted in known.items() if not adapted],
        }

    @cached_property
    def aligned(self) -> Aligned:
        """The shapes after generalised Procrustes alignment, in the orientation of the template."""
        return generalised_procrustes(
            self.points, scale=self.settings.scale, start=self.template.points, weights=self.weights
        )

    @cached_property
    def distances(self) -> Float[np.ndarray, " s"]:
        """The root mean square distance of each shape from the mean, after alignment."""
        return self.aligned.distances

    @cached_property
    def model(self) -> ShapeModel | None:
        """The mean and principal modes, of many shapes the first ones; None for fewer than two different shapes."""
        if len(self.registered) < 2:
            return None
        kept = None if self.weights is None else self.kept
        model = principal_modes(self.aligned, kept=kept, most=MOST_MODES if len(self.registered) > _FEW else None)
        return model if len(model.variances) else None

    @property
    def kept_faces(self) -> Int[np.ndarray, "m 3"] | None:
        """The template's faces between points that take part, by their numbers among these; None for clouds."""
        faces = self.template.faces
        if faces is None:
            return None
        return np.asarray((np.cumsum(self.kept) - 1)[faces[self.kept[faces].all(axis=1)]])

    @property
    def marks(self) -> dict[str, Float[np.ndarray, " n"]]:
        """Of each point for PLY files: how much it counts, where the template has a mask."""
        return {} if self.weights is None else {MASK: self.weights}

    @cached_property
    def colours(self) -> UInt8[np.ndarray, "n 3"]:
        """Colours of the template's points, by position: the same point has the same colour on every shape."""
        return position_colours(stand_upright(self.template, self.settings.template_up).points)

    @cached_property
    def worst_first(self) -> list[Outcome]:
        """All outcomes, the worst first; see ``worst_first``."""
        return worst_first(self.outcomes)


def worst_first(outcomes: Sequence[Outcome]) -> list[Outcome]:
    """Order outcomes: failures, then shapes with low-confidence warnings, then the others; the worst of each first.

    Shapes are ordered by the mean of their ranks in confidence, Dirichlet energy and unevenness of edge lengths, and
    equal ones by the given order. Each of the three orders shapes about as their true errors do, and none is best
    everywhere (``docs/logbook.md``); the share of flipped triangles does not. New here.
    """
    failed = [outcome for outcome in outcomes if outcome.figures is None]
    registered = [outcome for outcome in outcomes if outcome.figures is not None]
    figures = [outcome.figures for outcome in registered if outcome.figures is not None]
    measures = [(-one.confidence, one.dirichlet_energy, one.unevenness) for one in figures]
    ranks = rankdata(np.reshape(measures, (-1, 3)), axis=0).mean(axis=1)
    order = sorted(range(len(registered)), key=lambda number: (not registered[number].warnings, -ranks[number]))
    return [*failed, *(registered[number] for number in order)]
