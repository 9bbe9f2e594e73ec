"""From the cameras' threads to the event loop: one slot per camera, the newest frame wins."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Iterable
from dataclasses import replace

from altd.records import Frame


class Inbox:
    """Slots that camera threads fill and the pipeline empties; what is replaced untaken is counted."""

    def __init__(self, cameras: Iterable[str]) -> None:
        self._loop = asyncio.get_running_loop()
        self._ready = asyncio.Event()
        self._taken = threading.Condition()
        self._slots: dict[str, Frame] = {}
        self._closed = False
        self.dropped = dict.fromkeys(cameras, 0)
        """Frames per camera that nobody took in time."""

    def put(self, frame: Frame, wait: bool) -> None:
        """Fill a camera's slot, from its thread; with ``wait`` only when the slot is empty.

        The mark of a change of exposure is not lost with the frame that bore it.
        """
        with self._taken:
            while wait and frame.camera in self._slots and not self._closed:
                self._taken.wait()
            if self._closed:
                return
            if (untaken := self._slots.get(frame.camera)) is not None:
                self.dropped[frame.camera] += 1
                if untaken.changing:
                    frame = replace(frame, changing=True)
            self._slots[frame.camera] = frame
            self._loop.call_soon_threadsafe(self._ready.set)

    @property
    def waiting(self) -> bool:
        """Whether a frame is there to be taken."""
        return bool(self._slots)

    def tick(self) -> None:
        """Wake the reader without a frame, from the loop."""
        self._ready.set()

    async def take(self) -> list[Frame]:
        """All waiting frames, oldest first; empty after a tick."""
        await self._ready.wait()
        with self._taken:
            self._ready.clear()
            frames = sorted(self._slots.values(), key=lambda frame: frame.t_ns)
            self._slots.clear()
            self._taken.notify_all()
        return frames

    def close(self) -> None:
        """Let waiting threads go; later frames are not kept."""
        with self._taken:
            self._closed = True
            self._taken.notify_all()
