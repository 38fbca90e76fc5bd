"""What a collection comes to: one array, a table, a contact sheet, a model, and exports."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

from homolog.core.errors import DataError, needs_extra
from homolog.core.files import all_or_nothing, read_json, write_json, write_npy
from homolog.shape_models.folder import CollectionFolder, Outcome
from homolog.shape_models.gathered import Gathered, ModelSettings
from homolog.shape_models.model_files import MODEL_FOLDERS, write_model
from homolog.shape_models.overview import write_quality, write_sheet
from homolog.shapes import Shape

REPORT = "report.json"
# Where a delivery writes, beside its report.
_PLACES = ("points.npy", "quality.csv", "contact_sheet.png", *MODEL_FOLDERS)
# Those that are folders, inner ones first.
_FOLDERS = ("shapeworks/particles", *MODEL_FOLDERS)


def check_extra() -> None:
    """Refuse collections without their extra, before any work is done.

    Raises:
        MissingExtraError: naming what is missing.
    """
    with needs_extra("homolog collection", "collection"):
        import h5py  # noqa: F401
        import matplotlib  # noqa: F401
        import PIL  # noqa: F401


def deliver(
    folder: CollectionFolder,
    template: Shape,
    outcomes: Sequence[Outcome],
    settings: ModelSettings | None = None,
    *,
    told: dict[str, Any] | None = None,
) -> list[Path]:
    """Write all that follows from the shapes that were placed; the files land together.

    Of two shapes or more that differ there is a model. Files of an earlier delivery that do not belong to this one any
    more are taken away. Where no shape was placed, a table, a contact sheet and a report still say so.

    Args:
        folder: where the placed shapes are.
        template: what they were matched to, as it was read.
        outcomes: what became of each shape.
        settings: how the statistics are made.
        told: what else ``report.json`` is to say.

    Returns:
        The files and folders to look at.

    Raises:
        DataError: if no shape was placed.
        ArgumentError: if a file cannot be written.
        MissingExtraError: without the extra ``collection``.
    """
    gathered = Gathered(folder, template, outcomes, settings or ModelSettings())
    root, before = folder.root, _files_of(folder.root)
    try:
        with all_or_nothing():
            files = [path.relative_to(root).as_posix() for path in _write(gathered)]
            write_json(root / REPORT, {**_report(gathered), **(told or {}), "files": files})
        for name in before - set(files):
            (root / name).unlink(missing_ok=True)
    finally:
        _leave_no_empty_folder(root)
    if not gathered.placed:
        raise DataError(
            f"none of the {len(outcomes)} shapes could be placed, so that there is nothing to collect; "
            f"{root / 'quality.csv'} says why"
        )
    places = ["shapes", "points.npy", "quality.csv", "contact_sheet.png", REPORT]
    return [root / name for name in (*places, *([] if gathered.model is None else ("model", "shapeworks", "scalismo")))]


def _write(gathered: Gathered) -> list[Path]:
    """Write all but the report, and say what that is."""
    root = gathered.folder.root
    table, sheet, array = root / "quality.csv", root / "contact_sheet.png", root / "points.npy"
    write_quality(table, gathered)
    write_sheet(sheet, gathered)
    if not gathered.placed:
        return [table, sheet]
    write_npy(array, gathered.points)
    return [array, table, sheet, *([] if gathered.model is None else write_model(gathered, gathered.model))]


def _report(gathered: Gathered) -> dict[str, Any]:
    model = gathered.model
    return {
        "template": {"points": gathered.template.n_points, "faces": gathered.template.n_faces},
        "shapes": gathered.names,
        "not_placed": {one.subject.name: one.error for one in gathered.outcomes if one.figures is None},
        "doubtful": {one.subject.name: list(one.warnings) for one in gathered.placed if one.warnings},
        "placed_before_and_not_given_now": gathered.folder.others([one.subject for one in gathered.outcomes]),
        "statistics": asdict(gathered.settings),
        "modes": 0 if model is None else len(model.variances),
        "variance": None if model is None else float(model.variances.sum()),
    }


def _files_of(root: Path) -> set[str]:
    """What an earlier delivery to a folder says that it wrote; nothing else, as reports may come from anywhere."""
    told = (read_json(root / REPORT, needs="files") or {}).get("files")
    names = [name for name in told if isinstance(name, str)] if isinstance(told, list) else []
    ours = (root / place for place in _PLACES)
    places = tuple(place.resolve() for place in ours)
    return {name for name in names if any((root / name).resolve().is_relative_to(place) for place in places)}


def _leave_no_empty_folder(root: Path) -> None:
    """Take folders away in which nothing was written, or from which all was taken."""
    for name in _FOLDERS:
        with suppress(OSError):  # it is not there, or holds something
            (root / name).rmdir()
