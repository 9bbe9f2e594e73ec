"""Which clients may connect, and how often an address may ask; the memory for it is limited."""

from __future__ import annotations

import socket
from collections import OrderedDict
from collections.abc import Iterable
from dataclasses import dataclass

from altd.ports import Clock
from altd.tcp_port import Networks, address_of, is_loopback


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
    """Clients that may connect: the unit's own computer, and the networks; all clients if none is named."""

    def __init__(self, networks: Iterable[str]) -> None:
        self._networks = Networks(networks)

    def __contains__(self, host: str) -> bool:
        if not self._networks:
            return True
        address = address_of(host)
        return is_loopback(address) or address in self._networks


MAX_KEYS = 1024
"""Of so many the last asking is remembered; who was longest silent is forgotten, which is to be forgiven."""


@dataclass(frozen=True, slots=True)
class Rate:
    """So many at once, and so many a second for ever."""

    burst: int
    per_s: float


REQUESTS = Rate(burst=100, per_s=50.0)
"""Of one address: ten browsers behind one address ask for some 20 a second, a request takes about 1 ms."""

CONNECTIONS = Rate(burst=200, per_s=100.0)
"""Of one address, where a connection costs a TLS handshake, before a byte of it is read."""

ATTEMPTS = Rate(burst=5, per_s=0.1)
"""Wrong passwords of one address."""

ALL_ATTEMPTS = Rate(burst=20, per_s=0.2)
"""The same of all addresses that have not logged in: a password that is tried takes 0.2 s of a core."""

MAX_FAMILIAR = 16
"""Addresses that have logged in, the last of them: each has its own attempts, whatever others try."""


class Buckets:
    """A bucket of tokens for each key, filled by the monotonic clock."""

    def __init__(self, rate: Rate, clock: Clock) -> None:
        self._rate = rate
        self._clock = clock
        self._full_ns: OrderedDict[str, int] = OrderedDict()
        """When each bucket will be full again; the one that was used last comes last."""

    def wait_s(self, key: str) -> float:
        """Seconds until there is a token again; 0: there is one."""
        lacking_ns = self._full_ns.get(key, 0) - self._clock.monotonic_ns()
        room_ns = round((self._rate.burst - 1) / self._rate.per_s * 1e9)
        return max(lacking_ns - room_ns, 0) * 1e-9

    def take(self, key: str) -> float:
        """Take a token; returns the seconds until there is one again, where there is none: 0, it is taken."""
        if wait_s := self.wait_s(key):
            return wait_s
        now_ns = self._clock.monotonic_ns()
        self._full_ns[key] = max(self._full_ns.get(key, 0), now_ns) + round(1e9 / self._rate.per_s)
        self._full_ns.move_to_end(key)
        if len(self._full_ns) > MAX_KEYS:
            self._full_ns.popitem(last=False)
        return 0.0

    def give_back(self, key: str) -> None:
        """What was taken was not used."""
        if key in self._full_ns:
            self._full_ns[key] -= round(1e9 / self._rate.per_s)
