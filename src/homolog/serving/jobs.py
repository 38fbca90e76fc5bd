"""Matches that were asked for: each has a folder and a process of its own, waits for its turn, and is forgotten."""

from __future__ import annotations

import logging
import secrets
import shutil
import zipfile
from collections import deque
from collections.abc import AsyncIterator, Iterable
from contextlib import asynccontextmanager
from dataclasses import dataclass
from math import inf
from pathlib import Path, PurePath
from typing import Any

import anyio
from anyio import to_thread
from anyio.abc import TaskGroup

from homolog.errors import HomologError
from homolog.files import read_json
from homolog.matching import RESULT_FILES, Side
from homolog.serving.command import VIEW, MatchCommand, Wishes, complaint_of, step_of
from homolog.serving.limits import Limits
from homolog.serving.names import plain_name
from homolog.serving.process import OverLimitError, run_limited
from homolog.viewing import SIDES

_log = logging.getLogger(__name__)

ARCHIVE = "result.zip"
"""The whole result, in a match's folder once it is done."""

_FOLDERS = ("source", "target", "result", "temporary")
# A page that listens no longer may have lost its connection for a moment.
_GRACE_SECONDS = 5.0
# Of what a process says, for whoever runs the server, should it end in no way that is foreseen.
_LAST_LINES = 30
_UNKNOWN = "the match failed, for a reason that is not known; tell whoever runs this page"


class RefusedError(Exception):
    """Something that was asked for is not to be had; ``status`` is HTTP's word for it."""

    def __init__(self, status: int, message: str) -> None:
        super().__init__(message)
        self.status = status


@dataclass(frozen=True)
class News:
    """Something that a page is told of its match.

    Args:
        kind: ``waiting``, ``step``, ``done`` or ``failed``.
        told: what of it, for JSON.
    """

    kind: str
    told: dict[str, Any]


class Job:
    """One match, from the moment a page asks for it until it is forgotten.

    Args:
        folder: its own; it is made here.
        wishes: what was said of the two shapes.
    """

    def __init__(self, folder: Path, wishes: Wishes) -> None:
        self.folder, self.wishes = folder, wishes
        self.names: dict[Side, str] = {}
        self.complete, self.over = anyio.Event(), False
        self.life = anyio.CancelScope(deadline=anyio.current_time() + _GRACE_SECONDS)
        self.uploads: set[anyio.CancelScope] = set()
        self._arrived: set[Side] = set()
        self._listeners = 0
        self._news: list[News] = []
        self._stir = anyio.Event()
        for name in _FOLDERS:
            (folder / name).mkdir(parents=True)

    @property
    def done(self) -> bool:
        """Whether its result is there."""
        return any(news.kind == "done" for news in self._news)

    def tell(self, kind: str, **told: Any) -> None:
        """Tell whoever listens."""
        self._news.append(News(kind, told))
        self._wake()

    async def listen(self, begin: int = 0) -> AsyncIterator[tuple[int, News]]:
        """All that it tells from the first or a later piece of news on, each with its number, until it is over.

        It is cancelled some seconds after the last one stopped listening.
        """
        self._listeners += 1
        self.life.deadline = inf
        try:
            async for numbered in self._follow(begin):
                yield numbered
        finally:
            self._listeners -= 1
            if not self._listeners:
                self.life.deadline = anyio.current_time() + _GRACE_SECONDS

    async def _follow(self, begin: int) -> AsyncIterator[tuple[int, News]]:
        while True:
            while begin < len(self._news):
                yield begin, self._news[begin]
                begin += 1
            if self.over:
                return
            await self._stir.wait()

    def arrived(self, side: Side) -> None:
        """One of its shapes is there as a whole."""
        self._arrived.add(side)
        if len(self._arrived) == 2:
            self.complete.set()

    def fail(self, message: str) -> None:
        """Tell of a mistake, and end."""
        self.tell("failed", error=message)
        self.life.cancel()

    def end(self) -> None:
        """It is over: nothing more is told, and what is being uploaded is not waited for."""
        self.over = True
        for upload in self.uploads:
            upload.cancel()
        self._wake()

    def _wake(self) -> None:
        self._stir.set()
        self._stir = anyio.Event()


