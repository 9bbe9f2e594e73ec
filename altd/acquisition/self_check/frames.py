"""The frames on their way: marked where the LEDs shone, and kept for a check that asks for them."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

from altd.acquisition.self_check.light import LedLog, Light
from altd.records import Frame

Taken = Mapping[str, tuple[Frame, ...]]
"""Frames of one light by camera, oldest first."""


@dataclass(slots=True)
class _Order:
    """Frames that a check waits for: ``count`` of each camera that began after ``after_ns``."""

    light: Light
    count: int
    after_ns: int
    filled: asyncio.Future[None]
    taken: dict[str, list[Frame]] = field(default_factory=dict)

    @property
    def is_filled(self) -> bool:
        return all(len(frames) >= self.count for frames in self.taken.values())


class MarkedFrames:
    """Marks frames with ``leds_on`` as the log of the LEDs says. To be made within the event loop.

    A frame is marked also where the LEDs were only being switched: it is neither on nor off.
    """

    def __init__(self, leds: LedLog, cameras: Iterable[str]) -> None:
        self._leds = leds
        self._lock = threading.Lock()
        self._loop = asyncio.get_running_loop()
        self._order: _Order | None = None
        self._cameras = tuple(cameras)
        self.marked = {light: dict.fromkeys(self._cameras, 0) for light in (Light.ON, Light.SWITCHED)}
        """Frames per camera that are not measured."""

    def mark(self, frame: Frame) -> Frame:
        """The frame, marked where it has to be, from the thread of its camera."""
        light = self._leds.of(frame)
        if light is not Light.OFF:
            self.marked[light][frame.camera] += 1
        if frame.leds_on is (light is Light.OFF):
            frame = replace(frame, leds_on=light is not Light.OFF)
        self._keep(frame, light)
        return frame

    async def take(self, light: Light, count: int, after_ns: int) -> Taken:
        """The next ``count`` frames of each camera that began after ``after_ns``; waits for ever.

        Frames that were exposed while the camera was being set are passed over.
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
                    with contextlib.suppress(RuntimeError):  # the loop is closed: the process is going down
                        self._loop.call_soon_threadsafe(_fill, order.filled)


def _fill(filled: asyncio.Future[None]) -> None:
    if not filled.done():
        filled.set_result(None)
