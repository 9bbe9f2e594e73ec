"""Paired frames of all cameras for recordings and scans, which keep the pictures."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Mapping, Sequence
from typing import Self

from altd.acquisition.acquiring import acquire
from altd.acquisition.auto_exposure.control import ExposureControl
from altd.acquisition.frame_pairs import FramePairs, Marks
from altd.config import Measuring
from altd.measuring.pairing import Pair, Pairer
from altd.ports import Camera, CameraError, Clock
from altd.records import Frame
from altd.status.health import CameraTrouble, Health, State

FRAME_SET_TIMEOUT_S = 5.0
"""Maximum time without a frame set of all cameras; then a camera counts as failed."""
_CHECK_INTERVAL_S = 0.25
_BUSY_REMEDY = (
    "stop the program that uses them (altd itself: sudo systemctl stop altd), or let altd keep its last "
    "seconds (docs/history.md)"
)


class FrameSets:
    """Frame sets of the cameras, which deliver within ``async with``; frames not requested are dropped.

    ``exposure`` sets the cameras' exposure when they are opened; it then stays constant. ``marks`` mark
    frames with the opaque target.
    """

    def __init__(
        self,
        cameras: Sequence[Camera],
        measuring: Measuring,
        health: Health,
        exposure: Mapping[str, ExposureControl] | None = None,
        marks: Sequence[Marks] = (),
    ) -> None:
        self._marks = marks
        self._components = {camera.name: health.component(f"camera {camera.name}") for camera in cameras}
        self.cameras = cameras
        self._exposure = exposure or {}
        self._measuring = measuring
        self._acquiring: list[asyncio.Task[None]] = []

    async def __aenter__(self) -> Self:
        settings = self._measuring
        pairer: Pairer[Frame] = Pairer(
            tuple(self._components), settings.pair_by, settings.max_skew_ns, settings.max_lag_ns
        )
        self._loop, self._arrived = asyncio.get_running_loop(), asyncio.Event()
        self._pairs = FramePairs(pairer, self._wake, self.clock, self._marks)
        self._acquiring = [
            asyncio.create_task(
                acquire(camera, self._pairs, self._components[camera.name], self._exposure.get(camera.name))
            )
            for camera in self.cameras
        ]
        for task in self._acquiring:
            task.add_done_callback(lambda _: self._arrived.set())
        return self

    async def __aexit__(self, *_: object) -> None:
        for task in self._acquiring:
            task.cancel()
        await asyncio.gather(*self._acquiring, return_exceptions=True)

    def _wake(self) -> None:
        """Wake the reader from a camera's thread."""
        with contextlib.suppress(RuntimeError):  # the loop is closed: the process is ending
            self._loop.call_soon_threadsafe(self._arrived.set)

    @property
    def clock(self) -> Clock:
        """Clock by which the cameras' frames are timed."""
        return next(iter(self._components.values())).clock

    @property
    def is_at_end(self) -> bool:
        """Whether every camera has ended or a driver has failed, and every frame set was taken."""
        ended = [task.done() for task in self._acquiring]
        return self._pairs.is_empty and (all(ended) or self._failure is not None)

    def check(self) -> None:
        """Raise a driver's own failure; a lost camera or the end of a source is not one."""
        if self._failure is not None:
            raise self._failure

    @property
    def _failure(self) -> BaseException | None:
        failures = (task.exception() for task in self._acquiring if task.done() and not task.cancelled())
        return next((failure for failure in failures if failure is not None), None)

    async def settled(self) -> list[Pair[Frame]]:
        """Return the next paired frame sets, complete or not; may be empty.

        Empty until every camera was opened. Raises CameraError for a camera that could not be opened within
        FRAME_SET_TIMEOUT_S.
        """
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(_CHECK_INTERVAL_S):
                await self._arrived.wait()
        self._arrived.clear()
        pairs = self._pairs.take()
        return [] if self._lacks_camera() else pairs

    async def after(self, t_ns: int, count: int) -> list[Pair[Frame]]:
        """Return the next ``count`` complete frame sets whose exposure began after ``t_ns``.

        A frame's time is the middle of its exposure, so the first frame after ``t_ns`` may have begun before
        it and is skipped: a camera begins an exposure only after the previous one has ended. Frame sets
        during a change of exposure are skipped too. Raises CameraError if a camera's source ends or no
        complete frame set arrives for FRAME_SET_TIMEOUT_S, and a driver's own failure.
        """
        found: list[Pair[Frame]] = []
        under_way = True
        while len(found) < count:
            for pair in await self._complete():
                began_before = min(frame.t_ns for frame in pair.items.values()) <= t_ns
                if began_before or any(frame.changing for frame in pair.all_items):
                    continue
                if under_way:
                    under_way = False
                else:
                    found.append(pair)
        return found[:count]

    async def _complete(self) -> list[Pair[Frame]]:
        """Return the next complete frame sets, at least one."""
        complete: list[Pair[Frame]] = []
        try:
            async with asyncio.timeout(FRAME_SET_TIMEOUT_S):
                while not complete:
                    complete = [p for p in await self.settled() if len(p.items) == len(self.cameras)]
                    if not complete and any(task.done() for task in self._acquiring):
                        self.check()
                        raise CameraError(self._complaint())
        except TimeoutError:
            raise CameraError(self._complaint()) from None
        return complete

    def _lacks_camera(self) -> bool:
        """Whether a camera failed before its first frame; raises CameraError if that lasts."""
        failed = [
            component
            for component in self._components.values()
            if component.state is State.FAILED and not component.counters.get("frames")
        ]
        oldest_ns = self.clock.monotonic_ns() - FRAME_SET_TIMEOUT_S * 1e9
        if any(component.since_ns < oldest_ns for component in failed):
            raise CameraError(self._complaint())
        return bool(failed)

    def _complaint(self) -> str:
        bad = [
            f"camera {name}: {component.message.removesuffix('; trying again') or 'no frames'}"
            for name, component in self._components.items()
            if component.state != State.OK
        ]
        if any(component.trouble is CameraTrouble.BUSY for component in self._components.values()):
            bad.append(_BUSY_REMEDY)
        return "; ".join(bad) or f"no exposure of all cameras together for {FRAME_SET_TIMEOUT_S:g} s"
