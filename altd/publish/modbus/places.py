"""Which client makes room where all places are taken.

Three quarters of the places belong to the clients that have asked for longest. An address keeps its time when
its connection ends, so that a controller that reconnects is not new. The last quarter goes to new connections
in turn: each gets a place until as many have come after it as there are such places, time enough to ask.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

QUIET_S = 60.0
"""A connection without a request for so long has no claim to its place; a longer gap counts as this one."""

FIRST_REQUEST_S = 5.0
"""A new connection without a request for so long makes room before others."""

KEPT_SHARE = 0.75
MAX_KEPT_OF_ONE_ADDRESS = 8

MAX_REMEMBERED = 1024
"""Addresses whose time is kept when the memory, twice as large, is full."""


@dataclass(slots=True)
class Asking:
    """For how long a client has been asking: the sum of the gaps between its requests, none above a limit."""

    total_s: float = 0.0
    """Until the last request."""
    gap_s: float = 0.0
    """Before the last request."""
    last_s: float | None = None

    def ask(self, now_s: float) -> None:
        """Count a request."""
        if self.last_s is not None:
            self.gap_s = min(now_s - self.last_s, QUIET_S)
            self.total_s += self.gap_s
        self.last_s = now_s

    def until_s(self, now_s: float) -> float:
        """The total until now while the next request is not overdue: slow clients count as fast ones do."""
        return 0.0 if self.last_s is None else self.total_s + min(now_s - self.last_s, self.gap_s)


@dataclass(slots=True, eq=False)
class Connection:
    """A connection since ``since_s``; ``of_address`` is shared by the connections of its address."""

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
        """Whether it has not asked for too long."""
        if self.itself.last_s is None:
            return now_s - self.since_s > FIRST_REQUEST_S
        return now_s - self.itself.last_s > QUIET_S


def connection_to_displace(
    present: Sequence[Connection], newcomer: Connection, now_s: float
) -> Connection | None:
    """The connection that makes room for a newcomer; None: the newcomer gets no place."""
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
    """Three quarters of the connections at most: of those that ask, those of the longest asking addresses."""
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
    """For how long each address has been asking, in a bounded memory."""

    def __init__(self) -> None:
        self._asking: dict[str, Asking] = {}

    def __len__(self) -> int:
        return len(self._asking)

    def asking(self, address: str) -> Asking:
        """The record of an address, which its connections share."""
        if address not in self._asking:
            if len(self._asking) >= 2 * MAX_REMEMBERED:
                self._forget()
            self._asking[address] = Asking()
        return self._asking[address]

    def _forget(self) -> None:
        by_time = sorted(self._asking.items(), key=lambda item: (item[1].total_s, item[1].last_s or 0.0))
        self._asking = dict(by_time[-MAX_REMEMBERED:])
