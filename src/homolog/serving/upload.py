"""Both files of a match while they come in: checked by name, counted while they are written."""

from __future__ import annotations

from collections.abc import AsyncIterator
from pathlib import Path

import anyio

from homolog.core.errors import HomologError
from homolog.pairs import Side
from homolog.serving.limits import Limits
from homolog.serving.names import safe_file_name

# A connection may falter; when nothing of the files came for longer, nothing more is waited for.
_IDLE_SECONDS = 30.0


class RefusedError(Exception):
    """A request that the server refuses, or a match that it gives up.

    Args:
        status: of HTTP.
        message: in a line.
        side: the shape whose file is to blame, if one is.
    """

    def __init__(self, status: int, message: str, side: Side | None = None) -> None:
        super().__init__(message)
        self.status, self.side = status, side

    @property
    def data(self) -> dict[str, str]:
        """What a page is sent; a file's name would not say which shape's, as both may have the same."""
        return {"error": str(self)} | ({} if self.side is None else {"side": self.side})


class Upload:
    """The files of one match.

    Args:
        folder: of the match; a file lies in its ``source`` or ``target``.
        limits: on size and time.
    """

    def __init__(self, folder: Path, limits: Limits) -> None:
        self.names: dict[Side, str] = {}
        self._folder, self._limits = folder, limits
        self._received: set[Side] = set()
        self._complete = anyio.Event()
        self._idle = anyio.CancelScope(deadline=anyio.current_time() + _IDLE_SECONDS)
        self._writing: set[anyio.CancelScope] = set()

    async def wait(self) -> None:
        """Wait until both files are there.

        Raises:
            RefusedError: if they take too long, or stop coming.
        """
        with anyio.move_on_after(self._limits.seconds) as clock, self._idle:
            await self._complete.wait()
        if clock.cancelled_caught:
            raise RefusedError(408, f"the files did not arrive within {self._limits.minutes:g} minutes; try again")
        if self._idle.cancelled_caught:
            raise RefusedError(408, f"nothing of the files came for {_IDLE_SECONDS:g} seconds; try again")

    async def receive(self, side: Side, name: str, size: int | None, chunks: AsyncIterator[bytes]) -> None:
        """Store one of the two files.

        Args:
            side: which of both.
            name: of the file, as its owner has it.
            size: of the file in bytes, if it was announced.
            chunks: the file.

        Raises:
            RefusedError: if it is too large, is no shape's file, or cannot be stored.
        """
        self.names[side] = name
        try:
            self.names[side] = safe_file_name(name)
        except HomologError as error:
            raise RefusedError(415, str(error), side) from None
        self._check_size(side, size or 0)
        try:
            with anyio.CancelScope() as writing:
                self._writing.add(writing)
                await self._write(side, chunks)
        except OSError as error:
            raise RefusedError(507, f"{self.names[side]} cannot be stored here: {error.strerror}", side) from error
        if writing.cancelled_caught:
            raise RefusedError(410, "this match was cancelled")
        self._received.add(side)
        if len(self._received) == 2:
            self._complete.set()

    def cancel(self) -> None:
        """Take in nothing more."""
        for writing in self._writing:
            writing.cancel()

    async def _write(self, side: Side, chunks: AsyncIterator[bytes]) -> None:
        size = 0
        async with await anyio.open_file(self._folder / side / self.names[side], "xb") as file:
            async for chunk in chunks:
                self._idle.deadline = anyio.current_time() + _IDLE_SECONDS
                size += len(chunk)
                self._check_size(side, size)
                await file.write(chunk)

    def _check_size(self, side: Side, size: int) -> None:
        if size > self._limits.file_bytes:
            limit = f"{self._limits.max_mb:g} MB, the limit here"
            raise RefusedError(413, f"{self.names[side]} is larger than {limit}; reduce it", side)
