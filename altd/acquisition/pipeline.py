"""The pipeline task: what the cameras' threads located, through the chain onto the board."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from altd.acquisition.buffers import Buffers
from altd.acquisition.self_check.service import SelfChecks
from altd.measuring.chain import MeasuringChain
from altd.measuring.spot_locator import Located
from altd.records import Measurement
from altd.status.board import Board
from altd.status.health import Component, State

_HEARTBEAT_S = 4.0
"""The pipeline is woken at least every ``silent_after_s``, which is 2 s at most."""


class Pipeline:
    """One daemon's pipeline.

    When no camera delivers, the board says so every ``chain.silent_after_s``. ``progress`` is called each
    time an exposure moved on or something was put on the board, and only then: it feeds the watchdog. Frames
    that are taken and come to nothing do not. ``checks`` are shown what was located, and have a say in what
    is put on the board.
    """

    def __init__(
        self,
        buffers: Buffers,
        chain: MeasuringChain,
        board: Board,
        component: Component,
        progress: Callable[[], None] = lambda: None,
        checks: SelfChecks | None = None,
    ) -> None:
        self._buffers = buffers
        self._located = buffers.located
        self._chain = chain
        self._board = board
        self._component = component
        self._clock = component.clock
        self._checks = checks
        self._silent_after_s = chain.silent_after_s
        self._progress = progress
        self.observe: Callable[[Located], None] = lambda located: None
        """Is shown all that was located."""
        self._heard_ns = self._clock.monotonic_ns()
        """When something came or, if that was later, when it was last said that nothing does."""
        self._is_silent = True

    async def run(self) -> None:
        """Measure until cancelled; a failure here ends the daemon."""
        self._component.expect(_HEARTBEAT_S)
        ticking = asyncio.create_task(self._tick(), name="silence-tick")
        try:
            while True:
                # after a silence nobody knows whose frame comes next
                each = self._is_silent or self._chain.awaits_partner
                self._measure(await self._located.take(wake_for_each=each))
        finally:
            ticking.cancel()
            await asyncio.gather(ticking, return_exceptions=True)

    async def _tick(self) -> None:
        """Wake the reader when nothing was heard for ``silent_after_s``, and no sooner."""
        while True:
            left_s = self._silent_after_s - self._silent_for_s()
            if left_s <= 0:
                self._located.wake()
                left_s = self._silent_after_s
            await self._clock.sleep(left_s)

    def _silent_for_s(self) -> float:
        self._heard_ns = max(self._heard_ns, self._located.delivered_ns or 0)
        return (self._clock.monotonic_ns() - self._heard_ns) * 1e-9

    def _measure(self, located: list[Located]) -> None:
        self._component.is_alive()
        is_silent = self._silent_for_s() >= self._silent_after_s
        if not located and not is_silent:
            return
        self._is_silent = is_silent
        before = self._chain.frame_sets, self._board.published
        for one in located:
            if self._checks is not None:
                self._checks.look(one)
            self.observe(one)
            for measurement in self._chain.add(one):
                self._put_up(measurement)
        if is_silent:
            self._heard_ns = self._clock.monotonic_ns()
            self._put_up(self._chain.silence(self._heard_ns))
        not_told = dict.fromkeys(self._component.figures)
        self._component.observe(not_told | self._chain.step() | self._chain.views())
        self._component.counters["late_frames"] = self._chain.late_frames
        for camera, dropped in self._buffers.dropped.items():
            self._component.counters[f"dropped_{camera}"] = dropped
        if (self._chain.frame_sets, self._board.published) != before:
            self._progress()

    def _put_up(self, measurement: Measurement) -> None:
        if self._checks is not None:
            checked = self._checks.pass_on(measurement)
            if checked is None:
                return
            measurement = checked
        self._board.publish(measurement)
        self._component.count("measurements")
        if measurement.valid:
            self._component.count("valid")
        state = State.OK if measurement.valid else State.DEGRADED
        self._component.set_state(state, lambda now_ns: self._chain.seen())
