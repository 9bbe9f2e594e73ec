"""IP addresses: which ones no computer can have, and which pairs cannot share a listening port."""

from __future__ import annotations

import ipaddress

_FIRST_HOST = ipaddress.IPv4Address("1.0.0.0")
_FIRST_RESERVED = ipaddress.IPv4Address("240.0.0.0")


def is_unassignable(address: ipaddress.IPv4Address) -> bool:
    """Whether no computer can have the address (RFC 1122, 3.2.1.3), except 0.0.0.0, which means all."""
    return address >= _FIRST_RESERVED or 0 < int(address) < int(_FIRST_HOST)


def overlap(one: str, other: str) -> bool:
    """Whether two listeners on these hosts cannot have the same port.

    0.0.0.0 is every IPv4 address, :: every address, as altd opens its sockets.
    """
    hosts = ("127.0.0.1" if host == "localhost" else host for host in (one, other))
    first, second = map(ipaddress.ip_address, hosts)
    if "::" in (one, other):
        return True
    if first.version != second.version:
        return False
    return first == second or first.is_unspecified or second.is_unspecified
