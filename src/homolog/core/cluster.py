"""Tasks in the workers of a Ray cluster: a user's, or one of this machine that is begun for them."""

from __future__ import annotations

import logging
import os
import platform
import secrets
import shutil
import signal
import socket
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from functools import cache, lru_cache, partial
from pathlib import Path
from typing import Any, NoReturn, TypeVar

from homolog.core.arguments import check_count
from homolog.core.ends import bound_end, patience
from homolog.core.errors import ArgumentError, HomologError, bad_value, needs_extra
from homolog.core.files import is_there, remove_abandoned_below
from homolog.core.versions import version_of

T = TypeVar("T")

LOCAL = "ray"
"""In place of an address: a Ray of this machine, which begins and ends with the tasks."""

# How often a task is begun again whose worker died.
_RETRIES = 3
# Seconds for tasks to remove what they are writing after an interrupt, for one of them, and for all of Ray to end.
_PATIENCE, _OF_TASKS, _OF_RAY = 3.0, 1.0, 12.0
# Seconds for a cluster to answer.
_TO_ANSWER = 10.0
# Characters of a folder's name that leave enough of the 107 of a socket's for what Ray adds.
_SHORT = 20
# Variables that say who may use a Ray, and those that are chosen, or that Ray sets, as it begins.
_OF_TOKENS = ("RAY_AUTH_MODE", "RAY_AUTH_TOKEN", "RAY_AUTH_TOKEN_PATH")
_OF_RAYS_BEGIN = ("RAY_USAGE_STATS_ENABLED", *_OF_TOKENS)
# Results are small, so that Ray needs little of the memory that it would set aside for them.
_STORE_BYTES = 200 * 2**20


@dataclass(frozen=True)
class Cluster:
    """A Ray cluster (Moritz et al., "Ray", OSDI 2018) whose workers do tasks, one core each.

    A worker that dies is replaced, and its task is done again. All files must lie in folders that every machine has
    under the same name, as on a shared file system, and every machine must have the same version of Homolog. Computes
    on processors alone.

    Args:
        address: ``"ray"`` for a Ray of this machine, which begins and ends with the tasks; or what ``ray.init`` takes
            for a cluster that is there, which is left as it was: ``"auto"``, ``"HOST:6379"``, ``"ray://HOST:10001"``.
        workers: how many tasks are done at once; by default one on each core.

    Raises:
        ArgumentError: if the number of workers is not positive, or the address is empty.
        MissingExtraError: without the package ray.

    Examples:
        >>> homolog.synthesis.synthesize_animals("animals", 400, processes=Cluster(workers=8))  # doctest: +SKIP
    """

    address: str = LOCAL
    workers: int | None = None

    def __post_init__(self) -> None:
        if not (isinstance(self.address, str) and self.address):
            raise bad_value("cluster", self.address, "'ray', or the address of a Ray cluster")
        if self.workers is not None:
            check_count("workers", self.workers)
        _ray()

    @property
    def is_local(self) -> bool:
        """Whether it is one of this machine that begins and ends with the tasks."""
        return self.address == LOCAL


Processes = int | Cluster
"""How many processes of this machine work at once, or the cluster whose workers do."""


def _ray() -> Any:
    with needs_extra("a cluster", "cluster"):
        import ray
    return ray


@contextmanager
def connected(cluster: Cluster, *, reads: Sequence[Path] = (), writes: Path | None = None) -> Iterator[Connection]:
    """Have a cluster for the tasks of a block; what this began ends with it.

    Args:
        cluster: which.
        reads: files and folders that every worker must see.
        writes: the folder that tasks write into, which every worker must see.

    Raises:
        ArgumentError: if no cluster can be reached at the address.
    """
    ray = _ray()
    seen = [path for path in (*reads, *(() if writes is None else (writes,))) if is_there(path)]
    with ExitStack() as until_the_end:
        until_the_end.enter_context(patience(_OF_RAY))
        if writes is not None:  # by workers that were killed
            until_the_end.callback(remove_abandoned_below, writes)
        if not ray.is_initialized():  # else the program that calls this has its own, whose end it sees to
            until_the_end.enter_context(_begun(ray, cluster))
        yield Connection(ray, cluster, _Place.of(seen))


