"""Who may talk to a server: pages of its own, called by a name of its own; and the headers of every answer.

Independent of any web framework: the server of ``homolog serve`` and that of ``homolog view`` both use it.
"""

from __future__ import annotations

import ipaddress
import re
import socket
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol
from urllib.parse import urlsplit

from homolog.core.errors import bad_value

SECURITY_HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "default-src 'none'; frame-ancestors 'none'",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Permissions-Policy": "camera=(), geolocation=(), microphone=()",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}
"""Of every answer, unless it has its own."""

MATCH_PAGE_POLICY = (
    "sandbox allow-scripts allow-downloads; default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
    "frame-ancestors 'self'"
)
"""The content security policy of a match's page: it runs its own script in an origin of its own, loads
nothing, and may save files."""

_HOST_NAME = re.compile(r"[a-z0-9_-]+(\.[a-z0-9_-]+)*")
_STANDARD_PORTS = {"http": ":80", "https": ":443"}


class Headers(Protocol):
    """The headers of a request; names in any case."""

    def get(self, name: str, default: str) -> str:
        """The value of a header."""


@dataclass(frozen=True)
class HostNames:
    """The names by which browsers may call a server, in lower case, besides any numeric address.

    Args:
        own: those that requests may be sent to.
        public: those of them that were given to it. A page from there, at the standard port, is the server's own: a
            proxy may call the server by another name than browsers call the proxy.
    """

    own: frozenset[str]
    public: frozenset[str]

    @classmethod
    def of(cls, host: str, public: Iterable[str] = ()) -> HostNames:
        """The names of a server that listens at ``host``.

        Raises:
            ArgumentError: if one of ``public`` is not a host's name.
        """
        given = frozenset(map(_checked_name, public))
        listening = {name.lower().rstrip(".") for name in ("localhost", socket.gethostname(), host) if name}
        return cls(given | listening, given)


def _checked_name(name: str) -> str:
    plain = name.lower().removesuffix(".")
    if not _HOST_NAME.fullmatch(plain):
        raise bad_value("name", name, "a host's name alone, such as shapes.example.org: no scheme, port or path")
    return plain


def refusal(headers: Headers, names: HostNames) -> str | None:
    """Why a request is refused, in a line; None if it is allowed.

    A site can have its own name lead to this machine (DNS rebinding), so that a browser takes the server for a part of
    it: the ``Host`` that is called must be the server's own name, or a numeric address, which no site can own. The
    ``Origin``, where there is one, must be the server.

    Args:
        headers: of the request.
        names: those of the server.
    """
    host = headers.get("host", "").lower()
    if not _is_own_host(host, names):
        return "this server does not go by that name; open the address that it printed, or allow the name there"
    origin = headers.get("origin", f"http://{host}").lower()
    scheme, _, place = origin.partition("://")  # by any scheme: a proxy before the server may speak HTTPS
    if place not in (host, host.removesuffix(_STANDARD_PORTS.get(scheme, "")), *names.public):
        return "other sites may not use this server"
    followed_a_link = headers.get("sec-fetch-mode", "") == "navigate"
    if headers.get("sec-fetch-site", "none") not in ("none", "same-origin") and not followed_a_link:
        return "other sites may not use this server"
    return None


def _is_own_host(host: str, names: HostNames) -> bool:
    try:
        name = (urlsplit(f"//{host}").hostname or "").rstrip(".")
    except ValueError:
        return False
    if name in names.own:
        return True
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True
