"""Making a dataset of synthetic people, each body independently of the others."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path

from homolog.core.arguments import check_count
from homolog.core.progress import Progress, ignore
from homolog.core.tasks import run_tasks
from homolog.geometry.surface import BarycentricPoints
from homolog.synthesis.body_model import BodyModel
from homolog.synthesis.people import PeopleSettings, make_person
from homolog.synthesis.people_folder import PeopleFolder
from homolog.synthesis.template import sample_evenly

TEMPLATE_POINTS = 5000
"""The number of template points that carry the ground truth."""


def synthesize_people(
    output: str | Path,
    n: int,
    settings: PeopleSettings | None = None,
    *,
    processes: int = 1,
    progress: Progress = ignore,
) -> PeopleFolder:
    """Write a dataset of synthetic people: the first ``n`` bodies of an endless sequence, as far as they are missing.

    Args:
        output: the folder; it may hold bodies made with the same settings, which are kept.
        n: number of bodies.
        settings: seed and meshing.
        processes: number of worker processes; the bodies do not depend on it.
        progress: called with the number of finished bodies, their total and the current body's name.

    Returns:
        The folder, which ``ShapeFolder`` reads.

    Raises:
        ArgumentError: if an argument is out of range, or the folder holds something else or cannot be written to.
        MissingExtraError: if the package anny is not installed.

    Examples:
        >>> synthesize_people("people", 500, PeopleSettings(seed=1), processes=4)  # doctest: +SKIP
    """
    check_count("n", n)
    check_count("processes", processes)
    settings = settings or PeopleSettings()
    template = _body_model().template
    folder = PeopleFolder.prepare(output, settings)
    names = [folder.name(index) for index in range(n)]
    progress(0, n, "checking the existing files")
    missing = [index for index, name in enumerate(names) if not folder.has_all_files(name)]
    if missing or not folder.has_template():
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
    while folder.has_all_files(folder.name(len(names))):  # of a larger dataset that was made before
        names.append(folder.name(len(names)))
    folder.write_manifest(settings, names)
    return folder


@dataclass(frozen=True)
class _Making:
    """Makes and writes the body with a given number; picklable, for worker processes."""

    points: BarycentricPoints
    settings: PeopleSettings
    folder: PeopleFolder

    def __call__(self, index: int) -> None:
        person = make_person(_body_model(), self.points, self.settings, index)
        self.folder.write_person(self.folder.name(index), person)


@cache
def _body_model() -> BodyModel:
    """The body model of this process; loading it takes seconds."""
    return BodyModel()
