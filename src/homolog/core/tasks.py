"""Running many tasks: one by one, in several processes, or in the workers of a cluster."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import time
import warnings
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, contextmanager
from functools import cache
from multiprocessing.synchronize import Semaphore
from pathlib import Path
from typing import Any, NoReturn, TypeVar

from joblib import Parallel, delayed
from joblib.externals.loky.backend import get_context, resource_tracker
from joblib.parallel import LokyBackend

from homolog.core.arguments import check_count
from homolog.core.cluster import Cluster, Processes, check_answer, connected
from homolog.core.ends import bound_end, end_with_parent
from homolog.core.errors import ArgumentError
from homolog.core.progress import Progress, ignore

T = TypeVar("T")

# A name to show, and what to do; several processes need functions and results that can be pickled. Those of a cluster
# may be done twice, if a worker dies.
Task = tuple[str, Callable[[], T]]

# Seconds for all workers to end in by themselves, once they are told to, and those after which one gives its task up.
# On a busy machine its last steps take some of what is left.
_PATIENCE, _OF_TASKS = 4.0, 1.0


def check_processes(processes: Processes) -> None:
    """Refuse a number of processes that is not positive, or a cluster that does not answer."""
    if isinstance(processes, Cluster):
        check_answer(processes)
    else:
        check_count("processes", processes)


def run_tasks(
    phases: Sequence[Sequence[Task[T]]],
    *,
    processes: Processes,
    progress: Progress,
    told: Callable[[T], Any] = ignore,
    reads: Sequence[Path] = (),
    writes: Path | None = None,
) -> None:
    """Run all tasks of a phase, in any order, before those of the next phase.

    On an error or an interrupt no further task begins, and those that are being done end. Several processes share the
    cores: NumPy and PyTorch take fewer threads in each, unless ``OMP_NUM_THREADS`` and the like are set.

    Args:
        phases: the tasks.
        processes: how many work at once, where one is this one; or the cluster whose workers do.
        progress: told of each task before it is waited for.
        told: what each task gives, in this process and in the order of the tasks.
        reads: files and folders that the workers of a cluster must see.
        writes: the folder that tasks write into.

    Raises:
        ArgumentError: if one of several processes is ended from outside, or a cluster cannot be used.
    """
    names = [name for tasks in phases for name, _ in tasks]
    results = _results_of_phases(phases, processes, reads, writes)
    with closing(results):
        for number, name in enumerate(names):
            progress(number, len(names), name)
            told(next(results))
    progress(len(names), len(names), "done")


def _results_of_phases(
    phases: Sequence[Sequence[Task[T]]], processes: Processes, reads: Sequence[Path], writes: Path | None
) -> Generator[T, None, None]:
    functions = [[function for _, function in tasks] for tasks in phases]
    if isinstance(processes, Cluster):
        with connected(processes, reads=reads, writes=writes) as cluster:
            for each in functions:
                yield from cluster.results(each)
        return
    for each in functions:
        yield from _results(each, min(processes, max(1, len(each))))


def _results(functions: Sequence[Callable[[], T]], processes: int) -> Iterator[T]:
    if processes == 1:
        yield from (function() for function in functions)
        return
    _start_trackers()
    backend = _Backend(initializer=_begin_worker, initargs=(os.getpid(), _at_rest()))
    # Joblib would map large arrays to files, and they could not be written to.
    parallel = Parallel(processes, backend=backend, return_as="generator", batch_size=1, max_nbytes=None)
    with _unheard_interrupts():
        results = parallel(map(delayed(_in_worker), functions))
    try:
        yield from results
    except BrokenProcessPool:
        raise ArgumentError(
            "a process was ended from outside, perhaps for want of memory; run the same command again, "
            "with fewer --processes"
        ) from None
    finally:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # joblib says that it cancels tasks
            results.close()


class _Backend(LokyBackend):  # type: ignore[misc]
    """Joblib's processes; on an error or an interrupt their tasks may remove what they are writing."""

    def abort_everything(self, ensure_ready: bool = True) -> None:
        workers = [child for child in multiprocessing.active_children() if child.name.startswith("LokyProcess")]
        deadline = time.monotonic() + _PATIENCE
        while _at_rest().acquire(block=False):  # of an earlier time
            pass
        for worker in workers:
            worker.terminate()
        for _ in workers:
            _at_rest().acquire(timeout=max(0, deadline - time.monotonic()))
        super().abort_everything(ensure_ready)  # which kills them


@cache
def _at_rest() -> Semaphore:
    """Counts the workers that have nothing to remove any more, once they were told to end."""
    count: Semaphore = get_context().Semaphore(0)
    return count


def _start_trackers() -> None:
    """Start what tidies up after processes, before others begin: it would unblock signals that are blocked by then.

    Where a command is ended, it finds something to tidy up, and would say so behind the command's last line.
    """
    if sys.platform == "win32":  # where there is another way
        return
    from multiprocessing import resource_tracker as another  # which Windows lacks, too

    before = sys.warnoptions[:]
    sys.warnoptions.append("ignore")
    try:
        for tracker in (resource_tracker, another):
            tracker.ensure_running()
    finally:
        sys.warnoptions[:] = before


@contextmanager
def _unheard_interrupts() -> Iterator[None]:
    """Have processes that begin in this block hear nothing of Ctrl-C, which a terminal sends to all of them."""
    if sys.platform == "win32":  # which has no such thing
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _begin_worker(parent: int, at_rest: Semaphore) -> None:
    """Leave interrupts to the parent, which ends its workers by SIGTERM, and end with it if it is killed."""

    def end(*_: object) -> None:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        if _Worker.is_in_task:
            sys.exit(1)  # so that the task removes what it is writing
        _rest()

    _Worker.at_rest = at_rest
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, end)
    bound_end(_OF_TASKS, lambda _: _rest())
    end_with_parent(parent)


class _Worker:
    """The state of this process, if it is a worker."""

    at_rest: Semaphore
    is_in_task = False


def _rest() -> NoReturn:
    """Wait to be killed: the first worker that ended would have all others killed at once, whatever they are at."""
    _Worker.at_rest.release()
    time.sleep(2 * _PATIENCE)
    os._exit(1)


def _in_worker(function: Callable[[], T]) -> T:
    _Worker.is_in_task = True
    try:
        return function()
    except SystemExit:  # by SIGTERM: the task has removed what it was writing
        _rest()
    finally:
        _Worker.is_in_task = False
