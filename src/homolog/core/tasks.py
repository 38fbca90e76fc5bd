"""Running many tasks, one by one or in several processes."""

from __future__ import annotations

import itertools
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import get_context
from typing import TypeVar

from homolog.core.errors import ArgumentError
from homolog.core.progress import Progress, ignore

T = TypeVar("T")

# A name to show, and what to do; several processes need functions and results that can be pickled.
Task = tuple[str, Callable[[], T]]


def run_tasks(
    phases: Sequence[Sequence[Task[T]]],
    *,
    processes: int,
    progress: Progress,
    told: Callable[[T], None] = ignore,
) -> None:
    """Run all tasks of a phase, in any order, before those of the next phase.

    On an error or an interrupt no further task begins. One process is this one; several begin by importing the program
    that calls this, so that a script must call it below ``if __name__ == "__main__":``.

    Args:
        phases: the tasks.
        processes: how many work at once.
        progress: told of each task before it is waited for.
        told: what each task gives, in this process and in the order of the tasks.

    Raises:
        ArgumentError: if one of several processes is ended from outside.
    """
    names = [name for tasks in phases for name, _ in tasks]
    functions = [[function for _, function in tasks] for tasks in phases]
    done = itertools.chain.from_iterable(map(_each, functions)) if processes == 1 else _shared(functions, processes)
    for number, name in enumerate(names):
        progress(number, len(names), name)
        told(next(done))
    progress(len(names), len(names), "done")


def _each(functions: Sequence[Callable[[], T]]) -> Iterator[T]:
    return map(_call, functions)


def _shared(phases: Sequence[Sequence[Callable[[], T]]], processes: int) -> Iterator[T]:
    # Processes that are forked from one with threads, as PyTorch has, may hang.
    pool = ProcessPoolExecutor(processes, mp_context=get_context("spawn"), initializer=_leave_interrupts_to_parent)
    try:
        for functions in phases:
            with _unheard_interrupts():
                results = pool.map(_call, functions)
            yield from results
    except BrokenProcessPool:
        raise ArgumentError(
            "a process was ended from outside, perhaps for want of memory; run the same command again, "
            "with fewer --processes"
        ) from None
    finally:
        pool.shutdown(cancel_futures=True)


@contextmanager
def _unheard_interrupts() -> Iterator[None]:
    """Let processes that begin in this block hear nothing of Ctrl-C from their first moment on.

    A terminal sends it to all of them, and loading PyTorch takes seconds, before which they can say so themselves.
    What is blocked is inherited; here it is heard once the block ends.
    """
    if sys.platform == "win32":  # which has no such thing
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _leave_interrupts_to_parent() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _call(function: Callable[[], T]) -> T:
    return function()
