"""What is newest of each camera, from their threads to the event loop."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable, Iterable
from typing import Generic, Protocol, TypeVar

from altd.ports import Clock


class FromCamera(Protocol):
    """What a camera gives: a frame, or what was found in one."""

    @property
    def camera(self) -> str:
        """The camera's name."""

    @property
    def t_ns(self) -> int:
        """The middle of the exposure."""


Item = TypeVar("Item", bound=FromCamera)


class LatestOfEach(Generic[Item]):
    """A slot for each camera, between their threads and the event loop, which is woken once a frame set.

    An item alone, of several cameras, completes no set: it waits in its slot until each camera has given one,
    or until one has given its next, which says that a partner is late. Then the loop is woken. A slot has
    ``room`` for so many that a loop which was woken has not taken yet; then the newest replaces the oldest.
    ``merge`` makes one of the dropped item and the one after it.
    """

    def __init__(
        self,
        cameras: Iterable[str],
        clock: Clock,
        merge: Callable[[Item, Item], Item] = lambda dropped, newer: newer,
        room: int = 1,
    ) -> None:
        self._loop = asyncio.get_running_loop()
        self._clock = clock
        self._merge = merge
        self._room = room
        self._ready = asyncio.Event()
        self._taken = threading.Condition()
        self._slots: dict[str, list[Item]] = {camera: [] for camera in cameras}
        """Oldest first."""
        self._is_woken = False
        """The loop was told of all that is in the slots, and has not taken it yet."""
        self._wake_for_each = False
        self._is_closed = False
        self.dropped = dict.fromkeys(self._slots, 0)
        """Items per camera that nobody took in time."""
        self.delivered_ns: int | None = None
        """When a camera delivered last."""

    def put(self, item: Item, wait: bool) -> None:
        """Fill a camera's slot, from a thread of its own; with ``wait`` only when the slot is empty."""
        with self._taken:
            slot = self._slots[item.camera]
            while wait and slot and not self._is_closed:
                self._wake()  # its partner is late, or it would have been taken
                self._taken.wait()
            if self._is_closed:
                return
            self.delivered_ns = self._clock.monotonic_ns()
            slot.append(item)
            while len(slot) > self._room and self._is_woken:
                dropped = slot.pop(0)
                slot[0] = self._merge(dropped, slot[0])
                self.dropped[item.camera] += 1
            if self._wake_for_each or len(slot) > 1 or all(self._slots.values()):
                self._wake()

    @property
    def is_empty(self) -> bool:
        """Whether nothing waits to be taken."""
        return not any(self._slots.values())

    def wake(self) -> None:
        """Let the reader look, from the loop, whatever there is."""
        self._ready.set()

    async def take(self, wake_for_each: bool) -> list[Item]:
        """All that waits, oldest first; may be nothing.

        ``wake_for_each``: what the reader has taken before waits for a partner, so that each single item may
        complete a set.
        """
        with self._taken:
            self._wake_for_each = wake_for_each
            if wake_for_each and not self.is_empty:
                self._ready.set()
        await self._ready.wait()
        with self._taken:
            self._ready.clear()
            self._is_woken = False
            items = sorted(
                (item for slot in self._slots.values() for item in slot), key=lambda item: item.t_ns
            )
            for slot in self._slots.values():
                slot.clear()
            self._taken.notify_all()
        return items

    def close(self) -> None:
        """Let waiting threads go; what comes later is not kept."""
        with self._taken:
            self._is_closed = True
            self._taken.notify_all()

    def _wake(self) -> None:
        if not self._is_woken:
            self._is_woken = True
            self._loop.call_soon_threadsafe(self._ready.set)
