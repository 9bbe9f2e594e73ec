"""Where an interface asks for a self-check and reads what the last one said."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from dataclasses import dataclass


class NoSelfCheckError(Exception):
    """The unit cannot check itself; the sentence says why."""


@dataclass(frozen=True, slots=True)
class SelfCheckReport:
    """What one check said: its number since the start, a sentence for people, and plain JSON types."""

    number: int
    sentence: str
    document: Mapping[str, object]


class SelfCheckDesk:
    """``unavailable`` says why there is no self-check; empty once there is one, which is told of requests."""

    def __init__(self) -> None:
        self.unavailable = "this unit has no frame LEDs that the daemon switches"
        self.latest: SelfCheckReport | None = None
        self.waiting = 0
        """Who waits for a report."""
        self._begun = 0
        self.on_ask: Callable[[str], None] = lambda by: None
        """Is told who asks."""
        self._on_request: Callable[[], None] = lambda: None
        self._changed = asyncio.Event()

    def open(self, on_request: Callable[[], None]) -> None:
        """From now on checks can be asked for."""
        self.unavailable, self._on_request = "", on_request

    def begin(self) -> int:
        """A check begins; returns its number."""
        self._begun += 1
        return self._begun

    def put_up(self, report: SelfCheckReport) -> None:
        """A check has ended."""
        self.latest = report
        self._changed.set()
        self._changed = asyncio.Event()

    def ask(self, by: str = "") -> int:
        """Ask for a check, which comes within seconds; returns its number. Raises NoSelfCheckError.

        ``by`` is who asks, for the events.
        """
        if self.unavailable:
            raise NoSelfCheckError(self.unavailable)
        self.on_ask(by)
        self._on_request()
        return self._begun + 1

    async def report(self, number: int) -> SelfCheckReport:
        """What check ``number`` said, or one after it, once it has ended."""
        self.waiting += 1
        try:
            while self.latest is None or self.latest.number < number:
                await self._changed.wait()
            return self.latest
        finally:
            self.waiting -= 1
