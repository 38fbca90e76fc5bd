"""Making a set of people: several processes, each body on its own."""

from __future__ import annotations

import signal
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

import torch

from homolog.arguments import check_count
from homolog.errors import ArgumentError
from homolog.steps import Progress, unheard
from homolog.synthesis.body_model import BodyModel
from homolog.synthesis.people import Bodies, PeopleSettings, make_person
from homolog.synthesis.people_folder import PeopleFolder
from homolog.synthesis.surface import Places
from homolog.synthesis.template import sample_evenly

TEMPLATE_POINTS = 5000
"""How many points of the template carry the ground truth."""


@dataclass(frozen=True)
class _Workshop:
    """What a process needs to make bodies."""

    bodies: Bodies
    points: Places
    settings: PeopleSettings
    folder: PeopleFolder

    def make(self, index: int) -> None:
        person = make_person(self.bodies, self.points, self.settings, index)
        self.folder.write_person(self.folder.name(index), person)


def synthesize_people(
    out: str | Path,
    n: int,
    settings: PeopleSettings | None = None,
    *,
    processes: int = 1,
    progress: Progress = unheard,
) -> PeopleFolder:
    """Make the first ``n`` bodies of an endless set, or those of them that are not there yet.

    Bodies are made in processes of their own, which begin by importing the program that calls this: a script must call
    it below ``if __name__ == "__main__":``.

    Args:
        out: the folder; it may hold bodies made with the same settings, which are kept.
        n: how many bodies.
        settings: seed and meshing.
        processes: how many work at once; the bodies are the same for any number.
        progress: told of each body.

    Returns:
        The folder, which ``ShapeFolder`` reads.

    Raises:
        ArgumentError: if an argument is out of range, or the folder cannot be written to.
        DataError: if the folder holds something else.
        MissingExtraError: if the package anny is not installed.
    """
    check_count("n", n)
    check_count("processes", processes)
    settings = settings or PeopleSettings()
    bodies = BodyModel()
    folder = PeopleFolder.prepare(out, settings)
    names = tuple(folder.name(index) for index in range(n))
    progress(0, n, "looking at what is there")
    missing = [index for index, name in enumerate(names) if not folder.is_whole(name)]
    if missing:
        points = sample_evenly(bodies.template.rest, TEMPLATE_POINTS)
        folder.write_template(bodies.template.rest, points)
        for done, name in enumerate(_made(missing, points, settings, folder, processes), n - len(missing) + 1):
            progress(done, n, name)
    folder.write_manifest(settings, names)
    return folder


def _made(
    missing: list[int], points: Places, settings: PeopleSettings, folder: PeopleFolder, processes: int
) -> Iterator[str]:
    """Make bodies, and give the name of each that is done."""
    with _pool(min(processes, len(missing)), points, settings, folder) as pool:
        waiting = {pool.submit(_make, index): folder.name(index) for index in missing}
        for future in _as_done(waiting):
            yield waiting[future]


def _as_done(waiting: Iterable[Future[None]]) -> Iterator[Future[None]]:
    for future in as_completed(waiting):
        try:
            future.result()
        except BrokenProcessPool:
            raise ArgumentError(
                "a process was ended from outside, perhaps for want of memory; run the same command again, "
                "with fewer --processes"
            ) from None
        yield future


@contextmanager
def _pool(
    processes: int, points: Places, settings: PeopleSettings, folder: PeopleFolder
) -> Iterator[ProcessPoolExecutor]:
    """Processes that end with the block, whatever ends it: bodies not yet begun are given up."""
    # Started anew rather than forked: PyTorch's threads do not survive a fork.
    pool = ProcessPoolExecutor(processes, get_context("spawn"), _open_workshop, (points, settings, folder))
    try:
        yield pool
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


# What this process makes bodies with, once it is one of those that do.
_workshops: list[_Workshop] = []


def _open_workshop(points: Places, settings: PeopleSettings, folder: PeopleFolder) -> None:
    # Ctrl-C reaches all processes of a terminal; the first one tells the others to end.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    torch.set_num_threads(1)
    _workshops.append(_Workshop(BodyModel(), points, settings, folder))


def _make(index: int) -> None:
    _workshops[0].make(index)
