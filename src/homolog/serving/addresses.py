"""Addresses: the port that a server listens on, what a browser opens, and which client a request comes from."""

from __future__ import annotations

import errno
import ipaddress
import os
import socket

from homolog.core.errors import ArgumentError

_PORTS = 100


def free_port(host: str, port: int) -> int:
    """The first port from ``port`` on that can be listened on; 0 stays, for any.

    Raises:
        ArgumentError: if the address is not one of this machine's, or no port is free.
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
    """A socket bound to a port of this machine, not listening yet.

    Raises:
        OSError: if the system refuses it.
    """
    family, kind, *_, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)[0]
    bound = socket.socket(family, kind)
    try:
        bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, int(os.name == "posix"))
        bound.bind(address)
    except OSError:
        bound.close()
        raise
    return bound


def address_of(host: str, port: int) -> str:
    """The URL that a browser on this machine opens, for a server that listens at ``host``."""
    name = "127.0.0.1" if host in ("0.0.0.0", "") else host
    return f"http://{f'[{name}]' if ':' in name else name}:{port}"


def client_network(host: str) -> str | None:
    """What counts as one client: an IPv4 address, or the /64 network of an IPv6 address, as users have whole networks.

    Returns:
        None for this machine: behind a proxy or a forwarded port, all its users share one address.
    """
    try:
        address = ipaddress.ip_address(host)
    except ValueError:  # a proxy may say anything
        return host
    if isinstance(address, ipaddress.IPv6Address):
        if address.ipv4_mapped is None:
            return None if address.is_loopback else str(ipaddress.IPv6Network((int(address), 64), strict=False))
        address = address.ipv4_mapped
    return None if address.is_loopback else str(address)
