"""The pipeline task: frames from the inbox through the chain onto the board."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence

from altd.acquisition.inbox import Inbox
from altd.measuring.chain import MeasuringChain
from altd.ports import Clock
from altd.records import Frame, Measurement
from altd.status.board import Board
from altd.status.health import Component, State


class Pipeline:
    """One daemon's pipeline.

    When no camera delivers, the board says so every ``silent_after_s``. ``progress`` is called each time an
    exposure moved on or something was put on the board, and only then: it feeds the watchdog. Frames that are
    taken and come to nothing do not.
    """

    def __init__(
        self,
        inbox: Inbox,
        chain: MeasuringChain,
        board: Board,
        component: Component,
        clock: Clock,
        silent_after_s: float,
        progress: Callable[[], None] = lambda: None,
    ) -> None:
        self._inbox = inbox
        self._chain = chain
        self._board = board
        self._component = component
        self._clock = clock
        self._silent_after_s = silent_after_s
        self._progress = progress
        self._heard_ns = clock.monotonic_ns()

    async def run(self) -> None:
        """Measure until cancelled; a failure here ends the daemon."""
        ticking = asyncio.create_task(self._tick(), name="silence-tick")
        try:
            while True:
                self._measure(await self._inbox.take())
        finally:
            ticking.cancel()
            await asyncio.gather(ticking, return_exceptions=True)

    async def _tick(self) -> None:
        """Wake the reader when nothing was heard for ``silent_after_s``, and no sooner."""
        while True:
            left_s = self._silent_after_s - (self._clock.monotonic_ns() - self._heard_ns) * 1e-9
            if left_s <= 0:
                self._inbox.tick()
                left_s = self._silent_after_s
            await self._clock.sleep(left_s)

    def _measure(self, frames: Sequence[Frame]) -> None:
        now_ns = self._clock.monotonic_ns()
        if not frames and now_ns - self._heard_ns < self._silent_after_s * 1e9:
            return
        self._heard_ns = now_ns
        before = self._chain.exposures, self._board.published
        for frame in frames:
            for measurement in self._chain.push(frame):
                self._put_up(measurement)
        if not frames:
            self._put_up(self._chain.silence(now_ns))
        not_told = dict.fromkeys(self._component.figures)
        self._component.observe(not_told | self._chain.step() | self._chain.views())
        self._component.counters["late_frames"] = self._chain.late_frames
        for camera, dropped in self._inbox.dropped.items():
            self._component.counters[f"dropped_{camera}"] = dropped
        if (self._chain.exposures, self._board.published) != before:
            self._progress()

    def _put_up(self, measurement: Measurement) -> None:
        self._board.publish(measurement)
        self._component.count("measurements")
        if measurement.valid:
            self._component.count("valid")
        state = State.OK if measurement.valid else State.DEGRADED
        self._component.say(state, lambda now_ns: self._chain.seen())
