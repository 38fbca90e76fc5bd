"""Whose address it is that asks, so that no one takes what is there for all."""

from __future__ import annotations

import ipaddress


def household(host: str) -> str | None:
    """What counts as one user: an address, or the network of one by IPv6, where a user has a whole network.

    Returns:
        None for this machine: behind a proxy or a forwarded port, all its users have one address.
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
