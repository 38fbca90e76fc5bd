"""Where a page is served: a free port, and the address that a browser opens."""

from __future__ import annotations

import errno
import os
import socket

from homolog.core.errors import ArgumentError

_PORTS = 100


def free_port(host: str, port: int) -> int:
    """The first port from ``port`` on that can be listened on; 0 stays, for any.

    Raises:
        ArgumentError: if the address is none of this machine's, or no port is free.
    """
    for candidate in range(port, min(port + _PORTS, 1 << 16)):
        try:
            listener(host, candidate).close()
        except OSError as fault:
            if fault.errno not in (errno.EADDRINUSE, errno.EACCES):
                raise ArgumentError(
                    f"host is {host!r}, which cannot be listened on ({fault.strerror}); "
                    "give an address of this machine, or leave it out"
                ) from None
            continue
        return candidate
    raise ArgumentError(f"port is {port}, but no port from there on is free; give another, or 0 for any")


def listener(host: str, port: int) -> socket.socket:
    """A socket that has a port of this machine for itself, not listening as yet.

    Raises:
        OSError: what the system says against it.
    """
    family, kind, *_, place = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)[0]
    found = socket.socket(family, kind)
    try:
        found.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, int(os.name == "posix"))
        found.bind(place)
    except OSError:
        found.close()
        raise
    return found


def address_of(host: str, port: int) -> str:
    """What to open in a browser on this machine, for a server that listens at ``host``."""
    name = "127.0.0.1" if host in ("0.0.0.0", "") else host
    return f"http://{f'[{name}]' if ':' in name else name}:{port}"
