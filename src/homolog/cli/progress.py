"""What is said on stderr while a command works: progress, where that is a terminal, and lines above it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Protocol

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn


class Report(Protocol):
    """Told how many steps are done of how many, and what comes next."""

    def __call__(self, done: int, total: int, what: str) -> None:
        """Show the state."""


@cache
def stderr_console() -> Console:
    """The one console on stderr: only it can print while it shows a bar without tearing that."""
    return Console(stderr=True, highlight=False)


def say(line: str) -> None:
    """Print a line on stderr, above the bar if there is one."""
    console = stderr_console()
    # A line that is longer than the terminal would make the bar below it too long as well.
    console.print(line, markup=False, soft_wrap=not console.is_terminal)


@contextmanager
def progress_bar(*, quiet: bool) -> Iterator[Report]:
    """A bar with the time left, on stderr; silent if ``quiet`` or if stderr is no terminal."""
    console = stderr_console()
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    disabled = quiet or not console.is_terminal
    with Progress(*columns, console=console, transient=True, disable=disabled) as progress:
        task = progress.add_task("starting", total=None)

        def report(done: int, total: int, what: str) -> None:
            progress.update(task, completed=done, total=total, description=what)

        yield report
