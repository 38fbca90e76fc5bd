"""Who may talk to the server: its own page, called by a name that is the server's own; and what browsers are told."""

from __future__ import annotations

import ipaddress
import re
import socket
from collections.abc import Iterable
from dataclasses import dataclass
from urllib.parse import urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import JSONResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from homolog.core.errors import bad_value

_HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "default-src 'none'; frame-ancestors 'none'",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Permissions-Policy": "camera=(), geolocation=(), microphone=()",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}


_HOST_NAME = re.compile(r"[a-z0-9_-]+(\.[a-z0-9_-]+)*")
_STANDARD_PORTS = {"http": ":80", "https": ":443"}


@dataclass(frozen=True)
class Names:
    """The names by which browsers may call a server, in lower case, besides any address in numbers.

    Args:
        own: those that requests may be sent to.
        public: those of them that were given to it. A page from there, at the standard port, is the server's own: a
            proxy may call the server by another name than browsers call the proxy.
    """

    own: frozenset[str]
    public: frozenset[str]


def names_of(host: str, public: Iterable[str] = ()) -> Names:
    """The names of a server that listens at ``host``.

    Raises:
        ArgumentError: if one of ``public`` is none.
    """
    given = frozenset(map(_checked, public))
    listening = {name.lower().rstrip(".") for name in ("localhost", socket.gethostname(), host) if name}
    return Names(given | listening, given)


def _checked(name: str) -> str:
    plain = name.lower().removesuffix(".")
    if not _HOST_NAME.fullmatch(plain):
        raise bad_value("name", name, "a host's name alone, such as shapes.example.org: no scheme, port or path")
    return plain


class Guard:
    """Turns away what other sites send, and adds headers that bind browsers to every answer.

    A site can have its own name lead to this machine (DNS rebinding), so that a browser takes the server for a part of
    it: the name that is called must be the server's own. An address in numbers is no name that a site could own.

    Args:
        app: what is guarded.
        names: those of the server.
    """

    def __init__(self, app: ASGIApp, names: Names) -> None:
        self._app, self._names = app, names

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        refusal = self._refusal(Headers(scope=scope))
        app = self._app if refusal is None else JSONResponse({"error": refusal}, 403)
        await app(scope, receive, _with_headers(send))

    def _refusal(self, headers: Headers) -> str | None:
        called = headers.get("host", "")
        if not self._is_own(called):
            return "this server does not go by that name; open the address that it printed, or allow the name there"
        origin = headers.get("origin")
        if origin is not None and not self._is_home(origin.lower(), called.lower()):
            return "other sites may not use this server"
        if headers.get("sec-fetch-site", "none") not in ("none", "same-origin") and _asks_for_data(headers):
            return "other sites may not use this server"
        return None

    def _is_own(self, called: str) -> bool:
        try:
            name = (urlsplit(f"//{called}").hostname or "").rstrip(".")
        except ValueError:
            return False
        return name in self._names.own or _is_address(name)

    def _is_home(self, origin: str, called: str) -> bool:
        """Whether a page is the server's; the scheme is that of whatever stands between, if anything does."""
        scheme, _, place = origin.partition("://")
        return place in (called, called.removesuffix(_STANDARD_PORTS.get(scheme, ""))) or place in self._names.public


def _asks_for_data(headers: Headers) -> bool:
    """Whether a page asks, and not someone who follows a link."""
    return headers.get("sec-fetch-mode") != "navigate"


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


def _with_headers(send: Send) -> Send:
    async def sending(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=message)
            for name, value in _HEADERS.items():
                headers.setdefault(name, value)
        await send(message)

    return sending
