"""The files of the statistical model: mean, modes, coefficients, curves, an interactive page, exports."""

from __future__ import annotations

from itertools import chain
from pathlib import Path

import numpy as np

from homolog.core.files import atomic_path, made_folder, resolved, write_csv, write_npy
from homolog.shape_models.curves import Curves
from homolog.shape_models.registered_shapes import RegisteredShapes
from homolog.shape_models.scalismo import write_scalismo
from homolog.shape_models.shapeworks import write_shapeworks
from homolog.shapes import Shape, stand_upright, write_shape
from homolog.statistics import PointRows, ShapeModel
from homolog.viewing import ModesScene, modes_page_of

MODEL_FOLDERS = ("model", "scalismo", "shapeworks")
"""The folders of these files."""

# Modes on the page: later ones are hardly visible, and each makes the page larger.
_MOST_SLIDERS = 10


def write_model(shapes: RegisteredShapes, model: ShapeModel) -> list[Path]:
    """Write all of them, and return their paths.

    Raises:
        ArgumentError: if a file cannot be written.
        MissingExtraError: without the extra ``collection``.
    """
    folder, scalismo, shapeworks = (made_folder(shapes.folder.root / name) for name in MODEL_FOLDERS)
    faces = shapes.template.faces
    curves = Curves.of(model.of_kept(), PointRows(shapes.aligned, shapes.kept), seed=shapes.settings.seed)
    write_shape(folder / "mean.ply", Shape(model.mean, faces), colours=shapes.colours, numbers=shapes.marks)
    write_npy(folder / "modes.npy", model.modes)
    _write_coefficients(folder / "coefficients.csv", shapes, model)
    curves.write_table(folder / "curves.csv")
    curves.write_picture(folder / "curves.png")
    with atomic_path(folder / "modes.html") as temporary:
        temporary.write_text(modes_page_of(_scene(shapes, model, curves)), encoding="utf-8")
    write_scalismo(scalismo / "model.h5", model.of_kept(), shapes.kept_faces)
    meshes = None if faces is None else [shapes.folder.shape_file(name) for name in shapes.names]
    particles = write_shapeworks(shapeworks, shapes.names, shapes.points, shapes.aligned, meshes, kept=shapes.kept)
    names = ("mean.ply", "modes.npy", "coefficients.csv", "curves.csv", "curves.png", "modes.html")
    return [*(folder / name for name in names), scalismo / "model.h5", *particles]


def _write_coefficients(path: Path, shapes: RegisteredShapes, model: ShapeModel) -> None:
    coefficients = model.coefficients(shapes.aligned)
    head = ["name", *(f"mode_{mode + 1}" for mode in range(coefficients.shape[1]))]
    rows = ([name, *(f"{value:.6g}" for value in row)] for name, row in zip(shapes.names, coefficients, strict=True))
    write_csv(path, chain([head], rows))


def _scene(shapes: RegisteredShapes, model: ShapeModel, curves: Curves) -> ModesScene:
    """The first modes, turned +y up."""
    shown, up = min(_MOST_SLIDERS, len(model.variances)), shapes.settings.template_up
    held = 100 * curves.compactness[shown - 1]
    offsets = model.modes[:shown] * model.deviations[:shown, None, None]
    return ModesScene(
        title=f"Modes of {resolved(shapes.folder.root).name}",
        summary=f"{len(shapes.names):,} shapes vary in {len(model.variances):,} modes; those below hold {held:.3g} % "
        "of the variance.",
        mean=stand_upright(Shape(model.mean), up).points,
        faces=shapes.template.faces,
        colours=shapes.colours,
        offsets=np.stack([stand_upright(Shape(offset), up).points for offset in offsets]),
        shares=model.variances[:shown] / model.total,
        names=shapes.names,
        coefficients=model.coefficients(shapes.aligned)[:, :shown],
    )
