"""The files of a collection's shape model: mean and modes, curves, a page to drag them, exports."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from homolog.core.files import atomic_path, made_folder, write_csv, write_npy
from homolog.shape_models.curves import Curves
from homolog.shape_models.gathered import Gathered
from homolog.shape_models.scalismo import write_scalismo
from homolog.shape_models.shapeworks import write_shapeworks
from homolog.shapes import Shape, stand_upright, write_shape
from homolog.statistics import ShapeModel
from homolog.viewing import ModesScene, modes_page_of

MODEL_FOLDERS = ("model", "scalismo", "shapeworks")
"""Where they are."""

# Modes that can be dragged through: later ones hardly show, and each makes the page larger.
_MOST_SLIDERS = 10


def write_model(gathered: Gathered, model: ShapeModel) -> list[Path]:
    """Write all of them, and say which they are.

    Raises:
        ArgumentError: if a file cannot be written.
        MissingExtraError: without the extra ``collection``.
    """
    place, scalismo, shapeworks = (made_folder(gathered.folder.root / name) for name in MODEL_FOLDERS)
    faces = gathered.template.faces
    curves = Curves.of(model, gathered.aligned.points, seed=gathered.settings.seed)
    write_shape(place / "mean.ply", Shape(model.mean, faces), colours=gathered.colours)
    write_npy(place / "modes.npy", model.modes)
    _write_coefficients(place / "coefficients.csv", gathered, model)
    curves.write_table(place / "curves.csv")
    curves.write_picture(place / "curves.png")
    with atomic_path(place / "modes.html") as temporary:
        temporary.write_text(modes_page_of(_scene(gathered, model, curves)), encoding="utf-8")
    write_scalismo(scalismo / "model.h5", model, faces)
    meshes = None if faces is None else [gathered.folder.shape_file(name) for name in gathered.names]
    particles = write_shapeworks(shapeworks, gathered.names, gathered.points, gathered.aligned, meshes)
    names = ("mean.ply", "modes.npy", "coefficients.csv", "curves.csv", "curves.png", "modes.html")
    return [*(place / name for name in names), scalismo / "model.h5", *particles]


def _write_coefficients(path: Path, gathered: Gathered, model: ShapeModel) -> None:
    coefficients = model.coefficients(gathered.aligned.points)
    head = ["name", *(f"mode_{mode + 1}" for mode in range(coefficients.shape[1]))]
    rows = [[name, *(f"{value:.6g}" for value in row)] for name, row in zip(gathered.names, coefficients, strict=True)]
    write_csv(path, [head, *rows])


def _scene(gathered: Gathered, model: ShapeModel, curves: Curves) -> ModesScene:
    """The first modes, upright."""
    shown, up = min(_MOST_SLIDERS, len(model.variances)), gathered.settings.template_up
    held = 100 * curves.compactness[shown - 1]
    offsets = model.modes[:shown] * model.deviations[:shown, None, None]
    return ModesScene(
        title=f"Modes of {gathered.folder.root.resolve().name}",
        summary=f"{len(gathered.names):,} shapes vary in {len(model.variances):,} modes; those below hold {held:.3g} % "
        "of the variance.",
        mean=stand_upright(Shape(model.mean), up).points,
        faces=gathered.template.faces,
        colours=gathered.colours,
        offsets=np.stack([stand_upright(Shape(offset), up).points for offset in offsets]),
        shares=model.variances[:shown] / model.variances.sum(),
        names=gathered.names,
        coefficients=model.coefficients(gathered.aligned.points)[:, :shown],
    )
