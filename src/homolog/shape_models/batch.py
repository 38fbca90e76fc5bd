"""Registration of a template to many shapes, one after another or in several processes."""

from __future__ import annotations

import hashlib
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

from homolog.core.cluster import Processes
from homolog.core.errors import HomologError
from homolog.core.progress import Progress, Timings, ignore
from homolog.core.tasks import check_processes, run_tasks
from homolog.features import load_weights
from homolog.matching import Matcher, with_inputs
from homolog.pairs import Side
from homolog.shape_models.adaptation import adapted_weights
from homolog.shape_models.choice import choice_for_all
from homolog.shape_models.folder import Outcome, ShapeModelFolder
from homolog.shape_models.registration import Template
from homolog.shape_models.settings import ShapeModelSettings
from homolog.shape_models.subjects import Subject
from homolog.shapes import Shape, read_hashed_shape


def settings_record(template_sha256: str, matcher: Matcher, settings: ShapeModelSettings) -> dict[str, Any]:
    """All that the registered points depend on besides the shapes, for ``ShapeModelFolder.prepare``.

    Args:
        template_sha256: hash of the template's file.
        matcher: that registers the template.
        settings: of the registration.
    """
    mask = settings.template_mask
    masked = {} if mask is None else {"mask_sha256": hashlib.sha256(mask.weights.tobytes()).hexdigest()}
    return {
        "template": {"sha256": template_sha256, **masked},
        "matching": settings.to_dict(),
        **{name: value for name, value in matcher.describe().items() if name != "device"},
    }


def register_all(
    template: Shape,
    subjects: Sequence[Subject],
    folder: ShapeModelFolder,
    make_matcher: Callable[[], Matcher],
    settings: ShapeModelSettings | None = None,
    *,
    processes: Processes = 1,
    progress: Progress = ignore,
    listener: Callable[[Outcome], None] = ignore,
) -> list[Outcome]:
    """Register a template to all shapes that are not registered yet; failures do not stop the others.

    Where the matcher has a choice of features, it is made once for all shapes, see ``choice_for_all``, and kept in the
    folder: shapes that come later are matched alike.

    Several processes begin by importing the program that calls this: a script must call it below
    ``if __name__ == "__main__":``.

    Args:
        template: as it was read, with the hash that ``folder`` was begun with.
        subjects: the shapes.
        folder: of the results; stored results for unchanged files are kept.
        make_matcher: returns the matcher in each process; for several processes, a function that can be pickled.
        settings: of the registration.
        processes: number of worker processes, or a cluster; the points depend on it only by rounding.
        progress: called with the number of finished shapes, their total and the current shape's name.
        listener: called with each new outcome, in this process.

    Returns:
        The outcome of each shape, in their order.

    Raises:
        ArgumentError: if the number of processes is not positive, or one is ended from outside.
        HomologError: if the template cannot be used.
    """
    check_processes(processes)
    _prepared_template.cache_clear()  # an earlier call may have had another template or matcher
    stored = {subject.name: _stored_outcome(folder, subject) for subject in subjects}
    missing = [subject for subject in subjects if stored[subject.name] is None]
    found: dict[str, Outcome] = {name: outcome for name, outcome in stored.items() if outcome is not None}

    def take(outcome: Outcome) -> None:
        found[outcome.subject.name] = outcome
        listener(outcome)

    settings = settings or ShapeModelSettings()
    choice = folder.choice()
    if choice is None and missing:
        matcher = make_matcher()
        choice = choice_for_all(template, missing, matcher, settings, progress=progress)
        if choice or not matcher.feature_choice.is_open:  # where no shape could be used, those that come later decide
            folder.keep_choice(choice)
    name = choice[0].name if choice else None
    weights = None
    if settings.adapt and missing:
        chosen = _limited(make_matcher(), name)
        weights = adapted_weights(template, missing, folder, chosen, settings, progress=progress)
    registration = _Registration(template, make_matcher, name, weights, folder, settings)
    before, register = len(subjects) - len(missing), registration.outcome
    run_tasks(
        [[(subject.name, partial(register, subject)) for subject in missing]],
        processes=processes,
        progress=lambda done, _, what: progress(before + done, len(subjects), what),
        told=take,
        reads=sorted({subject.file.parent for subject in missing}),
        writes=folder.root,
    )
    return [found[subject.name] for subject in subjects]


def _stored_outcome(folder: ShapeModelFolder, subject: Subject) -> Outcome | None:
    try:
        return folder.outcome(subject)
    except HomologError:  # the same error is reported once the shape is processed
        return None


@dataclass(frozen=True)
class _Registration:
    """What all shapes have in common; picklable, for worker processes."""

    # Both are copies in every process; the folder ensures that they are equal.
    template: Shape = field(compare=False)
    make_matcher: Callable[[], Matcher] = field(compare=False)
    choice: str | None
    weights: Path | None
    folder: ShapeModelFolder
    settings: ShapeModelSettings

    def outcome(self, subject: Subject) -> Outcome:
        """Register the template to one shape, and write the result."""
        template, began = _prepared_template(self), time.perf_counter()
        try:
            return self._registered(subject, template, began)
        except Exception as error:  # whatever it is, the other shapes are still to be done
            # The result for a file that is missing is kept: it may be on a disk that is not mounted now.
            if os.path.exists(subject.file):  # noqa: PTH110 - Path.exists raises where a folder may not be read
                self.folder.forget(subject)
            return Outcome(subject, None, error=_in_a_line(subject, error), seconds=time.perf_counter() - began)

    def _registered(self, subject: Subject, template: Template, began: float) -> Outcome:
        settings = self.settings
        shape, digest = read_hashed_shape(subject.file)
        registered = template.registered_to(
            shape,
            up=settings.shapes_up,
            as_cloud=settings.shapes_as_cloud,
            strict=settings.strict,
            mask=subject.mask(),
        )
        files: dict[Side, dict[str, str]] = {"source": {}, "target": {"file": str(subject.file), "sha256": digest}}
        assert registered.match is not None
        registered = replace(registered, match=with_inputs(registered.match, files, Timings()))
        seconds = time.perf_counter() - began
        outcome = Outcome(
            subject, registered.figures, registered.warnings, seconds=seconds, matched_by=registered.matched_by
        )
        mask = settings.template_mask
        weights = None if mask is None else mask.weights
        self.folder.write(outcome, registered, template.projector.given, digest, weights)
        return outcome


@lru_cache(maxsize=1)
def _prepared_template(registration: _Registration) -> Template:
    """The template of this process, which is prepared once."""
    settings, matcher = registration.settings, _limited(registration.make_matcher(), registration.choice)
    weights = registration.weights
    return Template(
        registration.template,
        matcher,
        adapted=None if weights is None else matcher.with_extractor(load_weights(weights)),
        up=settings.template_up,
        as_cloud=settings.template_as_cloud,
        orient=settings.orient,
        clutter=settings.clutter,
        proxy=settings.proxy,
        mask=settings.template_mask,
    )


def _limited(matcher: Matcher, choice: str | None) -> Matcher:
    return matcher if choice is None else matcher.limited_to(choice)


def _in_a_line(subject: Subject, error: Exception) -> str:
    message = " ".join(str(error).split()) or type(error).__name__
    if isinstance(error, HomologError):
        return message
    return f"{subject.file} could not be matched ({type(error).__name__}: {message[:200]})"
