"""IP addresses of TCP clients: how to read them, and which of them limits count as one client."""

from __future__ import annotations

import ipaddress
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
    """The client that limits count it as: the address itself, or its network of IPv6."""
    if isinstance(address, ipaddress.IPv6Address):
        return str(ipaddress.IPv6Network((address, _V6_GROUP_BITS), strict=False))
    return str(address)


class Networks:
    """Networks of IP addresses, as the settings name them."""

    def __init__(self, networks: Iterable[str]) -> None:
        self._networks = tuple(map(ipaddress.ip_network, networks))

    def __bool__(self) -> bool:
        return bool(self._networks)

    def __contains__(self, address: Address | None) -> bool:
        return address is not None and any(address in network for network in self._networks)
