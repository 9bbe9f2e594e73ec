"""The self-check of a running daemon: runs checks indefinitely, and serves the pipeline's calls."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

from altd.acquisition.lamps.controller import FrameLamps
from altd.acquisition.self_check.correction import Correction
from altd.acquisition.self_check.exposing import CheckExposer, CheckFailedError, CheckFrames
from altd.acquisition.self_check.frames import LedLog, Light, MarkedFrames
from altd.acquisition.self_check.geometry_state import GeometryState
from altd.acquisition.self_check.judging import CheckJudge, SpotPx
from altd.acquisition.self_check.memory import CheckMemory
from altd.acquisition.self_check.schedule import Cause, Schedule
from altd.measuring.shock import ShockWatch
from altd.measuring.spot_locator import Located
from altd.ports import Clock
from altd.reasons import Reason
from altd.records import Finding, Measurement, Spot
from altd.runtime.threads import call_in_thread
from altd.selfcheck.records import SelfCheck, Verdict, unknown
from altd.status.health import Component, State
from altd.status.services import SelfCheckReport, SelfCheckService

log = logging.getLogger("altd")

HELD_BACK_NS = 2_000_000_000
"""Time after a switching of the LEDs during which a window may lack exposures because of them."""
_LAPSED = "the correction has ended: no check has confirmed the drift for too long"
_LAMPS_TIMEOUT_S = 3.0
_LAMPS_POLL_INTERVAL_S = 0.1


@dataclass(frozen=True, slots=True)
class CheckParts:
    """The parts that a check needs."""

    leds: LedLog
    schedule: Schedule
    judge: CheckJudge
    geometry: GeometryState
    correction: Correction
    memory: CheckMemory


class SelfChecks:
    """Runs the checks of one daemon. ``targets`` names the target of each camera."""

    def __init__(
        self,
        parts: CheckParts,
        targets: Mapping[str, str],
        service: SelfCheckService,
        component: Component,
        clock: Clock,
    ) -> None:
        self.leds = parts.leds
        self._schedule = parts.schedule
        self._judge = parts.judge
        self._geometry = parts.geometry
        self._correction = parts.correction
        self.memory = parts.memory
        self._service = service
        self._component = component
        self._clock = clock
        scales = {target.name: target.px_per_mm for target in parts.geometry.calibration.targets}
        self._shocks = ShockWatch({camera: scales[name] for camera, name in targets.items()})
        self._targets = targets
        self._at: dict[str, SpotPx] = {}
        self._is_valid = False
        """Whether the last measurement was valid."""
        self._has_jumped = False
        """Whether there was a shock since the last check began."""
        self._logged = ""
        service.open(partial(parts.schedule.ask, Cause.REQUEST))

    def add(self, located: Located) -> None:
        """Note the position of a located spot, and detect a jump of all spots."""
        target = self._targets[located.camera]
        if isinstance(located.spot, Spot):
            self._at[target] = (located.spot.u_px, located.spot.v_px)
        elif not located.leds_on:
            self._at.pop(target, None)
        if self._shocks.is_shock(located):
            self._component.count("shocks")
            self._schedule.ask(Cause.SHOCK)
            self._geometry.note_shock()
            self._has_jumped = True

    def finding(self, measurement: Measurement) -> Finding | None:
        """Return the faults of the geometry for a measurement.

        None: only exposures taken by a check are missing; the measurement on the board remains, and ages.
        """
        if self._is_valid and self._lacks_exposures(measurement):
            return None
        finding = self._geometry.finding(measurement.valid)
        self._is_valid = measurement.valid
        if self._geometry.lapse():  # this measurement was still corrected, and is marked so
            self._correction.apply(self._geometry)
            self._component.set_state(self._geometry.state, _LAPSED)
            log.warning("self-check: %s", _LAPSED)
        return finding

    async def run(self, exposer: CheckExposer, lamps: FrameLamps, frames: MarkedFrames) -> None:
        """Run checks until cancelled."""
        self._component.set_state(State.STARTING, "no check yet")
        try:
            await self._recall()
            await self._lamps_open(lamps)
            await self._check_repeatedly(exposer, frames)
        finally:
            await self.memory.end()

    async def _check_repeatedly(self, exposer: CheckExposer, frames: MarkedFrames) -> None:
        while True:
            cause = await self._schedule.next()
            self._has_jumped = False
            lost_before = _marked(frames)
            number = self._service.begin()
            has_begun = True
            try:
                check = await self._checked(exposer)
            except CheckFailedError as error:
                check, has_begun = unknown(str(error)), error.has_begun
            lost = _marked(frames) - lost_before
            time = self._clock.utc(self._clock.monotonic_ns())
            report = SelfCheckReport(number, check, str(cause), time, lost)
            if self._geometry.awaits_first and not has_begun:  # independent of the cause
                # it is retried and the first check is still due: nothing is measured without frames either
                self._component.set_state(State.DEGRADED, check.sentence)
                self._service.publish(report)
                continue
            await self.memory.add(check, time)
            self._settle(report)
            await self.memory.save()
            await self._recall()

    async def _recall(self) -> None:
        """Restore a bad verdict from before this start, until a check has a verdict."""
        if self._geometry.verdict is None and await self.memory.was_bad():
            self._geometry.recall_bad()
            if not self._geometry.awaits_first:
                self._component.set_state(self._geometry.state, self._geometry.faults[0].detail)

    async def _lamps_open(self, lamps: FrameLamps) -> None:
        """Wait for lamps that are starting, and up to ``_LAMPS_TIMEOUT_S`` for lamps that failed."""
        polls_left = round(_LAMPS_TIMEOUT_S / _LAMPS_POLL_INTERVAL_S)
        while lamps.complaint and polls_left:
            await self._clock.sleep(_LAMPS_POLL_INTERVAL_S)
            polls_left -= not lamps.is_starting

    async def _checked(self, exposer: CheckExposer) -> SelfCheck:
        frames = await exposer.expose()
        try:
            return await call_in_thread(partial(self._judged, frames, dict(self._at)), "self-check")
        except Exception as error:  # a defect here must not end the measurement
            log.exception("self-check: a defect")
            return unknown(f"a defect: {type(error).__name__}: {error}")

    def _judged(self, frames: CheckFrames, at: Mapping[str, SpotPx]) -> SelfCheck:
        """Return the verdict and prepare its correction, which takes long; called in a separate thread."""
        check = self._judge.judge(frames, at, self._geometry.verdict)
        self._correction.prepare(self._geometry.transforms_after(check))
        return check

    def _settle(self, report: SelfCheckReport) -> None:
        """Apply a check to measurements and to the schedule of the next check, and publish its report."""
        check, sentence = report.check, report.check.sentence
        self._geometry.take(check, self.memory.slow_drift)
        if self._has_jumped:
            self._geometry.note_shock()  # the check after the shock is still due
        self._correction.apply(self._geometry)
        self._component.count("checks")
        self._component.count(f"checks_{check.verdict}")
        self._component.count("exposures_lost", report.exposures_lost)
        self._component.set_state(self._geometry.state, sentence)
        if sentence != self._logged:
            self._logged = sentence
            level = logging.INFO if check.verdict is Verdict.GOOD else logging.WARNING
            log.log(level, "self-check: %s", sentence)
        self._schedule.ended(check.verdict in (Verdict.GOOD, Verdict.SUSPECT) and check.is_whole)
        self._service.publish(report)

    def _lacks_exposures(self, measurement: Measurement) -> bool:
        errors = {fault.reason for fault in measurement.status if not fault.reason.is_warning}
        switched_ns = self.leds.last_switched_ns
        return (
            errors == {Reason.WARMING_UP}
            and switched_ns is not None
            and measurement.light_ns - switched_ns <= HELD_BACK_NS
        )


def _marked(frames: MarkedFrames) -> int:
    """Return the number of exposures not measured so far, of the camera with most of them."""
    lit, switched = frames.marked[Light.ON], frames.marked[Light.SWITCHED]
    return max(lit[camera] + switched[camera] for camera in lit)
