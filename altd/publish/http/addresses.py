"""Addresses of clients, whether they may connect, whom they count as; and what the unit itself is called."""

from __future__ import annotations

import ipaddress
import socket
from collections.abc import Iterable

Address = ipaddress.IPv4Address | ipaddress.IPv6Address

_V6_GROUP_BITS = 64
"""A host has a whole network of IPv6 addresses for itself (RFC 4291, 2.5.4)."""


def address_of(host: str) -> Address | None:
    """The address that a socket names: an IPv4 one where IPv6 only wraps it, without a zone; None: none."""
    try:
        address = ipaddress.ip_address(host.partition("%")[0])
    except ValueError:
        return None
    return (address.ipv4_mapped or address) if isinstance(address, ipaddress.IPv6Address) else address


def is_loopback(address: Address | None) -> bool:
    """Whether it is the computer's own."""
    return address is not None and address.is_loopback


def group_of(address: Address) -> str:
    """Whom limits count it for: itself, or its network of IPv6."""
    if isinstance(address, ipaddress.IPv6Address):
        return str(ipaddress.IPv6Network((address, _V6_GROUP_BITS), strict=False))
    return str(address)


def host_of(header: str) -> str:
    """The name or address in a header ``Host``, without the port."""
    if header.startswith("["):
        return header[1:].partition("]")[0]
    return header.partition(":")[0]


class OwnNames:
    """What a browser may call the unit: an address, the computer's own name, and ``names``.

    Any other name may be one that a page of elsewhere has bent to the unit's address (DNS rebinding), so as
    to read what the browser's computer can.
    """

    def __init__(self, names: Iterable[str]) -> None:
        own = socket.gethostname().lower()
        short = own.partition(".")[0]
        self._names = {"", "localhost", own, short, f"{short}.local", *(name.lower() for name in names)}

    def __contains__(self, header: str) -> bool:
        host = host_of(header)
        return address_of(host) is not None or host.lower().removesuffix(".") in self._names


class Allowed:
    """Who may connect: the unit's own computer, and the networks; where none is named, everybody."""

    def __init__(self, networks: Iterable[str]) -> None:
        self._networks = tuple(map(ipaddress.ip_network, networks))

    def __contains__(self, host: str) -> bool:
        if not self._networks:
            return True
        address = address_of(host)
        if address is None or address.is_loopback:
            return address is not None
        return any(address in network for network in self._networks)
