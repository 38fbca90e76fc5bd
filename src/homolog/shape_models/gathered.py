"""The shapes of a collection that were placed, laid upon each other, and the model of how they vary."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, UInt8

from homolog.core.errors import DataError
from homolog.matching import position_colours
from homolog.shape_models.folder import CollectionFolder, Outcome
from homolog.shapes import Shape, Up, drawable, stand_upright
from homolog.statistics import Aligned, ShapeModel, generalised_procrustes, principal_modes


@dataclass(frozen=True)
class ModelSettings:
    """How the statistics are made.

    Args:
        scale: bring shapes to one size as well.
        seed: of the random shapes that measure specificity.
        template_up: which axis of the template points up, and so of the mean.
        shapes_up: which axis of the shapes.
    """

    scale: bool = False
    seed: int = 0
    template_up: Up = "y"
    shapes_up: Up = "y"


class Gathered:
    """All that the files of a collection are made of.

    Args:
        folder: where the placed shapes are.
        template: what they were matched to, as it was read.
        outcomes: what became of each shape.
        settings: how the statistics are made.
    """

    def __init__(
        self, folder: CollectionFolder, template: Shape, outcomes: Sequence[Outcome], settings: ModelSettings
    ) -> None:
        self.folder, self.template, self.outcomes, self.settings = folder, drawable(template), outcomes, settings
        self.placed = [outcome for outcome in outcomes if outcome.figures is not None]
        self.names = [outcome.subject.name for outcome in self.placed]

    @cached_property
    def points(self) -> Float[np.ndarray, "s n 3"]:
        """The template's points on the shapes that were placed, of which there must be one.

        Raises:
            DataError: if they are not as many as the template's.
        """
        points = self.folder.points(self.names)
        if points.shape[1] != self.template.n_points:
            folder = self.folder.root / "shapes"
            raise DataError(f"{folder} has {points.shape[1]} points, the template {self.template.n_points}")
        return points

    @cached_property
    def aligned(self) -> Aligned:
        """All of them, laid upon each other as the template stands."""
        return generalised_procrustes(self.points, scale=self.settings.scale, start=self.template.points)

    @cached_property
    def model(self) -> ShapeModel | None:
        """The mean and modes; None of fewer than two shapes that differ."""
        if len(self.placed) < 2:
            return None
        model = principal_modes(self.aligned.points)
        return model if len(model.variances) else None

    @cached_property
    def colours(self) -> UInt8[np.ndarray, "n 3"]:
        """Of the template's points, and so of each shape's: the same colour on the same point."""
        return position_colours(stand_upright(self.template, self.settings.template_up).points)
