"""The service of checks: a request cannot make valid what no check has looked at."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from support import evidence
from support.clock import FakeClock, settle, stop
from support.located import SPOT, located
from support.measurements import measured

from altd.acquisition.self_check.exposing import CheckFailedError
from altd.acquisition.self_check.frames import LedLog, Light
from altd.acquisition.self_check.geometry_state import GeometryState
from altd.acquisition.self_check.memory import CheckMemory
from altd.acquisition.self_check.schedule import FIRST_REPEAT_S, REST_S, Cause, Schedule
from altd.acquisition.self_check.service import CheckParts, SelfChecks
from altd.config import SelfCheckSettings
from altd.selfcheck.records import DriftLimits, SelfCheck, Verdict
from altd.status.event_log import EventLog
from altd.status.health import Component
from altd.status.services import SelfCheckService

CAMERAS = ("front", "rear")


class Exposer:
    """Fails each time, before the LEDs are lit or after, or has frames; counts how often it was asked."""

    def __init__(self, clock: FakeClock, has_begun: bool, has_frames: bool) -> None:
        self._clock, self._has_begun, self._has_frames = clock, has_begun, has_frames
        self.asked_s: list[float] = []

    async def expose(self) -> Any:
        self.asked_s.append(self._clock.now_ns * 1e-9)
        if self._has_frames:
            return None
        await self._clock.sleep(3.0)
        raise CheckFailedError("no camera had steady exposures", has_begun=self._has_begun)


class Running:
    """The service with what it needs of others made by hand; ``found``: what each check finds."""

    def __init__(self, has_begun: bool, found: SelfCheck | None = None, **settings: object) -> None:
        self.clock = FakeClock()
        self.service = SelfCheckService(EventLog(self.clock))
        checked = SelfCheckSettings.model_validate(settings)
        geometry = GeometryState(checked, DriftLimits(), evidence.calibration(), self.clock)
        parts = CheckParts(
            LedLog(self.clock, dict.fromkeys(CAMERAS, 50_000_000)),
            Schedule(self.clock, checked.interval_s, checked.enabled),
            SimpleNamespace(judge=lambda *_: found),  # type: ignore[arg-type]
            geometry,
            SimpleNamespace(apply=lambda _: None, prepare=lambda _: None),  # type: ignore[arg-type]
            CheckMemory(evidence.calibration(), self.clock),
        )
        component = Component("self-check", self.clock)
        self.checks = SelfChecks(
            parts, dict(zip(CAMERAS, CAMERAS, strict=True)), self.service, component, self.clock
        )
        self.exposer = Exposer(self.clock, has_begun, found is not None)
        self.lamps: Any = SimpleNamespace(complaint="", is_starting=False)

    async def __aenter__(self) -> Running:
        marked = {light: dict.fromkeys(CAMERAS, 0) for light in (Light.ON, Light.SWITCHED)}
        frames: Any = SimpleNamespace(marked=marked)
        self._task = asyncio.create_task(self.checks.run(self.exposer, self.lamps, frames))  # type: ignore[arg-type]
        await settle()
        return self

    async def __aexit__(self, *_: object) -> None:
        await stop(self._task)

    def strike(self) -> None:
        """The spots of all targets jump by 12 px."""
        for number in range(4):
            for camera in CAMERAS:
                one = located(camera, number, self.clock.now_ns + number * 50_000_000)
                self.checks.add(replace(one, spot=replace(SPOT, u_px=300.0 + 12.0 * (number == 3))))

    @property
    def passed(self) -> tuple[bool, list[str]]:
        """Whether a measurement that is valid stays so, and what it says."""
        finding = self.checks.finding(measured())
        assert finding is not None
        measurement = measured().with_findings(finding)
        return measurement.valid, [str(fault) for fault in measurement.status]


@pytest.mark.parametrize(("is_starting", "asked_s"), [(True, 60.0), (False, 3.0)])
async def test_the_first_check_waits_for_lamps_that_start_and_not_for_those_that_failed(
    is_starting: bool, asked_s: float
) -> None:
    running = Running(has_begun=True)
    running.lamps = SimpleNamespace(complaint="not open", is_starting=is_starting)
    async with running:
        await running.clock.advance(59.95)
        running.lamps.complaint = ""
        await running.clock.advance(1.0)
        assert running.exposer.asked_s[0] == pytest.approx(asked_s, abs=0.01)


@pytest.mark.parametrize("cause", [Cause.REQUEST, Cause.SHOCK, None])
async def test_a_check_that_could_not_begin_is_not_the_first_whoever_asked_for_it(
    cause: Cause | None,
) -> None:
    running = Running(has_begun=False)
    if cause is Cause.REQUEST:
        running.service.ask()
    elif cause is Cause.SHOCK:
        running.checks._schedule.ask(cause)  # noqa: SLF001
    async with running:
        assert running.passed == (False, ["self_checking"])
        await running.clock.advance(3.1)
        assert running.service.latest is not None
        assert running.service.latest.check.sentence == "unknown: no camera had steady exposures"
        assert running.passed == (False, ["self_checking"])
        for _ in range(5):
            running.service.ask()
            await running.clock.advance(3.1)
            assert running.passed == (False, ["self_checking"])


async def test_one_that_began_and_came_to_nothing_is_without_a_verdict() -> None:
    async with Running(has_begun=True) as running:
        await running.clock.advance(3.1)
        assert running.passed == (True, ["geometry_unknown"])


@pytest.mark.parametrize("last", [Verdict.BAD, Verdict.SUSPECT])
async def test_what_was_bad_before_the_start_is_not_valid_after_a_first_check_that_saw_nothing(
    last: Verdict, tmp_path: Path
) -> None:
    before = Running(has_begun=True, found=SelfCheck(last, {}, {}, ("moved",)))
    before.checks.memory.keep_in(tmp_path / "checks.json", Component("history", before.clock))
    async with before, asyncio.timeout(60):
        await before.service.report(1)
    after = Running(has_begun=True)
    after.checks.memory.keep_in(tmp_path / "checks.json", Component("history", after.clock))
    async with after, asyncio.timeout(60):
        assert after.passed == (False, ["self_checking"])
        while after.service.latest is None:
            await after.clock.advance(0.1)
        is_valid, says = after.passed
        assert is_valid is (last is not Verdict.BAD)
        assert says == ["geometry_drift"] * (not is_valid) + ["geometry_unknown"]


async def test_a_requested_check_that_could_not_begin_answers_who_waits() -> None:
    async with Running(has_begun=False) as running:
        waiting = asyncio.create_task(running.service.report(running.service.ask()))
        await running.clock.advance(3.1)
        await running.clock.advance(3.1)
        assert (await waiting).number == 2
        assert running.service.waiting == 0


@pytest.mark.parametrize(("is_whole", "checks"), [(True, 1), (False, 2)])
async def test_a_check_that_saw_but_a_part_is_repeated_soon(is_whole: bool, checks: int) -> None:
    found = SelfCheck(Verdict.SUSPECT, {}, {}, ("rear: moved", "front: dark"), is_whole)
    async with Running(has_begun=True, found=found) as running, asyncio.timeout(60):
        await running.service.report(1)
        await settle()
        await running.clock.advance(FIRST_REPEAT_S + 0.1)
        assert len(running.exposer.asked_s) == checks


GOOD = SelfCheck(Verdict.GOOD, {}, {})


async def test_after_a_shock_the_geometry_is_unknown_until_its_check_has_ended() -> None:
    async with Running(has_begun=True, found=GOOD) as running, asyncio.timeout(60):
        await running.service.report(1)
        assert running.passed == (True, [])
        running.strike()
        await running.clock.advance(REST_S - 0.1)
        assert running.passed == (True, ["geometry_unknown"])
        await running.clock.advance(0.2)
        await running.service.report(2)
        assert running.passed == (True, [])


async def test_a_check_that_a_shock_falls_into_says_nothing_of_what_is_after_it() -> None:
    async with Running(has_begun=True, found=GOOD) as running, asyncio.timeout(60):
        await running.service.report(1)
        judged = running.checks._judge.judge  # noqa: SLF001

        def struck(*asked: Any) -> SelfCheck:
            running.strike()
            return judged(*asked)

        running.checks._judge.judge = struck  # type: ignore[method-assign]  # noqa: SLF001
        running.service.ask()
        await running.clock.advance(REST_S + 0.1)
        await running.service.report(2)
        assert running.passed == (True, ["geometry_unknown"])
        running.checks._judge.judge = judged  # type: ignore[method-assign]  # noqa: SLF001
        await running.clock.advance(REST_S + 0.1)
        await running.service.report(3)
        assert running.passed == (True, [])
