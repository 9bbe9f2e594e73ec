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

ROOM = 4
"""Maximum number of waiting incomplete frame sets: an abandoned one arrives together with the next."""


class Marks(Protocol):
    """Marks frames with the state of switched devices during their exposure."""

    def mark(self, frame: Frame) -> Frame:
        """Return the frame with its mark; called in the thread of its camera."""


class FramePairs:
    """The frame sets of the cameras for one reader; a slow reader gets the newest.

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
            pairs = self._pairer.add(frame.camera, frame.sequence, frame.t_ns, frame)
            for pair in pairs:
                if not wait:
                    self._make_room(pair)
                self._pairs.append(pair)
                after_ms = (self.delivered_ns - pair.t_ns) * 1e-6
                missing = ", ".join(f"{camera} {reason}" for camera, reason in pair.missing.items())
                steps.debug("exposure %d: %s after %.1f ms", pair.sequence, missing or "paired", after_ms)
        if pairs:
            self._arrived()

    def take(self) -> list[Pair[Frame]]:
        """Return the waiting frame sets, oldest first; may be empty."""
        with self._changed:
            pairs = [pair.of(self._with_mark) if self._changing else pair for pair in self._pairs]
            self._pairs.clear()
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

    def _make_room(self, newest: Pair[Frame]) -> None:
        """Drop waiting frame sets: every complete one for a complete one, else the oldest incomplete ones."""
        alike = [pair for pair in self._pairs if bool(pair.missing) is bool(newest.missing)]
        room = ROOM if newest.missing else 1
        for pair in alike[: max(len(alike) + 1 - room, 0)]:
            self._pairs.remove(pair)
            self._drop(pair)

    def _drop(self, pair: Pair[Frame]) -> None:
        steps.debug("exposure %d: dropped, replaced by a newer one", pair.sequence)
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
