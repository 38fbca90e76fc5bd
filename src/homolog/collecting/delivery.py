"""What a collection comes to: one array, a table, a contact sheet, a model, and exports."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from homolog.collecting.curves import Curves
from homolog.collecting.folder import CollectionFolder, Outcome
from homolog.collecting.placing import Figures
from homolog.collecting.scalismo import write_scalismo
from homolog.collecting.shapeworks import write_shapeworks
from homolog.errors import DataError, needs_extra
from homolog.files import all_or_nothing, atomic_path, made_folder, read_json, write_csv, write_json
from homolog.matching import position_colours
from homolog.shapes import Shape, Up, drawable, stand_upright, write_shape
from homolog.statistics import Aligned, ShapeModel, generalised_procrustes, principal_modes
from homolog.viewing import ModesScene, Tile, contact_sheet, modes_page_of

REPORT = "report.json"
# Where a delivery writes, beside its report.
_PLACES = ("points.npy", "quality.csv", "contact_sheet.png", "model", "shapeworks", "scalismo")
# Modes that can be dragged through: later ones hardly show, and each makes the page larger.
_MOST_SLIDERS = 10
_FIGURES = tuple(field.name for field in fields(Figures))


def check_extra() -> None:
    """Refuse collections without their extra, before any work is done.

    Raises:
        MissingExtraError: naming what is missing.
    """
    with needs_extra("homolog collection", "collection"):
        import h5py  # noqa: F401
        import matplotlib  # noqa: F401
        import PIL  # noqa: F401


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
    more are taken away.

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
    if all(outcome.figures is None for outcome in outcomes):
        raise DataError(f"none of the {len(outcomes)} shapes could be placed, so that there is nothing to collect")
    return _Delivery(folder, drawable(template), outcomes, settings or ModelSettings()).write(told or {})


class _Delivery:
    """The files of one collection."""

    def __init__(
        self, folder: CollectionFolder, template: Shape, outcomes: Sequence[Outcome], settings: ModelSettings
    ) -> None:
        self.folder, self.template, self.outcomes, self.settings = folder, template, outcomes, settings
        self.placed = [outcome for outcome in outcomes if outcome.figures is not None]
        self.names = [outcome.subject.name for outcome in self.placed]
        self.points = folder.points(self.names)
        if self.points.shape[1] != template.n_points:
            raise DataError(f"{folder.root}/shapes has {self.points.shape[1]} points, the template {template.n_points}")
        self._written: list[Path] = []

    @cached_property
    def aligned(self) -> Aligned:
        """All shapes, laid upon each other as the template stands."""
        return generalised_procrustes(self.points, scale=self.settings.scale, start=self.template.points)

    @cached_property
    def model(self) -> ShapeModel | None:
        """The mean and modes, if there are any."""
        if len(self.points) < 2:
            return None
        model = principal_modes(self.aligned.points)
        return model if len(model.variances) else None

    def write(self, told: dict[str, Any]) -> list[Path]:
        root = self.folder.root
        before = _files_of(root)
        with all_or_nothing():
            self._write_array(root / "points.npy", self.points)
            self._write_quality(root / "quality.csv")
            self._write_sheet(root / "contact_sheet.png")
            if self.model is not None:
                self._write_model(self.model)
            files = [path.relative_to(root).as_posix() for path in self._written]
            write_json(root / REPORT, {**self._report(), **told, "files": files})
        for name in before - set(files):
            (root / name).unlink(missing_ok=True)
        looked_at = ["shapes", "points.npy", "quality.csv", "contact_sheet.png", REPORT]
        looked_at += [] if self.model is None else ["model", "shapeworks", "scalismo"]
        return [root / name for name in looked_at]

    def _new(self, path: Path) -> Path:
        """A file that is about to be written."""
        self._written.append(path)
        return path

    def _write_array(self, path: Path, array: Float[np.ndarray, ...]) -> None:
        with atomic_path(self._new(path)) as temporary, temporary.open("wb") as file:
            np.save(file, array, allow_pickle=False)

    def _write_table(self, path: Path, rows: Sequence[Sequence[Any]]) -> None:
        write_csv(self._new(path), rows)

    # ---- quality

    def _write_quality(self, path: Path) -> None:
        head = ["name", "row", *_FIGURES, "distance_from_mean", "seconds", "doubts", "file"]
        self._write_table(path, [head, *map(self._quality_row, self.outcomes)])

    def _quality_row(self, outcome: Outcome) -> list[Any]:
        subject = outcome.subject
        if outcome.figures is None:
            empty = [""] * (len(_FIGURES) + 3)
            return [subject.name, *empty, f"not placed: {outcome.error}", subject.file]
        row, figures = self.names.index(subject.name), asdict(outcome.figures)
        numbers = ["" if figures[name] is None else f"{figures[name]:.6g}" for name in _FIGURES]
        away = f"{self.aligned.distances[row]:.6g}"
        return [subject.name, row, *numbers, away, f"{outcome.seconds:.2f}", "; ".join(outcome.warnings), subject.file]

    def _write_sheet(self, path: Path) -> None:
        with needs_extra("contact sheets", "collection"):
            from PIL import Image
        image = Image.fromarray(contact_sheet(self._tiles()))
        with atomic_path(self._new(path)) as temporary:
            image.save(temporary, format="PNG")

    def _tiles(self) -> list[Tile]:
        """The template, shapes that could not be placed, and the others: doubtful ones first, then by confidence."""
        failed = [
            Tile(outcome.subject.name, ("", "not placed"), alarming=True)
            for outcome in self.outcomes
            if outcome.figures is None
        ]
        template = stand_upright(self.template, self.settings.template_up)
        first = Tile("template", (self.template.name,), template.points, template.faces, self._colours)
        return [first, *failed, *(self._tile(outcome) for outcome in sorted(self.placed, key=_badness))]

    def _tile(self, outcome: Outcome) -> Tile:
        assert outcome.figures is not None
        points = self.points[self.names.index(outcome.subject.name)]
        shape, figures = stand_upright(Shape(points), self.settings.shapes_up), outcome.figures
        flipped = "" if figures.flipped_triangles is None else f", {100 * figures.flipped_triangles:.1f} % flipped"
        lines = [f"confidence {figures.confidence:.2f}{flipped}", *(["doubtful"] if outcome.warnings else [])]
        return Tile(
            outcome.subject.name,
            tuple(lines),
            shape.points,
            self.template.faces,
            self._colours,
            alarming=bool(outcome.warnings),
        )

    @cached_property
    def _colours(self) -> np.ndarray:
        return position_colours(stand_upright(self.template, self.settings.template_up).points)

    # ---- the model

    def _write_model(self, model: ShapeModel) -> None:
        place, faces = made_folder(self.folder.root / "model"), self.template.faces
        write_shape(self._new(place / "mean.ply"), Shape(model.mean, faces), colours=self._colours)
        self._write_array(place / "modes.npy", model.modes)
        coefficients = model.coefficients(self.aligned.points)
        head = ["name", *(f"mode_{mode + 1}" for mode in range(coefficients.shape[1]))]
        rows = [[name, *(f"{value:.6g}" for value in row)] for name, row in zip(self.names, coefficients, strict=True)]
        self._write_table(place / "coefficients.csv", [head, *rows])
        curves = Curves.of(model, self.aligned.points, seed=self.settings.seed)
        curves.write_table(self._new(place / "curves.csv"))
        curves.write_picture(self._new(place / "curves.png"))
        with atomic_path(self._new(place / "modes.html")) as temporary:
            temporary.write_text(modes_page_of(self._scene(model, curves)), encoding="utf-8")
        write_scalismo(self._new(made_folder(self.folder.root / "scalismo") / "model.h5"), model, faces)
        meshes = None if faces is None else [self.folder.shape_file(name) for name in self.names]
        made = made_folder(self.folder.root / "shapeworks")
        self._written += write_shapeworks(made, self.names, self.points, self.aligned, meshes)

    def _scene(self, model: ShapeModel, curves: Curves) -> ModesScene:
        shown = min(_MOST_SLIDERS, len(model.variances))
        held = 100 * curves.compactness[shown - 1]
        mean = stand_upright(Shape(model.mean), self.settings.template_up).points
        offsets = [
            stand_upright(Shape(offset), self.settings.template_up).points
            for offset in model.modes[:shown] * model.deviations[:shown, None, None]
        ]
        return ModesScene(
            title=f"Modes of {self.folder.root.resolve().name}",
            summary=f"{len(self.names):,} shapes vary in {len(model.variances):,} modes; those below hold {held:.3g} % "
            "of the variance.",
            mean=mean,
            faces=self.template.faces,
            colours=self._colours,
            offsets=np.stack(offsets),
            shares=model.variances[:shown] / model.variances.sum(),
            names=self.names,
            coefficients=model.coefficients(self.aligned.points)[:, :shown],
        )

    # ---- the report

    def _report(self) -> dict[str, Any]:
        failed = {outcome.subject.name: outcome.error for outcome in self.outcomes if outcome.figures is None}
        doubtful = {outcome.subject.name: list(outcome.warnings) for outcome in self.placed if outcome.warnings}
        others = self.folder.others([outcome.subject for outcome in self.outcomes])
        return {
            "template": {"points": self.template.n_points, "faces": self.template.n_faces},
            "shapes": self.names,
            "not_placed": failed,
            "doubtful": doubtful,
            "placed_before_and_not_given_now": others,
            "statistics": asdict(self.settings),
            "modes": 0 if self.model is None else len(self.model.variances),
            "variance": None if self.model is None else float(self.model.variances.sum()),
        }


def _badness(outcome: Outcome) -> tuple[bool, float]:
    assert outcome.figures is not None
    return not outcome.warnings, outcome.figures.confidence


def _files_of(root: Path) -> set[str]:
    """What an earlier delivery to a folder says that it wrote; nothing else, as reports may come from anywhere."""
    told = (read_json(root / REPORT, needs="files") or {}).get("files")
    names = [name for name in told if isinstance(name, str)] if isinstance(told, list) else []
    ours = (root / place for place in _PLACES)
    places = tuple(place.resolve() for place in ours)
    return {name for name in names if any((root / name).resolve().is_relative_to(place) for place in places)}
