"""Marks frames that were exposed under the frame LEDs, and keeps frames for a waiting check."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from enum import Enum, auto

from altd.ports import Clock
from altd.records import Frame

MARGIN_NS = 10_000_000
"""Margin at both ends of an exposure: the time of a camera's own clock is known to milliseconds only."""
DARK_AFTER_FAILURE_NS = 1_000_000_000
"""Time within which lines of unresponsive LEDs are released, which darkens the LEDs. Exposures after it are
measured again; if the LEDs are still lit, the locator detects them."""
_REMEMBERED = 8


class Light(Enum):
    """State of the frame LEDs during an exposure."""

    OFF = auto()
    ON = auto()
    SWITCHED = auto()
    """The LEDs may have been on for a part of the exposure."""


@dataclass(frozen=True, slots=True)
class _Switching:
    """One switching: state unknown from ``begin_ns`` to ``end_ns`` (None: not ended), then ``on`` or off."""

    on: bool
    begin_ns: int
    end_ns: int | None = None


class LedLog:
    """Log of the switchings of the frame LEDs. One task writes it; any thread may call ``of``.

    ``period_ns`` of a camera is the time from frame to frame, which no exposure exceeds; it is used for
    frames without an exposure time.
    """

    def __init__(self, clock: Clock, period_ns: Mapping[str, int]) -> None:
        self._clock = clock
        self._period_ns = period_ns
        self._switchings: tuple[_Switching, ...] = ()
        """The last switchings, oldest first; the tuple is replaced, never changed."""

    @property
    def last_switched_ns(self) -> int | None:
        """End of the last switching; the current time while LEDs are lit or being switched; None: never."""
        if not self._switchings:
            return None
        last = self._switchings[-1]
        return self._clock.monotonic_ns() if last.end_ns is None or last.on else last.end_ns

    def begin(self, on: bool) -> None:
        """Note that the LEDs are about to be switched."""
        begun = _Switching(on, self._clock.monotonic_ns())
        self._switchings = (*self._switchings, begun)[-_REMEMBERED:]

    def done(self) -> None:
        """Note that the LEDs have been switched."""
        self._end(self._switchings[-1].on, self._clock.monotonic_ns())

    def lost(self) -> None:
        """Note that the state of the LEDs is unknown and the driver is about to release them."""
        if not self._switchings or self._switchings[-1].end_ns is not None:
            self.begin(False)
        self._end(False, self._clock.monotonic_ns() + DARK_AFTER_FAILURE_NS)

    def of(self, frame: Frame) -> Light:
        """Return the state of the LEDs during the exposure of a frame."""
        half_ns = self._half_ns(frame) + MARGIN_NS
        begin_ns, end_ns = frame.t_ns - half_ns, frame.t_ns + half_ns
        light = Light.OFF
        for switching in self._switchings:
            if switching.begin_ns >= end_ns:
                break
            if switching.end_ns is None or switching.end_ns > begin_ns:
                return Light.SWITCHED
            light = Light.ON if switching.on else Light.OFF
        return light

    def _half_ns(self, frame: Frame) -> int:
        """Return the time from the middle of an exposure to its ends, ns; one period if it is unknown."""
        if frame.exposure_ms is None:
            return self._period_ns[frame.camera]
        return round(0.5e6 * frame.exposure_ms)

    def _end(self, on: bool, end_ns: int) -> None:
        *before, last = self._switchings
        self._switchings = (*before, replace(last, on=on, end_ns=end_ns))


Taken = Mapping[str, tuple[Frame, ...]]
"""Frames with one state of the LEDs by camera, oldest first."""


@dataclass(slots=True)
class _Order:
    """Frames that a check waits for: ``count`` of each camera with a time after ``after_ns``."""

    light: Light
    count: int
    after_ns: int
    filled: asyncio.Future[None]
    taken: dict[str, list[Frame]] = field(default_factory=dict)

    @property
    def is_filled(self) -> bool:
        return all(len(frames) >= self.count for frames in self.taken.values())


class MarkedFrames:
    """Marks frames with ``leds_on`` according to the log of the LEDs. Create it within the event loop.

    A frame exposed while the LEDs were being switched is marked too: it is neither on nor off.
    """

    def __init__(self, leds: LedLog, cameras: Iterable[str]) -> None:
        self._leds = leds
        self._lock = threading.Lock()
        self._loop = asyncio.get_running_loop()
        self._order: _Order | None = None
        self._cameras = tuple(cameras)
        self.marked = {light: dict.fromkeys(self._cameras, 0) for light in (Light.ON, Light.SWITCHED)}
        """Number of unmeasured frames by state of the LEDs and camera."""

    def mark(self, frame: Frame) -> Frame:
        """Return the frame, marked if necessary; called in the thread of its camera."""
        light = self._leds.of(frame)
        if light is not Light.OFF:
            self.marked[light][frame.camera] += 1
        if frame.leds_on is (light is Light.OFF):
            frame = replace(frame, leds_on=light is not Light.OFF)
        self._keep(frame, light)
        return frame

    async def take(self, light: Light, count: int, after_ns: int) -> Taken:
        """Return the next ``count`` frames of each camera after ``after_ns``; waits without limit.

        Frames during a change of the camera's exposure are skipped.
        """
        order = _Order(light, count, after_ns, self._loop.create_future(), {c: [] for c in self._cameras})
        with self._lock:
            self._order = order
        try:
            await order.filled
        finally:
            with self._lock:
                self._order = None
        return {camera: tuple(frames) for camera, frames in order.taken.items()}

    def _keep(self, frame: Frame, light: Light) -> None:
        with self._lock:
            order = self._order
            if order is None or light is not order.light or frame.changing or frame.t_ns <= order.after_ns:
                return
            frames = order.taken[frame.camera]
            if len(frames) < order.count:
                frames.append(frame)
                if order.is_filled:
                    with contextlib.suppress(RuntimeError):  # the loop is closed: the process is ending
                        self._loop.call_soon_threadsafe(_fill, order.filled)


def _fill(filled: asyncio.Future[None]) -> None:
    if not filled.done():
        filled.set_result(None)
