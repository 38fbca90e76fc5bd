"""Repairing a shape, with the way back to the indices of the original."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Int, Shaped

from homolog.core.errors import ShapeError, bad_value
from homolog.shapes.checking import Report, report_on
from homolog.shapes.cleaning import clean
from homolog.shapes.shape import Shape


@dataclass(frozen=True, eq=False)
class Repaired:
    """A clean shape and the way back to the one it was made from.

    Args:
        shape: the clean shape; the very original if nothing had to be done.
        report: what was found and done.
        kept: index in the original of each clean point, shape (n_clean,), increasing.
        clean_index: for each original point the clean point that stands for it, shape (n_original,); equal
            points share one, and -1 marks those left out.
    """

    shape: Shape
    report: Report
    kept: Int[np.ndarray, " n_clean"]
    clean_index: Int[np.ndarray, " n_original"]

    def __repr__(self) -> str:
        return f"Repaired({self.shape!r}, {len(self.kept)} of {len(self.clean_index)} points kept)"

    def to_original(
        self, values: Shaped[np.ndarray, "n_clean ..."], fill: Any = None
    ) -> Shaped[np.ndarray, "n_original ..."]:
        """Bring one value per clean point to the original's points.

        Args:
            values: shape (n_clean, ...). Equal original points all get the value of the point that stands for
                them.
            fill: the value of points left out; by default NaN for real numbers, -1 for whole ones, else 0.
        """
        values = np.asarray(values)
        if values.ndim < 1 or len(values) != len(self.kept):
            raise bad_value("values", values.shape, f"one per clean point, ({len(self.kept)}, ...)")
        if fill is None:
            fill = np.nan if values.dtype.kind in "fc" else -1 if values.dtype.kind == "i" else 0
        padded = np.concatenate([values, np.full_like(values[:1], fill)])
        lifted: np.ndarray = padded[self.clean_index]
        return lifted

    def original_index(self, indices: Int[np.ndarray, ...]) -> Int[np.ndarray, ...]:
        """Turn indices of clean points into indices of the original; -1 stays -1.

        Args:
            indices: any shape, each from -1 to n_clean - 1.
        """
        indices = np.asarray(indices)
        if indices.size and not -1 <= indices.min() <= indices.max() < len(self.kept):
            raise bad_value("indices", (indices.min(), indices.max()), f"from -1 to {len(self.kept) - 1}")
        originals: np.ndarray = np.append(self.kept, -1)[indices]
        return originals

    def original_map(
        self, source_to_target: Int[np.ndarray, " n_clean"], target: Repaired
    ) -> Int[np.ndarray, " n_original"]:
        """Turn a point map between clean shapes into one between the originals.

        Args:
            source_to_target: for each clean point of this shape a clean point of ``target``, or -1.
            target: the other shape's repair.
        """
        return self.to_original(target.original_index(source_to_target), fill=-1)


def repair(shape: Shape) -> Repaired:
    """Take out of a shape what cannot be used; nothing moves, and no hole is filled or opened.

    Points that are NaN, infinite, equal to an earlier one, or used by no face are left out; faces that repeat
    a corner, repeat an earlier face or do not fit the points are dropped. Repairing twice is like repairing
    once.

    Args:
        shape: a mesh or a point cloud in any state; never changed.

    Raises:
        ArgumentError: if it is no ``Shape``.
        ShapeError: if what is left is no shape: too few points, no face, or no extent.

    Examples:
        >>> import homolog
        >>> points = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, 0]]  # the last point is the first
        >>> repaired = homolog.repair(homolog.Shape(points, [[4, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]))
        >>> repaired.shape
        Shape('shape': mesh, 4 points, 4 faces)
        >>> repaired.clean_index.tolist()
        [0, 1, 2, 3, 0]
    """
    cleaning = clean(shape)
    report = report_on(shape, cleaning)
    for finding in report.findings:
        if finding.severity == "unusable":
            raise ShapeError(f"{shape.name} cannot be used: {finding}")
    clean_shape = (
        shape if report.is_clean else replace(shape, points=cleaning.points, faces=cleaning.faces, allow_broken=False)
    )
    return Repaired(clean_shape, report, cleaning.kept, cleaning.clean_index)


def drawable(shape: Shape) -> Shape:
    """A shape that other programs can open: all its points in their order, and the faces that ``repair`` keeps.

    Points that are NaN or infinite are put at the mean of the others. Faces stay over the shape's own points; a mesh
    without any usable face becomes a cloud.

    Args:
        shape: a mesh or a point cloud with at least one finite point; never changed.
    """
    kept = clean(shape).kept_faces
    finite = np.isfinite(shape.points).all(axis=1)
    points = np.where(finite[:, None], shape.points, shape.points[finite].mean(axis=0))
    faces = None if shape.faces is None or kept is None or not len(kept) else shape.faces[kept]
    return replace(shape, points=points, faces=faces, allow_broken=False)
