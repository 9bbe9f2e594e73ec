"""The pipeline task: passes located frame sets through the chain and publishes measurements on the board."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic

from altd.acquisition.frame_pairs import steps
from altd.acquisition.locating import LocatedPairs
from altd.acquisition.self_check.service import SelfChecks
from altd.measuring.frame_chain import FrameChain, Item
from altd.measuring.pairing import Pair
from altd.measuring.spot_locator import Located
from altd.records import Finding, Measurement
from altd.runtime.service_manager import status_line
from altd.status.board import Board
from altd.status.health import Component, State
from altd.status.maintenance import SpotTrends

_HEARTBEAT_S = 4.0
"""Maximum silence of a live pipeline: it is woken at least every ``silent_after_s``, which is 2 s at most."""


@dataclass(eq=False)
class Pipeline(Generic[Item]):
    """One daemon's pipeline.

    While no camera delivers, the board reports it every ``chain.silent_after_s``. ``progress`` feeds the
    watchdog: it is called only when an exposure is processed or a measurement is published, not for frames
    without a result. ``checks`` and ``trends`` receive located spots; the board adds the faults of ``checks``
    to each measurement. ``record`` takes each measurement as it is published; it must neither block nor fail.
    """

    located: LocatedPairs[Item]
    chain: FrameChain[Item]
    board: Board
    component: Component
    progress: Callable[[], None] = lambda: None
    checks: SelfChecks | None = None
    trends: SpotTrends | None = None
    record: Callable[[Measurement], None] = lambda measurement: None

    def __post_init__(self) -> None:
        self._clock = self.component.clock
        self._silent_after_s = self.chain.silent_after_s
        self._heard_ns = self._clock.monotonic_ns()
        """Time of the last delivery or, if later, of the last published silence."""

    async def run(self) -> None:
        """Measure until cancelled; a failure here ends the daemon."""
        self.component.expect(_HEARTBEAT_S)
        ticking = asyncio.create_task(self._tick(), name="silence-tick")
        try:
            while True:
                self._measure(await self.located.take())
        finally:
            ticking.cancel()
            await asyncio.gather(ticking, return_exceptions=True)

    async def _tick(self) -> None:
        """Wake the reader after ``silent_after_s`` without a delivery."""
        while True:
            left_s = self._silent_after_s - self._silent_for_s()
            if left_s <= 0:
                self.located.wake()
                left_s = self._silent_after_s
            await self._clock.sleep(left_s)

    def _silent_for_s(self) -> float:
        self._heard_ns = max(self._heard_ns, self.located.frames.delivered_ns)
        return (self._clock.monotonic_ns() - self._heard_ns) * 1e-9

    def _measure(self, pairs: list[Pair[Item]]) -> None:
        self.component.is_alive()
        is_silent = self._silent_for_s() >= self._silent_after_s
        if not pairs and not is_silent:
            return
        before = self.chain.frame_sets, self.board.published
        for pair in pairs:
            spots = [one for one in pair.all_items if isinstance(one, Located)]
            for located in spots:
                if located.is_shown:
                    self._add_located(located)
            measurement = self.chain.add(pair)
            if measurement is None:
                why = "its LEDs were lit" if any(one.leds_on for one in spots) else "no mean is due"
                steps.debug("exposure %d: %s", pair.sequence, why)
            else:
                self._publish(measurement)
        if is_silent:
            self._heard_ns = self._clock.monotonic_ns()
            self._publish(self.chain.silence(self._heard_ns))
        absent = dict.fromkeys(self.component.figures)
        self.component.observe(absent | dict(self.chain.figures()))
        self.component.counters["late_frames"] = self.chain.pairer.late
        for camera, dropped in self.located.frames.dropped.items():
            self.component.counters[f"dropped_{camera}"] = dropped
        if (self.chain.frame_sets, self.board.published) != before:
            self.progress()

    def _add_located(self, located: Located) -> None:
        if self.checks is not None:
            self.checks.add(located)
        if self.trends is not None:
            self.trends.add(located)

    def _publish(self, measurement: Measurement) -> None:
        geometry = Finding() if self.checks is None else self.checks.finding(measurement)
        if geometry is None:
            steps.debug("exposure %d: held back by a self-check", measurement.sequence)
            return
        measurement = self.board.publish(measurement, geometry)
        self.record(measurement)
        if steps.isEnabledFor(logging.DEBUG):
            after_ms = (self._clock.monotonic_ns() - measurement.light_ns) * 1e-6
            line = status_line(measurement)
            steps.debug("exposure %d: published after %.1f ms, %s", measurement.sequence, after_ms, line)
        self.component.count("measurements")
        if measurement.valid:
            self.component.count("valid")
        state = State.OK if measurement.valid else State.DEGRADED
        self.component.set_state(state, lambda now_ns: self.chain.seen())
