"""Landmarks of a template, carried to all shapes that it is registered to."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from homolog.core.choices import System
from homolog.core.errors import DataError
from homolog.core.files import expanded, made_folder, write_csv
from homolog.geometry import surface_area
from homolog.pairs.guidance import FAR_AWAY
from homolog.shape_models.registered_shapes import RegisteredShapes
from homolog.shapes import Shape
from homolog.transfer import FAR_LANDMARK, SurfaceProjector, read_landmarks, system_of
from homolog.transfer.landmarks import repeated_names_warning

FOLDER, TABLE = "landmarks", "landmarks.csv"


class TemplateLandmarks:
    """The landmarks of a file, as places on the template's surface.

    Args:
        file: the landmarks; see ``homolog.transfer.read_landmarks``.
        template: as it was read.
        axes: the anatomical axes of all shapes, for landmark files that state theirs; None for those that the shapes'
            files name, or LPS.
        kept: which of the template's points are matched (n,); landmarks on others get no position. By default all.

    Raises:
        DataError: if the file cannot be read, or a landmark lies far from the template.
    """

    def __init__(
        self,
        file: str | Path,
        template: Shape,
        axes: System | None = None,
        kept: Bool[np.ndarray, " n"] | None = None,
    ) -> None:
        self.file, self.axes, self.landmarks = expanded(file), axes, read_landmarks(file)
        projector = SurfaceProjector(template)
        given = self.landmarks.points_in(system_of(template.space, axes))
        self.places = projector.project(given)
        distances = np.linalg.norm(projector.positions(self.places) - given, axis=1)
        self.farthest = float(np.nanmax(distances)) if np.isfinite(distances).any() else None
        """The largest distance of a landmark from the template's surface, in its unit."""
        self._spacing = projector.spacing
        if self.farthest is not None and self.farthest > FAR_AWAY * math.sqrt(surface_area(template)):
            raise DataError(
                f"a landmark of {self.file.name} is {self.farthest:.3g} away from the template's surface; "
                "give landmarks in the template's coordinates and unit, or the right --axes"
            )
        if kept is not None:
            nearest = np.nan_to_num(self.places.weights).argmax(axis=1)
            self.places = self.places.masked(kept[self.places.corners[np.arange(len(nearest)), nearest]])

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings if a landmark is far from the template's surface, or several have the same name."""
        names = repeated_names_warning(self.file, self.landmarks.names)
        if self.farthest is None or self.farthest <= FAR_LANDMARK * self._spacing:
            return (names,) if names else ()
        far = (
            f"a landmark of {self.file.name} is {self.farthest:.3g} away from the template's surface; "
            "look at its units and at --axes"
        )
        return (far, names) if names else (far,)

    def file_of(self, name: str) -> str:
        """The file of a shape's landmarks, in the collection's folder."""
        return f"{FOLDER}/{name}{self.landmarks.suffix}"

    def on(self, shape: Shape, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "p 3"]:
        """The landmarks on the surface of a shape, in its own coordinates; NaN for those that have no position.

        Args:
            shape: as it was read.
            points: the template's points, registered to it.
        """
        surface = SurfaceProjector(shape)
        return surface.positions(surface.project(self.places.interpolate(points)))

    def write(self, shapes: RegisteredShapes) -> list[Path]:
        """Write a landmark file for each shape, in the format of the given one, and a table of all."""
        root, rows = shapes.folder.root, [["shape", "landmark", "x", "y", "z"]]
        made_folder(root / FOLDER)
        written: list[Path] = []
        for outcome, points in zip(shapes.registered, shapes.points, strict=True):
            name, shape = outcome.subject.name, outcome.subject.surface()
            positions = self.on(shape, points)
            written.append(root / self.file_of(name))
            self.landmarks.write_from(written[-1], positions, system_of(shape.space, self.axes))
            rows += [
                [name, landmark, *map(repr, position)]
                for landmark, position in zip(self.landmarks.names, positions.tolist(), strict=True)
            ]
        write_csv(root / TABLE, rows)
        return [*written, root / TABLE]

    def to_dict(self) -> dict[str, Any]:
        """For the report."""
        return {
            "file": str(self.file),
            "names": list(self.landmarks.names),
            "largest_distance_from_template": self.farthest,
        }
