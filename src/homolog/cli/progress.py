"""What a command writes on stderr while it works: a progress bar or lines, or JSON for the program that runs it."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from datetime import timedelta
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, Protocol

import typer

if TYPE_CHECKING:  # help and mistakes in arguments do without
    from rich.console import Console

# Between lines where there is no terminal to show a bar.
_SECONDS_PER_LINE = 30.0


ProgressFormat = Literal["bar", "json"]
ProgressOption = Annotated[
    ProgressFormat, typer.Option("--progress", hidden=True, help="json: one JSON object a line, for other programs.")
]


class Report(Protocol):
    """Told how many steps are done of how many, and what comes next."""

    def __call__(self, done: int, total: int, what: str) -> None:
        """Show the state."""


@cache
def stderr_console() -> Console:
    """The one console on stderr: only it can print while it shows a bar without tearing that."""
    from rich.console import Console

    return Console(stderr=True, highlight=False)


def say(line: str) -> None:
    """Print a line on stderr, above the bar if there is one."""
    console = stderr_console()
    # A line that is longer than the terminal would make the bar below it too long as well.
    console.print(line, markup=False, soft_wrap=not console.is_terminal)


class MayHaveFailed(Protocol):
    """What came of one of several inputs."""

    @property
    def error(self) -> str:
        """Why there is no result; empty where there is one."""


def say_error(found: MayHaveFailed) -> None:
    """Print why an input has no result, if it has none."""
    if found.error:
        say(f"Error: {found.error}")


def tell_files(paths: Iterable[Path], notes: Iterable[str] = ()) -> None:
    """Print what is to be noted of a result on stderr, and its files on stdout, a line each."""
    for note in notes:
        say(note)
    for path in paths:
        typer.echo(path)


class Lines:
    """Progress as lines for a log, at most one in half a minute.

    Args:
        clock: gives the time in seconds.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._total, self._first = 0, 0
        self._begun = self._said = clock()

    def __call__(self, done: int, total: int, what: str) -> None:
        """Say how far it is, if the last time is long ago."""
        now = self._clock()
        if total != self._total:  # another part of the work, of another speed
            self._total, self._first, self._begun = total, done, now
        if now - self._said >= _SECONDS_PER_LINE:
            self._said = now
            say(f"{what}: {done} of {total}{self._left(done, now)}")

    def _left(self, done: int, now: float) -> str:
        if done <= self._first:
            return ""
        seconds = (now - self._begun) / (done - self._first) * (self._total - done)
        return f", about {timedelta(seconds=round(seconds))} left"


class JsonProgress:
    """Progress as one JSON object a line: ``{"step": "read source", "side": "source", "done": 0, "total": 11}``.

    ``side`` is the shape that the step is about, or null. With ``--progress=json`` an error is ``{"error": "..."}``.
    """

    def __call__(self, done: int, total: int, what: str) -> None:
        """Write the state."""
        last = what.rpartition(" ")[2]
        message = {"step": what, "side": last if last in ("source", "target") else None, "done": done, "total": total}
        print(json.dumps(message), file=sys.stderr, flush=True)


@contextmanager
def progress_bar(*, quiet: bool, form: ProgressFormat = "bar") -> Iterator[Report]:
    """A bar with the time left, on stderr; now and then a line where that is no terminal; silent if ``quiet``.

    With the form ``"json"`` it is a ``JsonProgress``, quiet or not.
    """
    if form == "json":
        yield JsonProgress()
    elif quiet:
        yield lambda done, total, what: None
    elif stderr_console().is_terminal:
        with _bar() as report:
            yield report
    else:
        yield Lines()


@contextmanager
def _bar() -> Iterator[Report]:
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=stderr_console(), transient=True) as progress:
        task = progress.add_task("starting", total=None)

        def report(done: int, total: int, what: str) -> None:
            progress.update(task, completed=done, total=total, description=what)

        yield report
