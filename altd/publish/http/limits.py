"""Which clients may connect, and how often an address may ask."""

from __future__ import annotations

import socket
from collections.abc import Iterable

from altd.tcp_port import Networks, Rate, address_of, is_loopback


def host_of(header: str) -> str:
    """The name or address in a header ``Host``, without the port."""
    if header.startswith("["):
        return header[1:].partition("]")[0]
    return header.partition(":")[0]


class OwnNames:
    """The names by which a browser may address the unit: an address, the computer's own name, and ``names``.

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
    """Clients that may connect: the unit's own computer, and the networks; all clients if none is named."""

    def __init__(self, networks: Iterable[str]) -> None:
        self._networks = Networks(networks)

    def __contains__(self, host: str) -> bool:
        if not self._networks:
            return True
        address = address_of(host)
        return is_loopback(address) or address in self._networks


REQUESTS = Rate(burst=100, per_s=50.0)
"""Of one address: ten browsers behind one address ask for some 20 a second, a request takes about 1 ms."""

ATTEMPTS = Rate(burst=5, per_s=0.1)
"""Wrong passwords of one address."""

ALL_ATTEMPTS = Rate(burst=20, per_s=0.2)
"""The same of all addresses that have not logged in: a password that is tried takes 0.2 s of a core."""

MAX_FAMILIAR = 16
"""Addresses that have logged in, the last of them: each has its own attempts, whatever others try."""
