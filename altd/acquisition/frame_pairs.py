"""Frames of all cameras between acquisition and measurement: marked, kept for a while, paired."""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Protocol

from altd.acquisition.kept_frames.ring import FrameRing
from altd.measuring.pairing import Pair, Pairer
from altd.ports import Clock
from altd.records import Frame

steps = logging.getLogger("altd.frames")
"""Logger of each frame's processing steps, for ``altd run --trace-frames``."""

MAX_BEHIND_NS = 1_000_000_000
"""Time in which a delayed reader catches up without a loss; one slower than the cameras never does."""
WAITING_BYTES = 64 << 20
"""Maximum memory of the waiting frame sets; the newest one waits in any case."""


class Marks(Protocol):
    """Marks frames with the state of switched devices during their exposure."""

    def mark(self, frame: Frame) -> Frame:
        """Return the frame with its mark; called in the thread of its camera."""


class FramePairs:
    """The frame sets of the cameras for one reader.

    A reader that was delayed gets all of them; one that has been behind for ``MAX_BEHIND_NS`` gets the newest
    until it has caught up.
    ``arrived`` is called in a camera's thread when a frame set is ready. ``marks`` mark frames exposed under
    LEDs and add the opaque target. ``ring`` keeps the newest frames; None: none are kept.
    """

    def __init__(
        self,
        pairer: Pairer[Frame],
        arrived: Callable[[], None],
        clock: Clock,
        marks: Sequence[Marks] = (),
        ring: FrameRing | None = None,
    ) -> None:
        self._pairer = pairer
        self._arrived = arrived
        self._clock = clock
        self._marks = marks
        self._ring = ring
        self._changed = threading.Condition()
        self._pairs: deque[Pair[Frame]] = deque()
        self._behind_ns: int | None = None
        """Exposure of the first frame set that came since the reader last found none."""
        self._running = set(pairer.cameras)
        self._is_closed = False
        self._changing: set[str] = set()
        """Cameras of which a frame marked ``changing`` was dropped: the next frame gets the mark."""
        self.dropped = dict.fromkeys(pairer.cameras, 0)
        """Number of frames per camera that were replaced before they were taken."""
        self.delivered_ns = 0
        """Time of the last delivery of any camera, by the monotonic clock; 0: none so far."""

    @property
    def is_empty(self) -> bool:
        """Whether no frame set waits to be taken."""
        return not self._pairs

    @property
    def is_at_end(self) -> bool:
        """Whether no frame set will follow the waiting ones."""
        return self._is_closed or not self._running

    def put(self, frame: Frame, wait: bool) -> None:
        """Take a frame in its camera's thread; with ``wait`` block until the reader took all frame sets."""
        for marks in self._marks:
            frame = marks.mark(frame)
        if self._ring is not None:
            self._ring.keep(frame)
        with self._changed:
            while wait and self._pairs and not self._is_closed:
                self._changed.wait()
            if self._is_closed:
                return
            self.delivered_ns = self._clock.monotonic_ns()
            arrived_ns = None if wait else self.delivered_ns
            pairs = self._pairer.add(frame.camera, frame.sequence, frame.t_ns, frame, arrived_ns)
            for pair in pairs:
                self._pairs.append(pair)
                if not wait:
                    self._drop_oldest()
                after_ms = (self.delivered_ns - pair.t_ns) * 1e-6
                missing = ", ".join(f"{camera} {reason}" for camera, reason in pair.missing.items())
                steps.debug("exposure %d: %s after %.1f ms", pair.sequence, missing or "paired", after_ms)
        if pairs:
            self._arrived()

    def take(self, most: int | None = None) -> list[Pair[Frame]]:
        """Return the waiting frame sets, at ``most`` the oldest so many, oldest first; may be empty."""
        with self._changed:
            if most is None or not self._pairs:
                self._behind_ns = None
            count = len(self._pairs) if most is None else min(most, len(self._pairs))
            pairs = [self._pairs.popleft() for _ in range(count)]
            if self._changing:
                pairs = [pair.converted(self._with_mark) for pair in pairs]
            self._changed.notify_all()
        return pairs

    def end(self, camera: str) -> None:
        """Note that no frame of this camera follows."""
        self._running.discard(camera)
        self._arrived()

    def close(self) -> None:
        """Release waiting threads; later frames are discarded."""
        with self._changed:
            self._is_closed = True
            self._changed.notify_all()
        self._arrived()

    def _drop_oldest(self) -> None:
        """Drop all but the newest for a reader that stays behind, and the oldest beyond ``WAITING_BYTES``."""
        newest_ns = self._pairs[-1].t_ns
        if self._behind_ns is None:
            self._behind_ns = newest_ns
        left_bytes = WAITING_BYTES - sum(map(_size_bytes, self._pairs))
        while len(self._pairs) > 1 and (left_bytes < 0 or newest_ns - self._behind_ns > MAX_BEHIND_NS):
            left_bytes += _size_bytes(self._pairs[0])
            self._drop(self._pairs.popleft())

    def _drop(self, pair: Pair[Frame]) -> None:
        steps.debug("exposure %d: dropped, the reader is behind", pair.sequence)
        for frame in pair.all_items:
            self.dropped[frame.camera] += 1
            if frame.changing:
                self._changing.add(frame.camera)

    def _with_mark(self, frame: Frame) -> Frame:
        """Return the frame, marked ``changing`` if an earlier frame with that mark was dropped."""
        if frame.camera not in self._changing:
            return frame
        self._changing.discard(frame.camera)
        return replace(frame, changing=True)


def _size_bytes(pair: Pair[Frame]) -> int:
    return sum(frame.pixels.nbytes for frame in pair.all_items)
