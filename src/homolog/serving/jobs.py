"""All matches of a server: who may have one, whose turn it is, and when they are removed."""

from __future__ import annotations

import logging
import secrets
import shutil
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path, PurePath

import anyio
from anyio import to_thread
from anyio.abc import TaskGroup
from typing_extensions import TypedDict

from homolog.core.records import record, stored_record
from homolog.pairs import SIDES
from homolog.serving.addresses import client_network
from homolog.serving.command import MatchCommand, MatchRequest
from homolog.serving.execution import UNKNOWN_ERROR, pack_result, run_match
from homolog.serving.job import Job
from homolog.serving.limits import Limits
from homolog.serving.upload import RefusedError

_log = logging.getLogger(__name__)


@record
class _Report(TypedDict):
    """What is told of a match."""

    warnings: list[str]


class Jobs:
    """All matches of a server; each has a folder and a process of its own.

    Args:
        root: the folder that holds theirs.
        command: what makes a match.
        limits: how many there may be, and what each may take.
    """

    def __init__(self, root: Path, command: MatchCommand, limits: Limits) -> None:
        self._root, self._command, self._limits = root, command, limits
        self._jobs: dict[str, Job] = {}
        self._queue: list[Job] = []
        self._slots = anyio.Semaphore(limits.jobs)
        self._group: TaskGroup | None = None

    @asynccontextmanager
    async def running(self) -> AsyncIterator[None]:
        """Within this block matches can be asked for; at its end those that are left are cancelled and removed."""
        async with anyio.create_task_group() as self._group:
            yield
            self.close()
        self._group = None

    def close(self) -> None:
        """Cancel all matches."""
        for job in self._jobs.values():
            job.scope.cancel()

    def open(self, request: MatchRequest, host: str) -> str:
        """Admit a match; it is forgotten again unless someone follows it soon.

        Args:
            request: what is asked for.
            host: the address of the client.

        Returns:
            The key by which it is found, a secret of the page that asked for it.

        Raises:
            RefusedError: if there are as many as there may be, or as many of this client.
        """
        assert self._group is not None, "within running() only"
        client = client_network(host)
        self._check_admission(client)
        key = secrets.token_urlsafe(24)
        self._jobs[key] = Job(self._root / secrets.token_hex(8), request, client, self._limits)
        self._group.start_soon(self._live, key, self._jobs[key])
        return key

    def _check_admission(self, client: str | None) -> None:
        total = len(self._jobs)
        if total >= self._limits.admitted:
            raise RefusedError(503, f"{_under_way(total)} here, as many as can be; try again later")
        own = sum(job.client == client for job in self._jobs.values())
        if client is not None and own >= self._limits.per_address:
            limit = "as many as one address may have; try again when one has ended"
            raise RefusedError(429, f"{_under_way(own)} from your address, {limit}")

    def find(self, key: str) -> Job:
        """The match that has a key.

        Raises:
            RefusedError: if there is none, or no longer.
        """
        job = self._jobs.get(key)
        if job is None or job.ended:
            raise RefusedError(404, "there is no such match, or it is no longer kept; match again")
        return job

    async def _live(self, key: str, job: Job) -> None:
        try:
            with job.scope:
                await self._match(job)
                await anyio.sleep(self._limits.seconds)  # for the page to fetch it
        except RefusedError as refusal:
            job.publish("failed", **refusal.data)
        except Exception:
            _log.exception("a match failed")
            job.publish("failed", error=UNKNOWN_ERROR)
        finally:
            job.end()
            del self._jobs[key]  # its process has ended: the next one may come, however long the disk takes
            with anyio.CancelScope(shield=True):
                await to_thread.run_sync(shutil.rmtree, job.folder, True)

    async def _match(self, job: Job) -> None:
        await job.upload.wait()
        async with self._turn(job):
            await run_match(job, self._command, self._limits)
            maps = await to_thread.run_sync(pack_result, job.folder)
        report = stored_record(job.folder / "result" / "report.json", _Report) or {"warnings": []}
        stems = [PurePath(job.upload.names[side]).stem for side in SIDES]
        job.publish("done", archive=f"{' to '.join(stems)}.zip", maps=maps, warnings=report["warnings"])

    @asynccontextmanager
    async def _turn(self, job: Job) -> AsyncIterator[None]:
        """Wait until so few matches run that there is room for one more; first come, first served."""
        self._queue.append(job)
        self._publish_queue()
        try:
            await self._slots.acquire()
        finally:
            self._queue.remove(job)
            self._publish_queue()
        try:
            yield
        finally:
            self._slots.release()

    def _publish_queue(self) -> None:
        for ahead, job in enumerate(self._queue):
            job.publish("waiting", ahead=ahead)


def _under_way(number: int) -> str:
    return "1 match is under way" if number == 1 else f"{number} matches are under way"
