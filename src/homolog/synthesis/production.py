"""Making a set of people, each body on its own."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path

from homolog.core.arguments import check_count
from homolog.core.progress import Progress, no_progress
from homolog.core.tasks import run_tasks
from homolog.geometry.surface import Places
from homolog.synthesis.body_model import BodyModel
from homolog.synthesis.people import PeopleSettings, make_person
from homolog.synthesis.people_folder import PeopleFolder
from homolog.synthesis.template import sample_evenly

TEMPLATE_POINTS = 5000
"""How many points of the template carry the ground truth."""


def synthesize_people(
    output: str | Path,
    n: int,
    settings: PeopleSettings | None = None,
    *,
    processes: int = 1,
    progress: Progress = no_progress,
) -> PeopleFolder:
    """Make the first ``n`` bodies of an endless set, or those of them that are not there yet.

    Args:
        output: the folder; it may hold bodies made with the same settings, which are kept.
        n: how many bodies.
        settings: seed and meshing.
        processes: how many work at once; the bodies are the same for any number.
        progress: told of each body.

    Returns:
        The folder, which ``ShapeFolder`` reads.

    Raises:
        ArgumentError: if an argument is out of range, or the folder holds something else or cannot be written to.
        MissingExtraError: if the package anny is not installed.
    """
    check_count("n", n)
    check_count("processes", processes)
    settings = settings or PeopleSettings()
    template = _body_model().template
    folder = PeopleFolder.prepare(output, settings)
    names = [folder.name(index) for index in range(n)]
    progress(0, n, "looking at what is there")
    missing = [index for index, name in enumerate(names) if not folder.is_whole(name)]
    points = sample_evenly(template.rest, TEMPLATE_POINTS)
    folder.write_template(template.rest, points)
    if missing:
        make = _Making(points, settings, folder)
        tasks = [(names[index], partial(make, index)) for index in missing]
        there = n - len(missing)
        run_tasks(
            [tasks],
            processes=min(processes, len(missing)),
            progress=lambda done, _, what: progress(there + done, n, what),
        )
    while folder.is_whole(folder.name(len(names))):  # of a larger set that was made before
        names.append(folder.name(len(names)))
    folder.write_manifest(settings, names)
    return folder


@dataclass(frozen=True)
class _Making:
    """What all bodies of a set have in common; called with a body's number, it makes and writes that body."""

    points: Places
    settings: PeopleSettings
    folder: PeopleFolder

    def __call__(self, index: int) -> None:
        person = make_person(_body_model(), self.points, self.settings, index)
        self.folder.write_person(self.folder.name(index), person)


@cache
def _body_model() -> BodyModel:
    """The one of this process, which takes seconds to open."""
    return BodyModel()
