"""The outputs of a shape model: points, table, contact sheet, statistics and exports."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

from typing_extensions import TypedDict

from homolog.core.errors import DataError, needs_extra
from homolog.core.files import all_or_nothing, resolved, write_json
from homolog.core.records import record, stored_record
from homolog.pairs import Mask
from homolog.shape_models.asymmetry import ASYMMETRY_FOLDER, TemplateSymmetry
from homolog.shape_models.folder import Outcome, ShapeModelFolder
from homolog.shape_models.landmarks import FOLDER, TABLE, TemplateLandmarks
from homolog.shape_models.model_files import MODEL_FOLDERS, write_model
from homolog.shape_models.overview import write_quality, write_sheet
from homolog.shape_models.registered_shapes import ModelSettings, RegisteredShapes
from homolog.shapes import Shape

REPORT = "report.json"
OUTPUT_NAMES = ("points.npy", "quality.csv", "contact_sheet.png", TABLE, FOLDER, ASYMMETRY_FOLDER, *MODEL_FOLDERS)
"""The files and folders that are written beside the report."""
# Those that are folders, inner ones first.
_FOLDERS = ("shapeworks/particles", FOLDER, ASYMMETRY_FOLDER, *MODEL_FOLDERS)


def check_extra() -> None:
    """Refuse shape models without their extra, before any work is done.

    Raises:
        MissingExtraError: naming what is missing.
    """
    with needs_extra("homolog collection", "collection"):
        import h5py  # noqa: F401
        import matplotlib  # noqa: F401
        import PIL  # noqa: F401


def write_outputs(
    folder: ShapeModelFolder,
    template: Shape,
    outcomes: Sequence[Outcome],
    settings: ModelSettings | None = None,
    *,
    landmarks: TemplateLandmarks | None = None,
    symmetry: TemplateSymmetry | None = None,
    mask: Mask | None = None,
    report: Mapping[str, Any] | None = None,
) -> list[Path]:
    """Write points, table, contact sheet, statistics, exports and report; all files land together or none does.

    Two or more different shapes have a model. Files of an earlier call that do not belong to this one are removed. If
    no shape was registered, a table, a contact sheet and a report are still written.

    Args:
        folder: of the registered shapes.
        template: as it was read.
        outcomes: of all shapes.
        settings: of the statistics.
        landmarks: of the template, to be carried to all shapes.
        symmetry: of the template, by which shapes are taken apart into symmetric and asymmetric components.
        mask: of the template: points with 0 are left out of alignment and statistics, and follow the others.
        report: further entries of ``report.json``.

    Returns:
        The files and folders to look at.

    Raises:
        DataError: if no shape was registered.
        ArgumentError: if a file cannot be written.
        MissingExtraError: without the extra ``collection``.
    """
    weights = None if mask is None else mask.weights
    shapes = RegisteredShapes(folder, template, outcomes, settings or ModelSettings(), weights)
    root, before = folder.root, _earlier_files(folder.root)
    try:
        with all_or_nothing():
            files = [path.relative_to(root).as_posix() for path in _write(shapes, landmarks, symmetry)]
            told = {**_report(shapes), "landmarks": None if landmarks is None else landmarks.to_dict()}
            told["symmetry"] = None if symmetry is None else symmetry.to_dict()
            write_json(root / REPORT, {**told, **(report or {}), "files": files})
        for name in before - set(files):
            (root / name).unlink(missing_ok=True)
    finally:
        for name in _FOLDERS:
            with suppress(OSError):  # it does not exist, or is not empty
                (root / name).rmdir()
    if not shapes.registered:
        raise DataError(
            f"none of the {len(outcomes)} shapes could be registered, so there is no shape model; "
            f"{root / 'quality.csv'} says why"
        )
    names = ["shapes", "matches", "points.npy", "quality.csv", "contact_sheet.png", REPORT]
    names += [] if landmarks is None else [FOLDER, TABLE]
    names += [] if symmetry is None else [ASYMMETRY_FOLDER]
    return [root / name for name in (*names, *([] if shapes.model is None else ("model", "shapeworks", "scalismo")))]


def _write(
    shapes: RegisteredShapes, landmarks: TemplateLandmarks | None, symmetry: TemplateSymmetry | None
) -> list[Path]:
    """Write everything but the report, and return the files."""
    root = shapes.folder.root
    table, sheet, array = root / "quality.csv", root / "contact_sheet.png", root / "points.npy"
    if shapes.registered:
        shapes.write_points(array)
    write_quality(table, shapes)
    write_sheet(sheet, shapes)
    if not shapes.registered:
        return [table, sheet]
    carried = [] if landmarks is None else landmarks.write(shapes)
    carried += [] if symmetry is None else symmetry.write(shapes)
    return [array, table, sheet, *carried, *([] if shapes.model is None else write_model(shapes, shapes.model))]


def _report(shapes: RegisteredShapes) -> dict[str, Any]:
    model = shapes.model
    return {
        "template": {
            "points": shapes.template.n_points,
            "faces": shapes.template.n_faces,
            "points_left_out": int((~shapes.kept).sum()),
        },
        "masks": {one.subject.name: str(one.subject.mask_file) for one in shapes.outcomes if one.subject.mask_file},
        "choice": [asdict(candidate) for candidate in shapes.folder.choice() or ()],
        "adaptation": shapes.adaptation,
        "shapes": shapes.names,
        "not_registered": {one.subject.name: one.error for one in shapes.outcomes if one.figures is None},
        "warnings": {one.subject.name: list(one.warnings) for one in shapes.registered if one.warnings},
        "registered_before_and_not_given_now": shapes.folder.others([one.subject for one in shapes.outcomes]),
        "statistics": asdict(shapes.settings),
        "modes": 0 if model is None else len(model.variances),
        "variance": None if model is None else model.total,
    }


@record
class _Report(TypedDict):
    files: list[str]


def _earlier_files(root: Path) -> set[str]:
    """The files of an earlier call, by its report; only those at our own paths, as a report may be anybody's."""
    names = (stored_record(root / REPORT, _Report) or {"files": []})["files"]
    ours = tuple(resolved(root / name) for name in OUTPUT_NAMES)
    return {name for name in names if any(resolved(root / name).is_relative_to(path) for path in ours)}
