"""Placing a template's points on every shape of a collection, one after another or in several processes."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from functools import lru_cache
from typing import Any

from homolog.core.arguments import check_count
from homolog.core.errors import HomologError
from homolog.core.progress import Progress, ignore
from homolog.core.tasks import run_tasks
from homolog.matching import Matcher
from homolog.shape_models.folder import CollectionFolder, Outcome
from homolog.shape_models.registering import Template
from homolog.shape_models.subjects import Subject
from homolog.shapes import Shape, Up, read_hashed_shape


@dataclass(frozen=True)
class CollectionSettings:
    """How shapes are matched to the template, besides the matcher.

    Args:
        template_up: which axis of the template points up.
        shapes_up: which axis of the shapes.
        template_as_cloud: match without the template's faces.
        shapes_as_cloud: match without the shapes' faces.
        strict: refuse shapes with anything to repair or to warn of.
    """

    template_up: Up = "y"
    shapes_up: Up = "y"
    template_as_cloud: bool = False
    shapes_as_cloud: bool = False
    strict: bool = False


def making(template_sha256: str, matcher: Matcher, settings: CollectionSettings) -> dict[str, Any]:
    """All that the points on a shape depend on, besides that shape; for ``CollectionFolder.prepare``.

    Args:
        template_sha256: hash of the template's file.
        matcher: what matches.
        settings: how.
    """
    return {
        "template": {"sha256": template_sha256},
        "matching": asdict(settings),
        "method": matcher.describe()["settings"]["method"],
        "features": matcher.describe()["features"],
        "settings": matcher.describe()["settings"],
    }


def collect(
    template: Shape,
    subjects: Sequence[Subject],
    folder: CollectionFolder,
    make_matcher: Callable[[], Matcher],
    settings: CollectionSettings | None = None,
    *,
    processes: int = 1,
    progress: Progress = ignore,
    told: Callable[[Outcome], None] = ignore,
) -> list[Outcome]:
    """Place the template's points on all shapes that do not have them yet; one that fails does not stop the others.

    Several processes begin by importing the program that calls this: a script must call it below
    ``if __name__ == "__main__":``.

    Args:
        template: as it was read, with the hash that ``folder`` was begun with.
        subjects: the shapes.
        folder: where to; what is there of the same files is kept.
        make_matcher: gives the matcher in each process; of several processes, a function that can be pickled.
        settings: how.
        processes: how many work at once; the points are the same for any number, but for rounding.
        progress: told of each shape before it is waited for.
        told: each new outcome, in this process.

    Returns:
        What became of each shape, in their order.

    Raises:
        ArgumentError: if the number of processes is none, or one is ended from outside.
        HomologError: if the template cannot be used.
    """
    check_count("processes", processes)
    _prepared.cache_clear()  # an earlier collection's template or matcher may have been others
    known = {subject.name: _known(folder, subject) for subject in subjects}
    missing = [subject for subject in subjects if known[subject.name] is None]
    found: dict[str, Outcome] = {name: outcome for name, outcome in known.items() if outcome is not None}

    def hear(outcome: Outcome) -> None:
        found[outcome.subject.name] = outcome
        told(outcome)

    processes = min(processes, max(1, len(missing)))
    place = _Placing(template, make_matcher, folder, settings or CollectionSettings(), processes)
    there = len(subjects) - len(missing)
    run_tasks(
        [[(subject.name, _Task(place, subject)) for subject in missing]],
        processes=processes,
        progress=lambda done, _, what: progress(there + done, len(subjects), what),
        told=hear,
    )
    return [found[subject.name] for subject in subjects]


def _known(folder: CollectionFolder, subject: Subject) -> Outcome | None:
    """What was made of a shape before, if it still holds."""
    try:
        return folder.outcome(subject)
    except HomologError:  # what is wrong with the file is told when its turn comes
        return None


@dataclass(frozen=True)
class _Placing:
    """What all shapes of a collection have in common."""

    # Both are others each time that they come from another process; the folder vouches that they mean the same.
    template: Shape = field(compare=False)
    make_matcher: Callable[[], Matcher] = field(compare=False)
    folder: CollectionFolder
    settings: CollectionSettings
    processes: int

    def outcome(self, subject: Subject) -> Outcome:
        """Match one shape, and write what came of it."""
        template, began = _prepared(self), time.perf_counter()
        try:
            return self._placed(subject, template, began)
        except Exception as error:  # whatever it is, the other shapes are still to be done
            # What a file that is away gave before may hold once its disk is back, and took long to make.
            if os.path.exists(subject.file):  # noqa: PTH110 - Path.exists raises where a folder may not be read
                self.folder.forget(subject)
            return Outcome(subject, None, error=_in_a_line(subject, error), seconds=time.perf_counter() - began)

    def _placed(self, subject: Subject, template: Template, began: float) -> Outcome:
        settings = self.settings
        shape, digest = read_hashed_shape(subject.file)
        placed = template.registered_to(
            shape, up=settings.shapes_up, as_cloud=settings.shapes_as_cloud, strict=settings.strict
        )
        outcome = Outcome(subject, placed.figures, placed.warnings, seconds=time.perf_counter() - began)
        self.folder.write(outcome, placed, template.projector.given, digest)
        return outcome


@dataclass(frozen=True)
class _Task:
    """One shape to place; called in any process."""

    placing: _Placing
    subject: Subject

    def __call__(self) -> Outcome:
        return self.placing.outcome(self.subject)


@lru_cache(maxsize=1)
def _prepared(placing: _Placing) -> Template:
    """The template of this process, made ready once."""
    if placing.processes > 1:
        _share_cores(placing.processes)
    settings = placing.settings
    return Template(
        placing.template,
        placing.make_matcher(),
        up=settings.template_up,
        as_cloud=settings.template_as_cloud,
    )


def _share_cores(processes: int) -> None:
    """Leave cores to the other processes: threads that wait for each other are slow."""
    import torch

    torch.set_num_threads(max(1, (os.cpu_count() or 1) // processes))


def _in_a_line(subject: Subject, error: Exception) -> str:
    said = " ".join(str(error).split()) or type(error).__name__
    if isinstance(error, HomologError):
        return said
    return f"{subject.file} could not be matched ({type(error).__name__}: {said[:200]})"
