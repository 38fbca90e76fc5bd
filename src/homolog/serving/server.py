"""Listening, until told to end."""

from __future__ import annotations

import socket
import tempfile
from collections.abc import Iterable
from pathlib import Path

import uvicorn

from homolog.serving.app import make_app
from homolog.serving.command import MatchCommand
from homolog.serving.guard import own_names
from homolog.serving.jobs import Jobs
from homolog.serving.limits import Limits
from homolog.serving.page import upload_page
from homolog.viewing import address_of, free_port, listener

# For answers that are being sent when the server ends.
_LAST_SECONDS = 5
_CONNECTIONS_PER_PLACE = 16


class MatchServer:
    """Serves a page that matches two files that are dropped on it.

    All that it writes lies in a temporary folder of its own, which goes when it ends.

    Args:
        command: what makes a match.
        limits: how many matches there may be, and what each may take.
        host: the address to listen on; ``127.0.0.1`` is reached from this machine alone.
        port: the first one to try, or 0 for any that is free.
        names: other names that browsers may call it by.
        made_with: in a few words, how matches are made.

    Raises:
        ArgumentError: if there is no such address here, or no port is free.
    """

    def __init__(
        self,
        command: MatchCommand,
        limits: Limits,
        *,
        host: str = "127.0.0.1",
        port: int = 8080,
        names: Iterable[str] = (),
        made_with: str = "",
    ) -> None:
        self._socket = listener(host, free_port(host, port))
        self._socket.listen()  # from now on browsers wait, and are not turned away
        self.address = address_of(host, self._socket.getsockname()[1])
        self._folder = tempfile.TemporaryDirectory(prefix="homolog-serve-", ignore_cleanup_errors=True)
        jobs = Jobs(Path(self._folder.name), command, limits)
        app = make_app(jobs, upload_page(limits, made_with), own_names(host, names))
        config = uvicorn.Config(
            app,
            http="h11",
            ws="none",
            loop="asyncio",
            log_config=None,
            access_log=False,
            server_header=False,
            proxy_headers=False,
            limit_concurrency=_CONNECTIONS_PER_PLACE * limits.places,
            timeout_graceful_shutdown=_LAST_SECONDS,
        )
        self._server = _Server(config, jobs)

    @property
    def folder(self) -> Path:
        """Where it keeps what it is given and what it makes, while it serves."""
        return Path(self._folder.name)

    def serve(self) -> None:
        """Serve until ``end`` is called, or a signal comes; matches that are under way are ended."""
        with self._folder, self._socket:
            self._server.run(sockets=[self._socket])

    def end(self) -> None:
        """Let ``serve`` return soon; from a signal's handler or another thread."""
        self._server.should_exit = True


class _Server(uvicorn.Server):
    def __init__(self, config: uvicorn.Config, jobs: Jobs) -> None:
        super().__init__(config)
        self._matches = jobs

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Matches end before their pages are waited for, which would listen to them for ever."""
        self._matches.close()
        await super().shutdown(sockets)
