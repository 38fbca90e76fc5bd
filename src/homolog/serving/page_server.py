"""A server of one page, with the standard library alone."""

from __future__ import annotations

import socket
import threading
from collections.abc import Mapping
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from homolog.serving.addresses import address_of, free_port, listener
from homolog.serving.guard import MATCH_PAGE_POLICY, SECURITY_HEADERS, HostNames, refusal

# A connection is closed once nothing was received or taken for so long.
_IDLE_SECONDS = 20.0


class PageServer:
    """Serves the page of a match at ``/``, from memory, to browsers that call it by its address.

    No other web page can read it: see ``homolog.serving.guard``. The port is taken when the server is made; browsers
    that connect before ``serve`` wait.

    Args:
        page: HTML.
        host: the address to listen on; ``127.0.0.1`` is reached from this machine alone.
        port: the first one to try, or 0 for any that is free.

    Raises:
        ArgumentError: if there is no such address here, or no port is free.

    Examples:
        >>> server = PageServer("<!DOCTYPE html><title>Hello</title>", port=0)
        >>> server.address.startswith("http://127.0.0.1:")
        True
        >>> server.close()
    """

    def __init__(self, page: str, host: str = "127.0.0.1", port: int = 8080) -> None:
        self._server = _Server(listener(host, free_port(host, port)), HostNames.of(host), page.encode())
        self.address = address_of(host, self._server.server_port)

    def serve(self) -> None:
        """Serve until ``end`` is called."""
        self._server.serve_forever(poll_interval=0.1)

    def end(self) -> None:
        """Let ``serve`` return soon; from a signal's handler or another thread."""
        # `shutdown` waits for `serve_forever`, which cannot go on before a handler in its own thread returns.
        threading.Thread(target=self._server.shutdown).start()

    def close(self) -> None:
        """Release the port."""
        self._server.server_close()


class _Server(ThreadingHTTPServer):
    def __init__(self, bound: socket.socket, names: HostNames, page: bytes) -> None:
        address = bound.getsockname()
        super().__init__(address, _PageHandler, bind_and_activate=False)
        self.socket.close()
        self.socket, self.server_port = bound, address[1]
        self.names, self.page = names, page
        self.server_activate()

    def handle_error(self, request: socket.socket | tuple[bytes, socket.socket], client_address: Any) -> None:
        """Say nothing of a connection that broke off."""


class _PageHandler(BaseHTTPRequestHandler):
    server: _Server
    server_version, sys_version = "Homolog", ""
    timeout = _IDLE_SECONDS

    def do_GET(self) -> None:
        if (reason := refusal(self.headers, self.server.names)) is not None:
            self._answer(HTTPStatus.FORBIDDEN, reason.encode(), {"Content-Type": "text/plain; charset=utf-8"})
        elif self.path.partition("?")[0] != "/":
            self._answer(HTTPStatus.NOT_FOUND, b"", {})
        else:
            headers = {"Content-Type": "text/html; charset=utf-8", "Content-Security-Policy": MATCH_PAGE_POLICY}
            self._answer(HTTPStatus.OK, self.server.page, headers)

    def _answer(self, status: HTTPStatus, content: bytes, headers: Mapping[str, str]) -> None:
        self.send_response(status)
        for name, value in {**SECURITY_HEADERS, **headers, "Content-Length": str(len(content))}.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, *_: object) -> None:
        """Log no requests: stderr belongs to the command."""
