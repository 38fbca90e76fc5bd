"""One match of the server: its files, the events that its page follows, and when it ends."""

from __future__ import annotations

from collections.abc import AsyncIterator
from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import Any

import anyio

from homolog.pairs import SIDES, Side
from homolog.serving.command import MatchRequest
from homolog.serving.limits import Limits
from homolog.serving.upload import RefusedError, Upload

# A page that follows the events no longer may have lost its connection for a moment.
_RECONNECT_SECONDS = 5.0


@dataclass(frozen=True)
class JobEvent:
    """Something that the page of a match is sent.

    Args:
        kind: ``waiting``, ``step``, ``done`` or ``failed``.
        data: what is sent of it, as JSON.
    """

    kind: str
    data: dict[str, Any]


class Job:
    """One match, from the moment a page asks for it until it is forgotten.

    Args:
        folder: its own; it is made here.
        request: what is asked for.
        client: the network that asks for it, or None for users of this machine.
        limits: on its files.
    """

    def __init__(self, folder: Path, request: MatchRequest, client: str | None, limits: Limits) -> None:
        self.folder, self.request, self.client = folder, request, client
        self.scope = anyio.CancelScope(deadline=anyio.current_time() + _RECONNECT_SECONDS)
        self.upload = Upload(folder, limits)
        self.ended = False
        self._followers = 0
        self._events: list[JobEvent] = []
        self._changed = anyio.Event()
        for name in (*SIDES, "result", "temporary"):
            (folder / name).mkdir(parents=True)
        request.write_landmarks(folder)

    @property
    def done(self) -> bool:
        """Whether its result is there."""
        return any(event.kind == "done" for event in self._events)

    def publish(self, kind: str, **data: Any) -> None:
        """Add an event."""
        self._events.append(JobEvent(kind, data))
        self._notify()

    async def follow(self, begin: int = 0) -> AsyncIterator[tuple[int, JobEvent]]:
        """Its events from the first or a later one on, each with its number, until it has ended.

        It is cancelled some seconds after the last follower left.
        """
        self._followers += 1
        self.scope.deadline = inf
        try:
            while True:
                for number, event in enumerate(self._events[begin:], start=begin):
                    yield number, event
                    begin = number + 1
                if self.ended and begin >= len(self._events):
                    return
                if begin >= len(self._events):
                    await self._changed.wait()
        finally:
            self._followers -= 1
            if not self._followers:
                self.scope.deadline = anyio.current_time() + _RECONNECT_SECONDS

    async def receive(self, side: Side, name: str, size: int | None, chunks: AsyncIterator[bytes]) -> None:
        """Store one of the two files; a match one of whose files is refused ends.

        Args:
            side: which of both.
            name: of the file, as its owner has it.
            size: of the file in bytes, if it was announced.
            chunks: the file.

        Raises:
            RefusedError: if there is one already, or as ``Upload.receive`` does.
        """
        if side in self.upload.names:
            raise RefusedError(409, f"this match has its {side} already")
        try:
            await self.upload.receive(side, name, size, chunks)
        except RefusedError as refusal:
            self.publish("failed", **refusal.data)
            self.scope.cancel()
            raise
        except BaseException:  # the sender is gone
            self.scope.cancel()
            raise

    def end(self) -> None:
        """Publish nothing more, and take in nothing more."""
        self.ended = True
        self.upload.cancel()
        self._notify()

    def _notify(self) -> None:
        self._changed.set()
        self._changed = anyio.Event()
