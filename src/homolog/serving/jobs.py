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

from homolog.core.errors import HomologError
from homolog.core.files import read_json
from homolog.matching import RESULT_FILES, Side
from homolog.serving.addresses import client_network
from homolog.serving.command import VIEW, MatchCommand, Wishes, complaint_of, side_of, step_of
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
# A connection may falter; when nothing of the files came for longer, nothing more is waited for.
_SILENCE_SECONDS = 30.0
# Of what a process says, for whoever runs the server, should it end in no way that is foreseen.
_LAST_LINES = 30
_UNKNOWN = "the match failed, for a reason that is not known; tell whoever runs this page"


class RefusedError(Exception):
    """Something that was asked for is not to be had.

    Args:
        status: HTTP's word for it.
        message: in a line.
        side: the shape whose file is to blame, if one is.
    """

    def __init__(self, status: int, message: str, side: Side | None = None) -> None:
        super().__init__(message)
        self.status, self.side = status, side

    @property
    def told(self) -> dict[str, str]:
        """What a page is told of it; a name of a file would not say which shape's, as both may be called alike."""
        return {"error": str(self)} | ({} if self.side is None else {"side": self.side})


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
        owner: whose it is, or None for users of this machine.
    """

    def __init__(self, folder: Path, wishes: Wishes, owner: str | None) -> None:
        self.folder, self.wishes, self.owner = folder, wishes, owner
        self.names: dict[Side, str] = {}
        self.complete, self.over = anyio.Event(), False
        self.life = anyio.CancelScope(deadline=anyio.current_time() + _GRACE_SECONDS)
        self.patience = anyio.CancelScope()
        self.heard()
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

    def heard(self) -> None:
        """Some of its shapes came: it waits anew for the rest."""
        self.patience.deadline = anyio.current_time() + _SILENCE_SECONDS

    def arrived(self, side: Side) -> None:
        """One of its shapes is there as a whole."""
        self._arrived.add(side)
        if len(self._arrived) == 2:
            self.complete.set()

    def fail(self, refusal: RefusedError) -> None:
        """Tell of a mistake, and end."""
        self.tell("failed", **refusal.told)
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

    def open(self, wishes: Wishes, host: str) -> str:
        """Make place for a match; it is forgotten again unless someone listens to it soon.

        Args:
            wishes: what is said of the two shapes.
            host: the address of whoever asks.

        Returns:
            The word by which it can be had, known to no one else.

        Raises:
            RefusedError: if there are as many as there may be, or as many of this address.
        """
        assert self._group is not None, "within working() only"
        owner = client_network(host)
        self._check_place(owner)
        key = secrets.token_urlsafe(24)
        self._jobs[key] = Job(self._root / secrets.token_hex(8), wishes, owner)
        self._group.start_soon(self._live, key, self._jobs[key])
        return key

    def _check_place(self, owner: str | None) -> None:
        everyones = len(self._jobs)
        if everyones >= self._limits.places:
            raise RefusedError(503, f"{_under_way(everyones)} here, as many as can be; try again later")
        own = sum(job.owner == owner for job in self._jobs.values())
        if owner is not None and own >= self._limits.per_address:
            most = "as many as one address may have; try again when one has ended"
            raise RefusedError(429, f"{_under_way(own)} from your address, {most}")

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
            job.fail(refusal)
            raise
        except HomologError as error:
            mistake = RefusedError(415, str(error), side)
            job.fail(mistake)
            raise mistake from None
        except BaseException:  # whoever sent it is gone
            job.life.cancel()
            raise
        job.arrived(side)

    async def _store(self, job: Job, side: Side, size: int | None, parts: AsyncIterator[bytes]) -> None:
        self._check_size(job, side, size or 0)
        try:
            with anyio.CancelScope() as upload:
                job.uploads.add(upload)
                await self._write(job, side, parts)
        except OSError as error:
            raise RefusedError(507, f"{job.names[side]} cannot be stored here: {error.strerror}", side) from error
        if upload.cancelled_caught:
            raise RefusedError(410, "this match was cancelled")

    async def _write(self, job: Job, side: Side, parts: AsyncIterator[bytes]) -> None:
        size = 0
        async with await anyio.open_file(job.folder / side / job.names[side], "xb") as file:
            async for part in parts:
                job.heard()
                size += len(part)
                self._check_size(job, side, size)
                await file.write(part)

    def _check_size(self, job: Job, side: Side, size: int) -> None:
        if size > self._limits.file_bytes:
            most = f"{self._limits.max_mb:g} MB, the limit here"
            raise RefusedError(413, f"{job.names[side]} is larger than {most}; reduce it", side)

    # ---- a match's life

    async def _live(self, key: str, job: Job) -> None:
        try:
            with job.life:
                await self._make(job)
                await anyio.sleep(self._limits.seconds)  # for the page to fetch it
        except RefusedError as refusal:
            job.tell("failed", **refusal.told)
        except Exception:
            _log.exception("a match failed")
            job.tell("failed", error=_UNKNOWN)
        finally:
            job.end()
            del self._jobs[key]  # its process has ended: the next one may come, however long the disk takes
            with anyio.CancelScope(shield=True):
                await to_thread.run_sync(shutil.rmtree, job.folder, True)

    async def _make(self, job: Job) -> None:
        await self._arrive(job)
        async with self._turn(job):
            await self._match(job)
            await to_thread.run_sync(_pack, job.folder)
        report = read_json(job.folder / "result" / "report.json", needs="route") or {}
        stems = [PurePath(job.names[side]).stem for side in SIDES]
        job.tell("done", archive=f"{' to '.join(stems)}.zip", warnings=report.get("warnings", []))

    async def _arrive(self, job: Job) -> None:
        with anyio.move_on_after(self._limits.seconds) as clock, job.patience:
            await job.complete.wait()
        if clock.cancelled_caught:
            raise RefusedError(408, f"the files did not arrive within {self._limits.minutes:g} minutes; try again")
        if job.patience.cancelled_caught:
            raise RefusedError(408, f"nothing of the files came for {_SILENCE_SECONDS:g} seconds; try again")

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
        said, steps = deque[str](maxlen=_LAST_LINES), list[str]()

        def hear(line: str) -> None:
            said.append(line)
            if step := step_of(line):
                job.tell("step", name=step, done=len(steps), of=self._command.n_steps)
                steps.append(step)

        names = {side: job.names[side] for side in SIDES}
        environment = self._command.environment(job.folder / "temporary", self._limits.threads)
        line = self._command.line(names, job.wishes)
        try:
            code = await run_limited(line, folder=job.folder, environment=environment, limits=self._limits, heard=hear)
        except OverLimitError as error:
            raise RefusedError(422, f"the match {error}, the limit here, and was stopped; use smaller shapes") from None
        if code:
            about = side_of(steps[-1]) if steps else None
            complaints = (complaint_of(line, job.folder, job.names, about) for line in said)
            complaint = next(filter(None, complaints), None)
            raise RefusedError(422, complaint, about) if complaint else RefusedError(422, self._mishap(code, said))

    def _mishap(self, code: int, said: Iterable[str]) -> str:
        """What to say of an end that is no error of the user's; whoever runs the server is told all."""
        _log.error("a match ended with code %d:\n%s", code, "\n".join(said))
        if code < 0:
            return f"the match broke off, most likely as it needed more than {self._limits.memory_gb:g} GB of memory"
        return _UNKNOWN


def _under_way(number: int) -> str:
    return "1 match is under way" if number == 1 else f"{number} matches are under way"


def _pack(folder: Path) -> None:
    with zipfile.ZipFile(folder / ARCHIVE, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in (*RESULT_FILES, VIEW):
            archive.write(folder / "result" / name, f"homolog-result/{name}")
