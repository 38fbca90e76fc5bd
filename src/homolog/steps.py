"""Time and memory of each step of a longer computation."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import psutil

Listener = Callable[[str], None]


@dataclass(frozen=True)
class Step:
    """One finished step: its name, seconds of wall time, and the process' peak memory by its end, in MB."""

    name: str
    seconds: float
    peak_mb: float


@dataclass
class Steps:
    """Collects steps as they finish; ``listener`` is told each step's name as it begins."""

    listener: Listener | None = None
    finished: list[Step] = field(default_factory=list)

    @contextmanager
    def step(self, name: str) -> Iterator[None]:
        """Measure a ``with`` block as one step."""
        if self.listener is not None:
            self.listener(name)
        began = time.perf_counter()
        yield
        self.finished.append(Step(name, time.perf_counter() - began, peak_memory_mb()))


def peak_memory_mb() -> float:
    """The most memory this process has held, in MB (2^20 bytes)."""
    if sys.platform == "win32":
        return float(psutil.Process().memory_info().peak_wset) / 2**20
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / 2**20 if sys.platform == "darwin" else peak / 2**10
