"""The frames of all cameras, paired: for recordings and scans, which keep pictures."""

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
from altd.status.health import Health, State

FRAME_SET_TIMEOUT_S = 5.0
"""Without a frame set of all cameras for so long, something is wrong with one."""
_CHECK_INTERVAL_S = 0.25
_BUSY_REMEDY = (
    "stop what has them (altd itself: sudo systemctl stop altd), or have altd keep its last seconds "
    "(docs/history.md)"
)


class FrameSets:
    """``async with``: the cameras deliver; frames that are not requested are dropped.

    Their exposure is set by ``exposure`` when they are opened, and stays constant. ``marks`` mark frames
    with the opaque target.
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
        """Let the reader look, from the thread of a camera."""
        with contextlib.suppress(RuntimeError):  # the loop is closed: the process is going down
            self._loop.call_soon_threadsafe(self._arrived.set)

    @property
    def clock(self) -> Clock:
        """The clock by which the cameras' frames are timed."""
        return next(iter(self._components.values())).clock

    @property
    def is_at_end(self) -> bool:
        """Whether no camera delivers any more, or a driver has failed, and all that they gave was taken."""
        ended = [task.done() for task in self._acquiring]
        return self._pairs.is_empty and (all(ended) or self._failure is not None)

    def check(self) -> None:
        """Raise a driver's own failure; a camera that was lost, or is at its end, is none."""
        if self._failure is not None:
            raise self._failure

    @property
    def _failure(self) -> BaseException | None:
        failures = (task.exception() for task in self._acquiring if task.done() and not task.cancelled())
        return next((failure for failure in failures if failure is not None), None)

    async def settled(self) -> list[Pair[Frame]]:
        """The frame sets that are settled next, complete or not; maybe none.

        Raises CameraError for a camera that could not be opened at all for FRAME_SET_TIMEOUT_S; until then
        nothing is settled.
        """
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(_CHECK_INTERVAL_S):
                await self._arrived.wait()
        self._arrived.clear()
        pairs = self._pairs.take()
        return [] if self._lacks_camera() else pairs

    async def after(self, t_ns: int, count: int) -> list[Pair[Frame]]:
        """The next ``count`` frame sets that were begun after ``t_ns``, each with the frames of all cameras.

        A frame carries the middle of its exposure, so the first one behind ``t_ns`` may have begun before
        it. It is passed over: a camera begins no exposure before the one before has ended. Raises
        CameraError when a camera is at its end or when none come for FRAME_SET_TIMEOUT_S, and a driver's own
        failure. Frame sets during which a camera was being set are passed over too.
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
        """The next complete frame sets, at least one."""
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
        """Whether a camera was never open; raises CameraError when that lasts."""
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
        if any(component.message.startswith("busy: ") for component in self._components.values()):
            bad.append(_BUSY_REMEDY)
        return "; ".join(bad) or f"no exposure of all cameras together for {FRAME_SET_TIMEOUT_S:g} s"
