"""A daemon in this process on simulated cameras whose frame LEDs follow the daemon's lamps."""

import asyncio
import contextlib
import threading
import time
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass, field
from typing import Any, cast

from altd.app.daemon import Daemon
from altd.config import Config
from altd.measuring.calibration import Calibration
from altd.ports import LampsError
from altd.records import Frame, Measurement
from altd.status.services import SelfCheckReport
from hw_sim.beam import BeamPose
from hw_sim.camera import Schedule, SimulatedCamera
from hw_sim.displacement import Displacement
from hw_sim.unit import CAMERAS, FRONT, REAR, Unit, UnitConfig
from support.clock import FakeClock, stop
from support.unit_toml import TARGETS

POLL_S = 0.01
POSE = BeamPose(x_mm=12.0, y_mm=-7.0, slope_x=0.026, slope_y=-0.035)
MOVED = Displacement((0.6, -0.2), turn_deg=0.1)


class TimedLeds:
    """The LEDs behind ``altd.ports.Lamps``, with the times at which their line was switched.

    ``follow`` is what the LEDs do when the line is at a level; a test disturbs it.
    """

    def __init__(self) -> None:
        self.line: list[tuple[int, bool]] = [(0, False)]
        self.now_ns: Callable[[], int] = time.monotonic_ns
        self.refuses = ""
        self.follow: Callable[[bool, int], bool] = lambda level, t_ns: level

    def open(self) -> None:
        self.switch(False)

    def switch(self, on: bool) -> None:
        if self.refuses:
            raise LampsError(self.refuses)
        if on is not self.line[-1][1]:
            self.line.append((self.now_ns(), on))

    def close(self) -> None:
        if self.line[-1][1]:
            self.line.append((self.now_ns(), False))

    def level_at(self, t_ns: int) -> bool:
        return next(on for since_ns, on in reversed(self.line) if since_ns <= t_ns)

    @property
    def lit_s(self) -> list[float]:
        """For how long each time."""
        edges = self.line[1:]
        on_and_off = zip(edges[::2], edges[1::2], strict=True)
        return [(off_ns - on_ns) * 1e-9 for (on_ns, _), (off_ns, _) in on_and_off]


class _LitUnit:
    """The unit as a camera sees it: its LEDs as they were at a frame's time, however late it is made."""

    def __init__(self, unit: Unit, leds: TimedLeds) -> None:
        self._unit = unit
        self._leds = leds
        self.alter: Callable[[Frame], Frame] = lambda frame: frame

    def __getattr__(self, name: str) -> Any:
        return getattr(self._unit, name)

    def expose(self, camera: str, sequence: int, t_ns: int) -> Frame:
        self._unit.switch_leds(camera, self._leds.follow(self._leds.level_at(t_ns), t_ns))
        return self.alter(self._unit.expose(camera, sequence, t_ns))


def config(**self_check: object) -> Config:
    camera = {
        "driver": "aravis",
        "device": "stands for the simulated one",
        "exposure": {"control": "fixed", "exposure_ms": 1.6},
    }
    measuring = self_check.pop("measuring", {})
    assert isinstance(measuring, dict)
    return Config.model_validate(
        {
            "unit": {"serial": "SIM-3", "calibration": "unused.json"},
            "targets": TARGETS,
            "cameras": {FRONT: camera, REAR: camera},
            "measuring": {"pair_by": "time", **measuring},
            "self_check": self_check,
        }
    )


@dataclass(frozen=True)
class Poll:
    """The result of one look at the board."""

    at_s: float
    measurement: Measurement | None
    published: int
    age_s: float | None


