"""Token buckets: how often somebody may ask, with a memory that stays small whoever asks."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass

from altd.ports import Clock

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