@contextmanager
def _begun(ray: Any, cluster: Cluster) -> Iterator[None]:
    """Begin a Ray, or connect with one, without a word of it and with our own ends after signals."""
    with ExitStack() as until_the_end:
        settings: dict[str, Any] = {"address": cluster.address}
        check_answer(cluster)
        if cluster.is_local:
            folder = tempfile.mkdtemp(prefix="homolog-ray-", dir=_short_folder())  # its logs and sockets
            until_the_end.callback(shutil.rmtree, folder, ignore_errors=True)
            settings = {"address": "local", "num_cpus": cluster.workers, "include_dashboard": False}
            settings |= {"object_store_memory": _STORE_BYTES, "_temp_dir": folder}
        until_the_end.enter_context(_environment(is_local=cluster.is_local))
        until_the_end.enter_context(_silent())
        until_the_end.callback(ray.shutdown)
        with _own_signals():
            try:
                ray.init(**settings, log_to_driver=False, configure_logging=False, logging_level=logging.CRITICAL)
            except (OSError, RuntimeError, ValueError, ray.exceptions.RayError) as error:
                raise ArgumentError(_unreachable(cluster, error)) from None
        yield


def _short_folder() -> str | None:
    """A folder for temporary files where names of sockets are short enough for the system; None for the usual one."""
    is_short = len(tempfile.gettempdir()) <= _SHORT or sys.platform == "win32"
    return None if is_short else "/tmp"


def check_answer(cluster: Cluster) -> None:
    """Refuse an address where nobody answers: Ray would try for minutes, and say so each second.

    Raises:
        ArgumentError: if nobody does.
    """
    host, is_given, port = cluster.address.removeprefix("ray://").rpartition(":")
    if not is_given:  # "ray", or such as "auto", which Ray looks up
        return
    try:
        socket.create_connection((host.strip("[]"), int(port)), timeout=_TO_ANSWER).close()
    except (OSError, ValueError, OverflowError) as error:
        raise ArgumentError(_unreachable(cluster, error)) from None


def _unreachable(cluster: Cluster, error: Exception) -> str:
    said = " ".join(str(error).split())[:200]
    if cluster.is_local:
        return f"a Ray of this machine could not be begun ({said}); use --processes without --cluster"
    return f"there is no Ray cluster at {cluster.address!r} ({said}); give the address that ray start printed"


@contextmanager
def _environment(*, is_local: bool) -> Iterator[None]:
    """What Ray reads as it begins: no report of use, nobody let in without this process's token."""
    before = {name: os.environ.get(name) for name in _OF_RAYS_BEGIN}
    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
    if is_local and not any(before[name] for name in _OF_TOKENS):
        os.environ["RAY_AUTH_TOKEN"] = _token()  # without one, Ray would make one, and keep it in the user's folder
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name, None)
            os.environ.update({} if value is None else {name: value})


@cache
def _token() -> str:
    """Which Ray reads once in a process."""
    return secrets.token_hex(32)


@contextmanager
def _silent() -> Iterator[None]:
    """Have Ray say nothing: what it says of workers that died goes to standard output, whatever its settings."""
    import ray._private.worker as speaker

    log = logging.getLogger("ray")
    level = log.level
    log.setLevel(logging.CRITICAL + 1)
    speaker._worker_logs_enabled = False
    try:
        yield
    finally:
        log.setLevel(level)
        speaker._worker_logs_enabled = True


@contextmanager
def _own_signals() -> Iterator[None]:
    """Give back what handles SIGTERM, which Ray takes as it begins."""
    in_main = threading.current_thread() is threading.main_thread()
    before = signal.getsignal(signal.SIGTERM)
    try:
        yield
    finally:
        if in_main:
            signal.signal(signal.SIGTERM, before)


