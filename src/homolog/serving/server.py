"""The server of the page that matches."""

from __future__ import annotations

import socket
from collections.abc import Iterable
from pathlib import Path

import uvicorn

from homolog.serving.addresses import address_of, free_port, listener
from homolog.serving.app import make_app
from homolog.serving.command import MatchCommand
from homolog.serving.connection import TimeoutProtocol
from homolog.serving.folder import ServerFolder
from homolog.serving.guard import HostNames
from homolog.serving.jobs import Jobs
from homolog.serving.limits import Limits
from homolog.serving.page import upload_page

# For answers that are being sent when the server ends.
_SHUTDOWN_SECONDS = 5
_CONNECTIONS_PER_MATCH = 16
# Proxies there are trusted to say whose request they pass on.
_PROXIES = ["127.0.0.1", "::1"]


class MatchServer:
    """Serves a page that matches two files that are dropped on it.

    All that it writes lies in a temporary folder of its own, which goes when it ends, or if it is killed, when the next
    one is made.

    Args:
        command: what makes a match.
        limits: how many matches there may be, and what each may take.
        host: the address to listen on; ``127.0.0.1`` is reached from this machine alone.
        port: the first one to try, or 0 for any that is free.
        names: other names that browsers may call it by, or a proxy before it.
        made_with: in a few words, how matches are made.

    Raises:
        ArgumentError: if there is no such address here, no port is free, or a name is none.
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
        host_names = HostNames.of(host, names)
        self._socket = listener(host, free_port(host, port))
        self._socket.listen()  # from now on browsers wait, and are not refused
        self.address = address_of(host, self._socket.getsockname()[1])
        self._folder = ServerFolder()
        jobs = Jobs(self.folder, command, limits)
        app = make_app(jobs, upload_page(limits, made_with), host_names)
        config = uvicorn.Config(
            app,
            http=TimeoutProtocol,
            ws="none",
            loop="asyncio",
            log_config=None,
            access_log=False,
            server_header=False,
            forwarded_allow_ips=_PROXIES,
            limit_concurrency=_CONNECTIONS_PER_MATCH * limits.admitted,
            timeout_graceful_shutdown=_SHUTDOWN_SECONDS,
        )
        self._server = _Server(config, jobs)

    @property
    def folder(self) -> Path:
        """Where it keeps what it is given and what it makes, while it serves."""
        return self._folder.path

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
        self._jobs = jobs

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Cancel matches first: their pages follow them until they end."""
        self._jobs.close()
        await super().shutdown(sockets)
