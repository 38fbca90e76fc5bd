"""Symmetric and asymmetric components of registered shapes, by the mirror partners of the template's points."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from homolog.core.files import made_folder, write_csv, write_npy
from homolog.shape_models.registered_shapes import RegisteredShapes
from homolog.shapes import Shape, write_shape
from homolog.statistics import SymmetricComponents, symmetric_components
from homolog.symmetries import read_partner_positions
from homolog.transfer import SurfaceProjector
from homolog.viewing import heat_layer

ASYMMETRY_FOLDER = "symmetry"
_NAMES = ("symmetric.npy", "asymmetric.npy", "asymmetry.csv", "mean.ply", "directional.ply")


class TemplateSymmetry:
    """The mirror partners of the template's points, as places on its surface.

    Args:
        folder: what ``homolog symmetry`` wrote of the template.
        template: as it was read.

    Raises:
        DataError: if the folder does not hold the partners of this shape's points.
    """

    def __init__(self, folder: str | Path, template: Shape) -> None:
        self.file = Path(folder)
        self.partners = SurfaceProjector(template).project(read_partner_positions(folder, template))
        self._components: SymmetricComponents | None = None

    def write(self, shapes: RegisteredShapes) -> list[Path]:
        """Write both components (shapes, points, 3), a table of the shapes, and the symmetric mean.

        Points without a partner are NaN in the arrays, and lie at the mean of the others in the shape.
        """
        known = self.partners.valid & shapes.kept & shapes.kept[self.partners.corners].all(axis=1)
        points = np.asarray(shapes.points[:])  # both parts are held in memory
        partners = np.stack([self.partners.interpolate(each) for each in points])
        found = symmetric_components(points[:, known], partners[:, known], scale=shapes.settings.scale)
        self._components = found
        folder = made_folder(shapes.folder.root / ASYMMETRY_FOLDER)
        paths = [folder / name for name in _NAMES]
        every = [np.full(shapes.points.shape, np.nan) for _ in range(2)]
        for path, values, part in zip(paths, every, (found.symmetric, found.asymmetric), strict=False):
            values[:, known] = part
            write_npy(path, values)
        write_csv(paths[2], [("name", "asymmetry"), *zip(shapes.names, map(float, found.amounts), strict=True)])
        mean = np.where(known[:, None], every[0].mean(axis=0), found.symmetric.mean(axis=(0, 1)))
        write_shape(paths[3], Shape(mean, shapes.template.faces), colours=shapes.colours)
        away = np.linalg.norm(every[1].mean(axis=0), axis=1)
        heat = heat_layer("Directional asymmetry", "", {"source": away}, "")
        write_shape(paths[4], Shape(mean, shapes.template.faces), colours=heat.colours["source"])
        return paths

    def to_dict(self) -> dict[str, Any]:
        """For the report."""
        variances = None if self._components is None else self._components.variances()
        return {"folder": str(self.file), "variances": variances}