@dataclass
class LedUnit:
    """The running daemon, the unit before it, and what a poller saw."""

    daemon: Daemon
    unit: Unit
    leds: TimedLeds
    seen: _LitUnit
    polls: list[Poll] = field(default_factory=list)

    @property
    def now_s(self) -> float:
        return asyncio.get_running_loop().time()

    async def report(self, number: int, timeout_s: float = 30.0) -> SelfCheckReport:
        """The report of check ``number``, once it has ended."""
        async with asyncio.timeout(timeout_s):
            return await self.daemon.unit.self_check.report(number)

    async def check(self) -> SelfCheckReport:
        """Ask for a check."""
        return await self.report(self.daemon.unit.self_check.ask())

    async def measured(self, **wanted: bool) -> Measurement:
        """The next measurement, or the next that is ``valid`` or is not."""
        board = self.daemon.board
        async with asyncio.timeout(60):
            while True:
                await board.published_after(board.published)
                measurement = board.read()
                assert measurement is not None
                if all(getattr(measurement, name) is value for name, value in wanted.items()):
                    return measurement

    async def lit(self) -> None:
        """Wait until the LEDs are switched on; no measurement may come before they are dark again."""
        async with asyncio.timeout(60):
            while not self.leds.line[-1][1]:  # noqa: ASYNC110  switched by a thread that knows no loop
                await asyncio.sleep(POLL_S)

    async def poll(self) -> None:
        board = self.daemon.board
        while True:
            self.polls.append(Poll(self.now_s, board.read(), board.published, board.age_s()))
            await asyncio.sleep(POLL_S)


def codes(measurement: Measurement) -> set[str]:
    return {str(fault) for fault in measurement.status}


class _ClockedCamera(SimulatedCamera):
    """Exposes at the periods of a test's clock."""

    def __init__(self, seen: _LitUnit, name: str, clock: FakeClock) -> None:
        unit = cast("Unit", seen)
        super().__init__(unit, name, Schedule(unit.config.period_ns, real_time=False), waits=True)
        self._exposing = unit
        self._clock = clock
        self._never = threading.Event()

    def next_frame(self, timeout_s: float) -> Frame:
        period_ns, lag_ns = self._exposing.config.period_ns, self._exposing.lag_ns(self.name)
        now_ns = self._clock.monotonic_ns()
        sequence = (now_ns - lag_ns) // period_ns + 1
        t_ns = sequence * period_ns + lag_ns
        self._clock.wait(self._never, (t_ns - now_ns) * 1e-9)
        return self._exposing.expose(self.name, sequence, t_ns)


async def _let_pass(clock: FakeClock) -> None:
    while True:
        await clock.advance(POLL_S)


@contextlib.asynccontextmanager
async def driven_led_unit(
    calibration: Calibration, settings: Config, prepare: Callable[[LedUnit], None] = lambda running: None
) -> AsyncIterator[LedUnit]:
    """The unit with seed 3, whose calibration it is; ``prepare`` is called before its daemon starts.

    Time passes as fast as the daemon computes, also for the timers of the loop.
    """
    unit, leds = Unit(UnitConfig(seed=3)), TimedLeds()
    seen, clock = _LitUnit(unit, leds), FakeClock.of_loop()
    leds.now_ns, clock.waits_for_locating = clock.monotonic_ns, True
    cameras = {name: _ClockedCamera(seen, name, clock) for name in CAMERAS}
    daemon = Daemon(settings, calibration, cameras, clock, lamps=leds, rehearsal=True)
    running = LedUnit(daemon, unit, leds, seen)
    async with _running(running, prepare):
        passing = asyncio.create_task(_let_pass(clock))
        try:
            yield running
        finally:
            await stop(passing)
            clock.end()  # the end of the daemon waits for threads, in real time


@contextlib.asynccontextmanager
async def led_unit(
    calibration: Calibration, settings: Config, prepare: Callable[[LedUnit], None] = lambda running: None
) -> AsyncIterator[LedUnit]:
    """The same in real time, for browsers and clients."""
    unit, leds = Unit(UnitConfig(seed=3)), TimedLeds()
    seen = _LitUnit(unit, leds)
    schedule = Schedule(unit.config.period_ns, real_time=True)
    cameras = {name: SimulatedCamera(cast("Unit", seen), name, schedule, waits=False) for name in CAMERAS}
    async with _running(
        LedUnit(Daemon(settings, calibration, cameras, lamps=leds, rehearsal=True), unit, leds, seen), prepare
    ) as running:
        yield running


@contextlib.asynccontextmanager
async def _running(running: LedUnit, prepare: Callable[[LedUnit], None]) -> AsyncIterator[LedUnit]:
    prepare(running)
    tasks = [asyncio.create_task(running.daemon.run()), asyncio.create_task(running.poll())]
    try:
        yield running
    finally:
        for task in tasks:
            await stop(task)
