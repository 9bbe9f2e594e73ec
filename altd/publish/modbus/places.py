"""Selection of the connection to displace when all places are taken.

Three quarters of the places belong to the clients that have sent requests for longest. An address keeps its
time when its connection ends, so a reconnecting controller is not new. The last quarter has new connections
in turn; each stays until as many newer ones have arrived as the quarter has places, enough for a request.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

QUIET_S = 60.0
"""Time without a request until a connection loses its claim to a place; longer gaps count as this one."""

FIRST_REQUEST_S = 5.0
"""Time without a first request after which a new connection is displaced before others."""

KEPT_SHARE = 0.75
MAX_KEPT_OF_ONE_ADDRESS = 8

MAX_REMEMBERED = 1024
"""Number of addresses whose time is kept when the memory, twice as large, is full."""


@dataclass(slots=True)
class Asking:
    """Time for which a client has sent requests: the sum of the gaps between them, each up to ``QUIET_S``."""

    total_s: float = 0.0
    """Sum up to the last request."""
    gap_s: float = 0.0
    """Gap before the last request."""
    last_s: float | None = None

    def ask(self, now_s: float) -> None:
        """Count a request."""
        if self.last_s is not None:
            self.gap_s = min(now_s - self.last_s, QUIET_S)
            self.total_s += self.gap_s
        self.last_s = now_s

    def until_s(self, now_s: float) -> float:
        """Return the total up to now, at most to the next due request: slow clients count like fast ones."""
        return 0.0 if self.last_s is None else self.total_s + min(now_s - self.last_s, self.gap_s)


@dataclass(slots=True, eq=False)
class Connection:
    """A connection, open since ``since_s``; the connections of an address share ``of_address``."""

    address: str
    since_s: float
    of_address: Asking
    is_reserved: bool = False
    may_command: bool = False
    itself: Asking = field(default_factory=Asking)

    def ask(self, now_s: float) -> None:
        """Count a request."""
        self.itself.ask(now_s)
        self.of_address.ask(now_s)

    def is_quiet(self, now_s: float) -> bool:
        """Whether it has sent no request for too long."""
        if self.itself.last_s is None:
            return now_s - self.since_s > FIRST_REQUEST_S
        return now_s - self.itself.last_s > QUIET_S


def connection_to_displace(
    present: Sequence[Connection], newcomer: Connection, now_s: float
) -> Connection | None:
    """Return the connection to displace for a newcomer; None: the newcomer gets no place."""
    displaceable = [connection for connection in present if not connection.is_reserved]
    if newcomer.is_reserved and not displaceable:
        displaceable = list(present)
    kept = _kept(displaceable, now_s)
    others = [connection for connection in displaceable if connection not in kept]
    if not others:
        return kept[-1] if newcomer.is_reserved and kept else None
    crowd = Counter(connection.address for connection in others)

    def claim(connection: Connection) -> tuple[bool, int, float]:
        return not connection.is_quiet(now_s), -crowd[connection.address], connection.since_s

    return min(others, key=claim)


def _kept(connections: Sequence[Connection], now_s: float) -> list[Connection]:
    """Return the active connections of the addresses active for longest, at most three quarters of all."""
    asking = [
        connection
        for connection in connections
        if connection.of_address.last_s is not None and not connection.is_quiet(now_s)
    ]
    asking.sort(key=lambda each: (-each.of_address.until_s(now_s), -each.itself.until_s(now_s), each.since_s))
    kept, of_address = list[Connection](), Counter[str]()
    for connection in asking:
        of_address[connection.address] += 1
        if of_address[connection.address] <= MAX_KEPT_OF_ONE_ADDRESS:
            kept.append(connection)
    return kept[: math.ceil(len(connections) * KEPT_SHARE)]


class Addresses:
    """Time for which each address has sent requests, in a limited memory."""

    def __init__(self) -> None:
        self._asking: dict[str, Asking] = {}

    def __len__(self) -> int:
        return len(self._asking)

    def asking(self, address: str) -> Asking:
        """Return the record of an address, which its connections share."""
        if address not in self._asking:
            if len(self._asking) >= 2 * MAX_REMEMBERED:
                self._forget()
            self._asking[address] = Asking()
        return self._asking[address]

    def _forget(self) -> None:
        by_time = sorted(self._asking.items(), key=lambda item: (item[1].total_s, item[1].last_s or 0.0))
        self._asking = dict(by_time[-MAX_REMEMBERED:])
