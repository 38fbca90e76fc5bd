"""Connections with a timeout, and a limit on those of one client."""

from __future__ import annotations

import asyncio

from uvicorn.protocols.http.h11_impl import H11Protocol

from homolog.serving.addresses import client_network

# For the next request's head to come as a whole, and for some of an answer to be taken.
_IDLE_SECONDS = 20.0


class TimeoutProtocol(H11Protocol):
    """An HTTP connection that is closed when it is idle for too long.

    uvicorn's protocol waits without end for a first request, for the rest of one that has begun, and for a client that
    does not read an answer. The body of a request is waited for by those who read it. No client holds more than half
    of the connections at which others are refused.
    """

    client_network: str | None = None
    _idle_timer: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Wait for a request, unless its client has too many connections already."""
        super().connection_made(transport)
        self.client_network = client_network(self.client[0]) if self.client else None
        if self._exceeds_limit():
            transport.abort()
        else:
            self._restart_timer()

    def connection_lost(self, exc: Exception | None) -> None:
        """Wait no longer."""
        super().connection_lost(exc)
        if self._idle_timer is not None:
            self._idle_timer.cancel()

    def on_response_complete(self) -> None:
        """Wait for the next request."""
        self._restart_timer()
        super().on_response_complete()

    def pause_writing(self) -> None:
        """Wait for what was sent to be taken."""
        super().pause_writing()
        self._restart_timer()

    def _exceeds_limit(self) -> bool:
        if self.client_network is None or self.limit_concurrency is None:
            return False
        networks = [getattr(other, "client_network", None) for other in self.connections]
        return networks.count(self.client_network) > self.limit_concurrency // 2

    def _restart_timer(self) -> None:
        """Wait anew: whatever is waited for next has the full time."""
        if self._idle_timer is not None:
            self._idle_timer.cancel()
        self._idle_timer = self.loop.call_later(_IDLE_SECONDS, self._close_if_idle)

    def _close_if_idle(self) -> None:
        if self.flow.write_paused or self.cycle is None or self.cycle.response_complete:
            self.transport.abort()
