"""Time and memory of each step of a longer computation."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import psutil

Listener = Callable[[str], None]

# Called with the number of finished steps, their total and the name of the current one.
Progress = Callable[[int, int, str], None]


def ignore(*_: object) -> None:
    """A callback that does nothing: the default for progress and results that nobody listens to."""


@dataclass(frozen=True)
class Timing:
    """Time and memory of one step.

    Args:
        name: what was done.
        seconds: of wall time.
        process_peak_mb: the most memory that the process has held from its start to the end of this step, in MB (2^20
            bytes); it never falls from step to step, and only where it rises has a step needed more than all before.
    """

    name: str
    seconds: float
    process_peak_mb: float


@dataclass
class Timings:
    """Collects the timing of each step as it ends; ``listener`` is told each step's name as it begins."""

    listener: Listener | None = None
    finished: list[Timing] = field(default_factory=list)

    def branch(self) -> Timings:
        """The same steps so far, to which other ones are added."""
        return Timings(self.listener, [*self.finished])

    @contextmanager
    def measure(self, name: str) -> Iterator[None]:
        """Measure a ``with`` block as one step."""
        if self.listener is not None:
            self.listener(name)
        began = time.perf_counter()
        yield
        self.finished.append(Timing(name, time.perf_counter() - began, peak_memory_mb()))


def peak_memory_mb() -> float:
    """The most memory this process has held, in MB (2^20 bytes)."""
    if sys.platform == "win32":
        return float(psutil.Process().memory_info().peak_wset) / 2**20
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / 2**20 if sys.platform == "darwin" else peak / 2**10