class Connection:
    """Does tasks in the workers of a cluster.

    Args:
        ray: the package.
        cluster: that is connected.
        place: where tasks are done.
    """

    def __init__(self, ray: Any, cluster: Cluster, place: _Place) -> None:
        self._ray, self._cluster, self._place = ray, cluster, place
        self._task = ray.remote(num_cpus=1, max_retries=_RETRIES)(_in_worker)

    def results(self, functions: Sequence[Callable[[], T]]) -> Iterator[T]:
        """What functions give, in their order, as soon as it is there; each must do no harm when it is done twice.

        What several functions have in common, the function of their ``functools.partial``, travels once and is
        unpickled once in each worker.
        """
        pickled = map(self._taken_apart(), functions)
        running: dict[Any, int] = {}
        done: dict[int, Any] = {}
        begun = 0
        try:
            for number in range(len(functions)):
                while number not in done:
                    while len(running) < self._room() and begun < len(functions):
                        running[self._task.remote(*next(pickled), self._place)] = begun
                        begun += 1
                    for finished in self._ray.wait(list(running))[0]:
                        done[running.pop(finished)] = finished
                yield self._result(done.pop(number))
        finally:
            self._stop(list(running))

    def _room(self) -> int:
        """How many tasks may be on their way: of a cluster that may grow, twice as many as it has cores."""
        if self._cluster.workers is not None and not self._cluster.is_local:
            return self._cluster.workers
        return 2 * max(1, int(self._ray.cluster_resources().get("CPU", 1)))

    def _taken_apart(self) -> Callable[[Callable[[], Any]], tuple[Any, bytes]]:
        """Takes a function apart into what it shares with others, kept by Ray, and what is its own, as bytes.

        As bytes, since arrays that Ray unpickles itself cannot be written to.
        """
        kept: dict[int, tuple[Any, Any]] = {}

        def take_apart(function: Callable[[], Any]) -> tuple[Any, bytes]:
            shared: Any = _called
            own: tuple[Any, ...] = (function,)
            if isinstance(function, partial) and not function.keywords:
                shared, own = function.func, function.args
            if id(shared) not in kept:  # kept beside, so that no other takes its number
                kept[id(shared)] = shared, self._ray.put(_pickled(shared))
            return kept[id(shared)][1], _pickled(own)

        return take_apart

    def _result(self, reference: Any) -> Any:
        from ray import cloudpickle

        errors = self._ray.exceptions
        try:
            found, is_error = cloudpickle.loads(self._ray.get(reference))
        except (errors.WorkerCrashedError, errors.OutOfMemoryError, errors.NodeDiedError):
            raise ArgumentError(
                f"a worker died at the same task {_RETRIES + 1} times, perhaps for want of memory; run the same "
                "command again, with fewer --processes"
            ) from None
        except errors.RayError as error:
            raise ArgumentError(self._of_ray(error)) from None
        if is_error:
            raise found
        return found

    def _of_ray(self, error: Exception) -> str:
        said = " ".join(str(error).split())
        if "No module named 'homolog" in said:
            needed = f"homolog=={version_of('homolog')}"
            return f"the workers of {self._cluster.address!r} lack Homolog; install {needed} on each of its machines"
        return f"the cluster {self._cluster.address!r} could not do a task ({type(error).__name__}: {said[-200:]})"

    def _stop(self, running: list[Any]) -> None:
        """End tasks that nobody waits for any more, and let them remove what they are writing."""
        if not running:
            return
        for reference in running:
            with suppress(self._ray.exceptions.RayError):
                self._ray.cancel(reference)
        self._ray.wait(running, num_returns=len(running), timeout=_PATIENCE)


def _pickled(value: Any) -> bytes:
    from ray import cloudpickle

    dumps: Callable[[Any], bytes] = cloudpickle.dumps
    return dumps(value)


def _called(function: Callable[[], T]) -> T:
    return function()


@dataclass(frozen=True)
class _Place:
    """What tasks need wherever they are done.

    Args:
        folder: that relative paths begin at.
        seen: files and folders.
        environment: our own variables, such as where operators are kept.
        version: of this package.
    """

    folder: str
    seen: tuple[str, ...]
    environment: tuple[tuple[str, str], ...]
    version: str | None

    @classmethod
    def of(cls, seen: Sequence[Path]) -> _Place:
        """As it is here."""
        own = tuple((name, value) for name, value in sorted(os.environ.items()) if name.startswith("HOMOLOG_"))
        return cls(str(Path.cwd()), tuple(map(str, dict.fromkeys(seen))), own, version_of("homolog"))


def _in_worker(shared: bytes, own: bytes, place: _Place) -> bytes:
    """Do a task; what it gave or raised, and whether it raised it."""
    from ray import cloudpickle

    def end(number: int) -> NoReturn:
        os._exit(1)

    call_off = bound_end(_OF_TASKS, end)
    try:
        _enter(place)
        return _pickled((_loaded(shared)(*cloudpickle.loads(own)), False))
    except Exception as error:  # whatever it is, it is raised where the task's result is waited for
        return _pickled((error, True))
    finally:
        call_off()


@lru_cache(maxsize=1)
def _enter(place: _Place) -> None:
    """Make this worker's process ready, once.

    Raises:
        HomologError: if it cannot do these tasks.
    """
    machine = platform.node()
    if place.version != version_of("homolog"):
        raise HomologError(
            f"the worker {machine} has homolog {version_of('homolog')}, but must have {place.version}; install it there"
        )
    with suppress(OSError):
        os.chdir(place.folder)
    for path in (place.folder, *place.seen):
        if not is_there(path):
            raise HomologError(
                f"the worker {machine} cannot see {path}; have all files in folders that every machine of the cluster "
                "has under the same name"
            )
    os.environ.update(place.environment)


@lru_cache(maxsize=1)
def _loaded(shared: bytes) -> Callable[..., Any]:
    """What tasks have in common, with what it keeps for the next one."""
    from ray import cloudpickle

    function: Callable[..., Any] = cloudpickle.loads(shared)
    return function
