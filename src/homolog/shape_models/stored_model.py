"""A shape model that ``homolog collection`` wrote, read back."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from typing_extensions import TypedDict

from homolog.core.array_files import ArrayFileError, read_npy
from homolog.core.errors import ArgumentError, DataError
from homolog.core.files import read_text
from homolog.core.reasons import reason_of
from homolog.core.records import read_record, record
from homolog.geometry.projection import SurfacePoints, SurfaceProjector
from homolog.pairs import Mask
from homolog.shape_models.folder import MASK, ShapeModelFolder
from homolog.shape_models.landmarks import TABLE
from homolog.shape_models.registered_shapes import ModelSettings
from homolog.shapes import Shape, read_shape
from homolog.shapes.formats.parsing import UnreadableError
from homolog.shapes.formats.ply import read_ply_property
from homolog.statistics import ShapeModel, generalised_procrustes

_AGAIN = "run homolog collection again"


@record
class _Report(TypedDict):
    shapes: list[str]
    statistics: ModelSettings


@dataclass(frozen=True, eq=False)
class StoredModel:
    """The shape model of a collection.

    Args:
        folder: of the collection.
        names: of the shapes, in the order of ``points.npy``.
        settings: of the statistics.
        model: mean and modes.
        mean: the mean shape, with the template's faces.
        deviation: standard deviation of each coordinate of a shape that the model was not made of, around what the
            model can show of it, as leaving one shape out tells; None for fewer than three shapes.
        weights: how much the template's points count (n,); None where it has no mask.
    """

    folder: ShapeModelFolder
    names: tuple[str, ...]
    settings: ModelSettings
    model: ShapeModel
    mean: Shape
    deviation: float | None
    weights: Float[np.ndarray, " n"] | None = None

    @classmethod
    def read(cls, root: str | Path) -> StoredModel:
        """Read the model of a collection.

        Raises:
            DataError: if the folder is no collection, has no model, or a file of it is damaged.
        """
        folder = ShapeModelFolder.existing(root)
        place = folder.root / "model"
        if not (place / "mean.ply").is_file():
            raise DataError(f"{root} has no model: it takes two shapes or more; give another collection")
        report = read_record(folder.root / "report.json", _Report, instead=_AGAIN)
        mean, modes = read_shape(place / "mean.ply"), _array(place / "modes.npy")
        variances, left_out = _curves(place / "curves.csv")
        if modes.shape != (len(variances), mean.n_points, 3) or not (
            np.isfinite(modes).all() and (variances > 0).all()
        ):
            raise DataError(f"{place} holds files that do not belong together; {_AGAIN}")
        weights = _weights(place / "mean.ply")
        model = ShapeModel(mean.points, modes, variances, kept=None if weights is None else weights > 0)
        deviation = left_out[-1] / np.sqrt(3) if left_out else None
        names, settings = tuple(report["shapes"]), ModelSettings(**report["statistics"])
        return cls(folder, names, settings, model, mean, deviation, weights)

    @property
    def kept(self) -> Bool[np.ndarray, " n"]:
        """Which of the template's points take part."""
        return np.ones(self.mean.n_points, dtype=bool) if self.weights is None else self.weights > 0

    def aligned(self, rows: Sequence[int] | None = None) -> Float[np.ndarray, "s n 3"]:
        """The shapes, or those of some rows of ``points.npy``, aligned with each other as the collection's were.

        Raises:
            DataError: if the array is damaged or does not belong to the report.
        """
        points = self.points() if rows is None else self.points()[list(rows)]
        scale, start = self.settings.scale, self.mean.points
        return generalised_procrustes(points, scale=scale, start=start, weights=self.weights).points

    def points(self) -> Float[np.ndarray, "s n 3"]:
        """The template's points on all shapes, in their own coordinates.

        Raises:
            DataError: if the array is damaged or does not belong to the report.
        """
        file = self.folder.root / "points.npy"
        points = _array(file)
        if points.shape != (len(self.names), self.mean.n_points, 3) or not np.isfinite(points).all():
            raise DataError(f"{file} does not have the points of {len(self.names)} shapes; {_AGAIN}")
        return points

    def landmarks(self) -> tuple[tuple[str, ...], SurfacePoints]:
        """The landmarks that the collection carried to all shapes: their names, and their places on the mean.

        Each is the median of where the shapes have it. There may be none.

        Raises:
            DataError: if the table is damaged.
        """
        file = self.folder.root / TABLE
        mean = SurfaceProjector(self.mean)
        if not file.is_file():
            return (), mean.project(np.zeros((0, 3)))
        names, positions = _landmark_table(file)
        on_mean = np.full((len(positions), len(names), 3), np.nan)
        for row, (shape, found) in zip(on_mean, positions.items(), strict=True):
            registered = SurfaceProjector(read_shape(self.folder.shape_file(shape)))
            row[:] = registered.project(found).interpolate(self.mean.points)
        known = np.isfinite(on_mean).any(axis=(0, 2))
        middle = np.nanmedian(on_mean[:, known], axis=0)
        return tuple(np.array(names)[known].tolist()), mean.project(middle)


def _weights(path: Path) -> Float[np.ndarray, " n"] | None:
    """How much the template's points count; None where it has no mask."""
    try:
        weights = read_ply_property(path, MASK)
        return None if weights is None else Mask(weights, str(path)).weights
    except (OSError, UnreadableError, ArgumentError) as error:
        raise DataError(f"{path} cannot be read ({reason_of(error)}); {_AGAIN}") from None


def _array(path: Path) -> Float[np.ndarray, ...]:
    try:
        values = read_npy(path)
    except (OSError, ArrayFileError) as error:
        raise DataError(f"{path} cannot be read ({reason_of(error)}); {_AGAIN}") from None
    if values.dtype.kind != "f":
        raise DataError(f"{path} holds no real numbers; {_AGAIN}")
    return values


def _rows(path: Path) -> Iterator[dict[str, Any]]:
    try:
        yield from csv.DictReader(read_text(path).splitlines(), strict=True)
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise DataError(f"{path} cannot be read ({reason_of(error)}); {_AGAIN}") from None


def _curves(path: Path) -> tuple[Float[np.ndarray, " k"], list[float]]:
    """The variance along each mode, and the distances of shapes that were left out, as far as there are any."""
    try:
        rows = [(float(row["variance"]), row["generalisation"]) for row in _rows(path)]
        return np.array([variance for variance, _ in rows]), [float(value) for _, value in rows if value]
    except (KeyError, TypeError, ValueError):
        raise DataError(f"{path} is no table of a model; {_AGAIN}") from None


def _landmark_table(path: Path) -> tuple[list[str], dict[str, Float[np.ndarray, "p 3"]]]:
    """The names of the landmarks, and their positions on each shape, NaN for those that it lacks."""
    try:
        rows = [(row["shape"], row["landmark"], [float(row[axis]) for axis in "xyz"]) for row in _rows(path)]
    except (KeyError, TypeError, ValueError):
        raise DataError(f"{path} is no table of landmarks; {_AGAIN}") from None
    names = list(dict.fromkeys(landmark for _, landmark, _ in rows))
    number = {name: place for place, name in enumerate(names)}
    positions: dict[str, np.ndarray] = {shape: np.full((len(names), 3), np.nan) for shape, _, _ in rows}
    for shape, landmark, position in rows:
        positions[shape][number[landmark]] = position
    return names, positions
