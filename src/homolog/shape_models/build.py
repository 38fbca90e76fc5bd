"""Building a shape model in one call: registration of the template to all shapes, statistics and exports."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from homolog.core.choices import System
from homolog.core.cluster import Processes
from homolog.core.errors import ArgumentError
from homolog.core.files import expanded, refuse_overwriting_inputs, resolved
from homolog.core.progress import Progress, ignore
from homolog.core.versions import versions
from homolog.matching import Matcher
from homolog.shape_models.adaptation import not_adapted_warnings
from homolog.shape_models.asymmetry import TemplateSymmetry
from homolog.shape_models.batch import register_all, settings_record
from homolog.shape_models.folder import Outcome, ShapeModelFolder
from homolog.shape_models.landmarks import TemplateLandmarks
from homolog.shape_models.outputs import OUTPUT_NAMES, REPORT, check_extra, write_outputs
from homolog.shape_models.registered_shapes import ModelSettings
from homolog.shape_models.registration import check_template
from homolog.shape_models.settings import ShapeModelSettings
from homolog.shape_models.subjects import Subject, subjects_of
from homolog.shapes import read_hashed_shape


@dataclass(frozen=True)
class BuiltModel:
    """The result of ``build``.

    Args:
        folder: with all files.
        outcomes: of each shape, in the given order.
        files: the files and folders to look at.
        warnings: that hold for the collection as a whole.
    """

    folder: ShapeModelFolder
    outcomes: list[Outcome]
    files: list[Path]
    warnings: tuple[str, ...] = ()


def build(
    template: str | Path,
    files: Sequence[str | Path],
    output: str | Path,
    make_matcher: Matcher | Callable[[], Matcher],
    *,
    settings: ShapeModelSettings | None = None,
    model: ModelSettings | None = None,
    landmarks: str | Path | None = None,
    axes: System | None = None,
    symmetry: str | Path | None = None,
    masks: str | Path | None = None,
    processes: Processes = 1,
    progress: Progress = ignore,
    listener: Callable[[Outcome], None] = ignore,
    report: Mapping[str, Any] | None = None,
) -> BuiltModel:
    """Register a template to many shapes, and build their shape model: mean, principal modes, curves and exports.

    The same call resumes a folder that was interrupted, and does shapes anew whose files changed; further shapes can be
    added. A shape that cannot be registered does not stop the others.

    Args:
        template: file of the shape whose points and faces all others get.
        files: the shapes, meshes or clouds.
        output: a new folder, or one that was begun with the same template, matcher and settings.
        make_matcher: the matcher; for several processes, a function that returns it and can be pickled.
        settings: of the registration.
        model: settings of the statistics.
        landmarks: a file of landmarks on the template, which are carried to all shapes; see
            ``homolog.transfer.read_landmarks``.
        axes: the anatomical axes of all shapes, for landmark files that state theirs; by default those that the shapes'
            files name, or LPS.
        symmetry: a folder that ``homolog.symmetries.write_symmetry`` or ``homolog symmetry`` wrote of the template, to
            take all shapes apart into symmetric and asymmetric components.
        masks: a folder with a mask for some of the shapes, named as they are; see ``homolog.pairs.read_mask``. Points
            with 0 are not matched. That of the template is ``settings.template_mask``.
        processes: number of worker processes, or a cluster.
        progress: called with the number of finished shapes, their total and the current shape's name.
        listener: called with each new outcome.
        report: further entries of ``report.json``.

    Raises:
        ArgumentError: if an input lies in ``output``, two shapes have the same name, or ``output`` holds other files.
        ShapeError: if the template cannot be used.
        DataError: if no shape could be registered.
        MissingExtraError: without the extra ``collection``.

    Examples:
        >>> matcher = homolog.Matcher.from_weights("people")  # doctest: +SKIP
        >>> built = build("template.ply", ["scans/anna.ply", "scans/ben.ply"], "model", matcher)  # doctest: +SKIP
        >>> np.load(built.folder.root / "points.npy").shape  # doctest: +SKIP
        (2, 5000, 3)
    """
    check_extra()
    subjects, settings = subjects_of(files, masks), settings or ShapeModelSettings()
    root, mask = expanded(output), settings.template_mask
    inputs = (template, *files, *(extra for extra in (landmarks, symmetry, masks) if extra is not None))
    refuse_inputs_inside(root, inputs)
    base, digest = read_hashed_shape(template)
    check_template(base)
    if mask is not None:
        mask.check_fits(base)
    kept = None if mask is None else mask.kept
    carried = None if landmarks is None else TemplateLandmarks(landmarks, base, axes, kept)
    mirrored = None if symmetry is None else TemplateSymmetry(symmetry, base)
    refuse_overwriting_inputs(_outputs(root, subjects, carried), inputs)
    if isinstance(make_matcher, Matcher):
        if processes != 1:
            raise ArgumentError("several processes need a function that makes the matcher; give one, or processes=1")
        matcher = make_matcher
    else:
        matcher = make_matcher()
    in_each = make_matcher if processes != 1 and not isinstance(make_matcher, Matcher) else lambda: matcher
    with ShapeModelFolder.opened(root, settings_record(digest, matcher, settings)) as folder:
        outcomes = register_all(
            base, subjects, folder, in_each, settings, processes=processes, progress=progress, listener=listener
        )
        progress(len(subjects), len(subjects), "mean and modes")
        told = {"inputs": {"template": str(template), "sha256": digest}, "versions": versions(), **(report or {})}
        written = write_outputs(
            folder, base, outcomes, model, landmarks=carried, symmetry=mirrored, mask=mask, report=told
        )
    warnings = () if carried is None else carried.warnings
    return BuiltModel(folder, outcomes, written, (*warnings, *not_adapted_warnings(folder, settings)))


def _outputs(root: Path, subjects: Sequence[Subject], landmarks: TemplateLandmarks | None) -> list[Path]:
    """The files that are written for sure."""
    names = [*OUTPUT_NAMES, REPORT, *(f"shapes/{subject.name}.ply" for subject in subjects)]
    carried = [] if landmarks is None else [landmarks.file_of(subject.name) for subject in subjects]
    return [root / name for name in (*names, *carried)]


def refuse_inputs_inside(output: Path, inputs: Sequence[str | Path]) -> None:
    """Refuse inputs in the output folder, where files are replaced, and removed when they are no longer made.

    Raises:
        ArgumentError: naming the first one.
    """
    folder = resolved(output)
    for path in inputs:
        if resolved(path).is_relative_to(folder):
            raise ArgumentError(f"{path} lies in {output}, where the result is written; give another -o, or move it")