class Jobs:
    """All matches of a server.

    Args:
        root: the folder that holds theirs.
        command: what makes a match.
        limits: how many there may be, and what each may take.
    """

    def __init__(self, root: Path, command: MatchCommand, limits: Limits) -> None:
        self._root, self._command, self._limits = root, command, limits
        self._jobs: dict[str, Job] = {}
        self._waiting: list[Job] = []
        self._turns = anyio.Semaphore(limits.jobs)
        self._group: TaskGroup | None = None

    @asynccontextmanager
    async def working(self) -> AsyncIterator[None]:
        """Within this block matches can be asked for; at its end those that are left are cancelled and removed."""
        async with anyio.create_task_group() as self._group:
            yield
            self.close()
        self._group = None

    def close(self) -> None:
        """Cancel all matches."""
        for job in self._jobs.values():
            job.life.cancel()

    # ---- what a page asks for

    def open(self, wishes: Wishes) -> str:
        """Make place for a match; it is forgotten again unless someone listens to it soon.

        Returns:
            The word by which it can be had, known to no one else.

        Raises:
            RefusedError: if there are as many as there may be.
        """
        assert self._group is not None, "within working() only"
        if len(self._jobs) >= self._limits.places:
            raise RefusedError(503, f"{len(self._jobs)} matches are under way here, as many as can be; try again later")
        key = secrets.token_urlsafe(24)
        self._jobs[key] = Job(self._root / secrets.token_hex(8), wishes)
        self._group.start_soon(self._live, key, self._jobs[key])
        return key

    def find(self, key: str) -> Job:
        """The match that a word stands for.

        Raises:
            RefusedError: if there is none, or no longer.
        """
        job = self._jobs.get(key)
        if job is None or job.over:
            raise RefusedError(404, "there is no such match, or it is no longer kept; match again")
        return job

    async def receive(self, job: Job, side: Side, name: str, size: int | None, parts: AsyncIterator[bytes]) -> None:
        """Take in one of a match's shapes; one that cannot be taken in ends the match.

        Args:
            job: the match.
            side: which of both.
            name: what its owner calls it.
            size: of the file in bytes, if it was announced.
            parts: the file.

        Raises:
            RefusedError: if there is one already, it is too large, no shape's file, or cannot be stored.
        """
        if side in job.names:
            raise RefusedError(409, f"this match has its {side} already")
        job.names[side] = name
        try:
            job.names[side] = plain_name(name)
            await self._store(job, side, size, parts)
        except RefusedError as refusal:
            job.fail(str(refusal))
            raise
        except HomologError as error:
            job.fail(str(error))
            raise RefusedError(415, str(error)) from None
        except BaseException:  # whoever sent it is gone
            job.life.cancel()
            raise
        job.arrived(side)

    async def _store(self, job: Job, side: Side, size: int | None, parts: AsyncIterator[bytes]) -> None:
        name = job.names[side]
        self._check_size(name, size or 0)
        try:
            with anyio.CancelScope() as upload:
                job.uploads.add(upload)
                await self._write(job.folder / side / name, name, parts)
        except OSError as error:
            raise RefusedError(507, f"{name} cannot be stored here: {error.strerror}") from error
        if upload.cancelled_caught:
            raise RefusedError(410, "this match was cancelled")

    async def _write(self, path: Path, name: str, parts: AsyncIterator[bytes]) -> None:
        size = 0
        async with await anyio.open_file(path, "xb") as file:
            async for part in parts:
                size += len(part)
                self._check_size(name, size)
                await file.write(part)

    def _check_size(self, name: str, size: int) -> None:
        if size > self._limits.file_bytes:
            raise RefusedError(413, f"{name} is larger than {self._limits.max_mb:g} MB, the limit here; reduce it")

    # ---- a match's life

    async def _live(self, key: str, job: Job) -> None:
        try:
            with job.life:
                await self._make(job)
                await anyio.sleep(self._limits.seconds)  # for the page to fetch it
        except RefusedError as refusal:
            job.tell("failed", error=str(refusal))
        except Exception:
            _log.exception("a match failed")
            job.tell("failed", error=_UNKNOWN)
        finally:
            job.end()
            with anyio.CancelScope(shield=True):
                await to_thread.run_sync(shutil.rmtree, job.folder, True)
            del self._jobs[key]

    async def _make(self, job: Job) -> None:
        with anyio.move_on_after(self._limits.seconds) as clock:
            await job.complete.wait()
        if clock.cancelled_caught:
            raise RefusedError(408, f"the files did not arrive within {self._limits.minutes:g} minutes; try again")
        async with self._turn(job):
            await self._match(job)
            await to_thread.run_sync(_pack, job.folder)
        report = read_json(job.folder / "result" / "report.json", needs="route") or {}
        stems = [PurePath(job.names[side]).stem for side in SIDES]
        job.tell("done", archive=f"{' to '.join(stems)}.zip", warnings=report.get("warnings", []))

    @asynccontextmanager
    async def _turn(self, job: Job) -> AsyncIterator[None]:
        """Wait until so few matches run that there is room for one more; first come, first served."""
        self._waiting.append(job)
        self._tell_places()
        try:
            await self._turns.acquire()
        finally:
            self._waiting.remove(job)
            self._tell_places()
        try:
            yield
        finally:
            self._turns.release()

    def _tell_places(self) -> None:
        for before, job in enumerate(self._waiting):
            job.tell("waiting", before=before)

    async def _match(self, job: Job) -> None:
        said, n_steps = deque[str](maxlen=_LAST_LINES), 0

        def hear(line: str) -> None:
            nonlocal n_steps
            said.append(line)
            if step := step_of(line):
                job.tell("step", name=step, done=n_steps, of=self._command.n_steps)
                n_steps += 1

        names = {side: job.names[side] for side in SIDES}
        environment = self._command.environment(job.folder / "temporary", self._limits.threads)
        line = self._command.line(names, job.wishes)
        try:
            code = await run_limited(line, folder=job.folder, environment=environment, limits=self._limits, heard=hear)
        except OverLimitError as error:
            raise RefusedError(422, f"the match {error}, the limit here, and was stopped; use smaller shapes") from None
        if code:
            complaints = (complaint_of(line, job.folder, job.names) for line in said)
            raise RefusedError(422, next(filter(None, complaints), None) or self._mishap(code, said))

    def _mishap(self, code: int, said: Iterable[str]) -> str:
        """What to say of an end that is no error of the user's; whoever runs the server is told all."""
        _log.error("a match ended with code %d:\n%s", code, "\n".join(said))
        if code < 0:
            return f"the match broke off, most likely as it needed more than {self._limits.memory_gb:g} GB of memory"
        return _UNKNOWN


def _pack(folder: Path) -> None:
    with zipfile.ZipFile(folder / ARCHIVE, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in (*RESULT_FILES, VIEW):
            archive.write(folder / "result" / name, f"homolog-result/{name}")
