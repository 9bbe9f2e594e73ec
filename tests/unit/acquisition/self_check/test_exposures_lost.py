"""A client's polls while the LEDs take exposures from the window, of a beam at rest."""

import itertools
from collections.abc import Sequence

import numpy as np
import pytest
from support import evidence
from support.clock import FakeClock
from support.recordings import picture

from altd.acquisition.self_check.correction import Correction
from altd.acquisition.self_check.frames import LedLog
from altd.acquisition.self_check.geometry_state import GeometryState
from altd.acquisition.self_check.judging import CheckJudge
from altd.acquisition.self_check.memory import CheckMemory
from altd.acquisition.self_check.schedule import Schedule
from altd.acquisition.self_check.service import CheckParts, SelfChecks
from altd.config import Installation, Measuring, SelfCheckSettings
from altd.instruments.beam.instrument import BeamInstrument
from altd.measuring.chain import MeasuringChain, View
from altd.records import Frame
from altd.selfcheck.records import DriftLimits
from altd.status.event_log import EventLog
from altd.status.health import Health
from altd.status.services import SelfCheckService

CAMERAS = {"left": "front", "right": "rear"}
PERIOD_NS = 50_000_000
SHOWN = {target: picture(target, 5.0, 3.0, np.random.default_rng(1)) for target in CAMERAS.values()}
DARK = np.full((480, 752), 8, np.uint8)
LIT = range(30, 35)
"""Exposures under the LEDs."""


class Bench:
    """Chain and checks as the pipeline has them; ``told`` is by exposure what was put on the board, if so."""

    def __init__(self, window: int) -> None:
        calibration = evidence.calibration()
        views = [View(target, camera) for camera, target in CAMERAS.items()]
        measuring = Measuring(window=window)
        self._chain = MeasuringChain(views, calibration, measuring, BeamInstrument(calibration, measuring))
        self._clock = FakeClock()
        self._leds = LedLog(self._clock, dict.fromkeys(CAMERAS, PERIOD_NS))
        settings, limits = SelfCheckSettings(enabled=False), DriftLimits()
        parts = CheckParts(
            self._leds,
            Schedule(self._clock, 600.0, automatic=False),
            CheckJudge(views, calibration, limits, Installation()),
            GeometryState(settings, limits, calibration, self._clock),
            Correction(self._chain.locators, calibration, CAMERAS),
            CheckMemory(calibration, self._clock),
        )
        component = Health(self._clock).component("self-check")
        self._checks = SelfChecks(
            parts, CAMERAS, SelfCheckService(EventLog(self._clock)), component, self._clock
        )
        self.told: dict[int, str] = {}
        self._rng = np.random.default_rng(2)

    def expose(self, numbers: Sequence[int], lost: Sequence[tuple[str, int]], dark: Sequence[int]) -> None:
        for number in numbers:
            self._clock.now_ns = number * PERIOD_NS
            if number in (LIT.start, LIT.stop):
                self._leds.begin(number == LIT.start)
                self._leds.done()
            for camera, target in CAMERAS.items():
                if (camera, number) not in lost:
                    pixels = self._pixels(target, number in dark)
                    lit = number in LIT
                    self._push(Frame(camera, number, self._clock.now_ns, pixels, leds_on=lit))

    def _pixels(self, target: str, dark: bool) -> np.ndarray:
        noise = self._rng.integers(0, 2, DARK.shape, dtype=np.uint8)
        return (DARK if dark else SHOWN[target]) + noise

    def _push(self, frame: Frame) -> None:
        for measurement in self._chain.push(frame):
            if (finding := self._checks.finding(measurement)) is not None:
                passed = measurement.with_findings(finding)
                self.told[measurement.sequence] = ", ".join(
                    str(fault) for fault in passed.status if not fault.reason.is_warning
                )


@pytest.mark.parametrize(("window", "lost"), [(4, {36}), (4, {35, 37}), (20, {22, 24, 26, 28, 36, 38})])
def test_exposures_that_one_camera_lost_beside_a_check_cost_no_valid_value(
    window: int, lost: set[int]
) -> None:
    """A slow machine: of as many lost exposures without a check a window makes a mean."""
    bench = Bench(window)
    bench.expose(range(50), [("left" if number % 4 else "right", number) for number in lost], [])
    settled = {number: why for number, why in bench.told.items() if number >= 20}
    assert set(settled.values()) == {""}
    assert max(after - before for before, after in itertools.pairwise(sorted(settled))) < 12


def test_a_spot_that_is_gone_after_a_check_is_told_with_its_third_exposure() -> None:
    bench = Bench(4)
    bench.expose(range(50), [], range(35, 50))
    assert [number for number, why in bench.told.items() if why and number] == list(range(37, 50))
    assert bench.told[37] == "front_spot_missing, rear_spot_missing"


def test_a_camera_that_falls_silent_after_a_check_is_told() -> None:
    bench = Bench(4)
    bench.expose(range(50), [("right", number) for number in range(35, 50)], [])
    assert "rear_camera_silent" in bench.told[max(bench.told)]
    assert min(number for number, why in bench.told.items() if why and number > 20) <= 38
