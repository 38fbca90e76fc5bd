"""Connections that are closed when nothing comes of them, and of which no one has too many."""

from __future__ import annotations

import asyncio

from uvicorn.protocols.http.h11_impl import H11Protocol

from homolog.serving.addresses import client_network

# For the next request's head to come as a whole, and for some of an answer to be taken.
_PATIENCE_SECONDS = 20.0


class PatientProtocol(H11Protocol):
    """A connection that is closed once the other end is waited for too long.

    The server's own protocol waits for ever: for a first request, for the rest of one that has begun, and for whoever
    does not read an answer. For what a request brings wait those who read it. No address holds more than half of the
    connections at which others are turned away.
    """

    client_network: str | None = None
    _patience: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Wait for a request, unless its sender has too many connections already."""
        super().connection_made(transport)
        self.client_network = client_network(self.client[0]) if self.client else None
        if self._is_one_too_many():
            transport.abort()
        else:
            self._wait()

    def connection_lost(self, exc: Exception | None) -> None:
        """Wait no longer."""
        super().connection_lost(exc)
        if self._patience is not None:
            self._patience.cancel()

    def on_response_complete(self) -> None:
        """Wait for the next request."""
        self._wait()
        super().on_response_complete()

    def pause_writing(self) -> None:
        """Wait for what was sent to be taken."""
        super().pause_writing()
        self._wait()

    def _is_one_too_many(self) -> bool:
        if self.client_network is None or self.limit_concurrency is None:
            return False
        of_one = [other for other in self.connections if getattr(other, "client_network", None) == self.client_network]
        return len(of_one) > self.limit_concurrency // 2

    def _wait(self) -> None:
        """Begin to wait; whatever is waited for next begins here again, so that the last time to give up counts."""
        if self._patience is not None:
            self._patience.cancel()
        self._patience = self.loop.call_later(_PATIENCE_SECONDS, self._give_up)

    def _give_up(self) -> None:
        if self.flow.write_paused or self.cycle is None or self.cycle.response_complete:
            self.transport.abort()
