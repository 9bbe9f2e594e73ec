"""A unit that is corrected sees its view where the check found it: print, LEDs and spots are drawn there."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from support.clock import FakeClock
from support.dotted_print import DottedPrint
from support.frames import Blob, frame, light
from support.led_frames import Motion, Scene, unit
from support.measurements import beam_of

from altd.acquisition.self_check.correction import Correction
from altd.acquisition.self_check.geometry_state import GeometryState
from altd.config import Measuring, SelfCheckSettings
from altd.instruments.beam.instrument import BeamInstrument
from altd.measuring.calibration import Calibration
from altd.measuring.chain import MeasuringChain, View
from altd.records import Measurement
from altd.selfcheck.records import DriftLimits, SelfCheck
from altd.selfcheck.verdict import judge

CAMERAS = {"left": "front", "right": "rear"}
PRINT, PLATE = DottedPrint(1), DottedPrint(9, contrast=0.0)
SPOT_PX = {"front": (220.0, 140.0), "rear": (480.0, 300.0)}
DRIFT = Motion(0.6, -0.3, turn_deg=0.1)


@pytest.fixture(scope="module")
def calibration() -> Calibration:
    """The front target is printed; its camera has no hot pixels."""
    front, rear = unit().targets
    printed = replace(front, flat=PRINT.flat(), fingerprint=PRINT.fingerprint())
    return replace(unit(), targets=(printed, rear))


@cache
def picture(target: str, surface: DottedPrint, motion: Motion) -> np.ndarray:
    """The light of a spot on a surface, both moved."""
    u_px, v_px = motion.of(np.array([SPOT_PX[target]]))[0].tolist()
    return light(Blob(u_px, v_px, 60.0, peak=55.0)) * surface.response(motion.of)


class Bench:
    """A chain that is corrected, and the frames of a unit whose front camera moves."""

    def __init__(self, calibration: Calibration) -> None:
        views = [View(target, camera) for camera, target in CAMERAS.items()]
        measuring = Measuring(window=2)
        instrument = BeamInstrument(calibration, measuring)
        self.calibration = calibration
        self.geometry = GeometryState(
            SelfCheckSettings(compensate=True), DriftLimits(), calibration, FakeClock()
        )
        self.chain = MeasuringChain(views, calibration, measuring, instrument, correct=self.geometry.correct)
        self.correction = Correction(self.chain.locators, calibration, CAMERAS)
        self._rng = np.random.default_rng(3)
        self._number = 0

    def check(self, motion: Motion, seed: int = 1) -> SelfCheck:
        """The check's report and correction while the front camera's picture is displaced so."""
        rng = np.random.default_rng(seed)
        views = {"front": Scene(motion).view(rng), "rear": Scene().view(rng)}
        found = judge(views, self.calibration, None, DriftLimits())
        self.correction.prepare(self.geometry.transforms_after(found))
        self.geometry.take(found)
        self.correction.apply(self.geometry)
        return found

    def measured(self, motion: Motion, surface: DottedPrint = PRINT) -> Measurement:
        """The measurement of a window after a pause, of a beam at rest."""
        pictures = {"left": picture("front", surface, motion), "right": picture("rear", PLATE, Motion())}
        self._number += 20
        for _ in range(2):
            self._number += 1
            for camera, lit in pictures.items():
                shown = frame(lit, self._rng, 1.0, camera=camera)
                at = replace(shown, sequence=self._number, t_ns=self._number * 50_000_000)
                told = self.chain.push(at)
        return told[-1].with_findings(self.geometry.finding(told[-1].valid))


@pytest.fixture
def bench(calibration: Calibration) -> Bench:
    return Bench(calibration)


def codes(measurement: Measurement) -> set[str]:
    return {str(fault) for fault in measurement.status}


def test_what_is_corrected_is_measured_as_it_was_before(bench: Bench) -> None:
    bench.check(Motion())
    as_calibrated = bench.measured(Motion())
    assert codes(as_calibrated) == set()
    assert codes(bench.measured(DRIFT)) == {"front_wrong_camera"}
    bench.check(DRIFT)
    corrected = bench.measured(DRIFT)
    assert codes(corrected) == {"compensated"}
    for key, within in (("x_mm", 0.01), ("y_mm", 0.01), ("yaw_deg", 0.003), ("pitch_deg", 0.003)):
        assert corrected.number(key) == pytest.approx(as_calibrated.number(key), abs=within)
        sigma, usual = corrected.sigma(key), as_calibrated.sigma(key)
        assert sigma is not None
        assert usual is not None
        assert usual < sigma < 1.3 * usual


@pytest.mark.parametrize("beside", [(0.7, 0.0), (0.0, -0.7), (-0.6, 0.3)])
def test_a_shift_after_the_check_is_another_view(bench: Bench, beside: tuple[float, float]) -> None:
    bench.check(DRIFT)
    farther = replace(DRIFT, u_px=DRIFT.u_px + beside[0], v_px=DRIFT.v_px + beside[1])
    knocked = bench.measured(farther)
    assert not knocked.valid
    assert "front_wrong_camera" in codes(knocked)
    bench.check(farther)
    assert codes(bench.measured(farther)) == {"compensated"}


def test_a_small_shift_after_the_check_adds_to_sigma(bench: Bench) -> None:
    """0.3 px are 0.075 mm of the straight map."""
    bench.check(DRIFT)
    steady = beam_of(bench.measured(DRIFT))
    farther = beam_of(bench.measured(replace(DRIFT, u_px=DRIFT.u_px + 0.3)))
    assert steady is not None
    assert farther is not None
    error_mm = abs(farther.x_mm - steady.x_mm)
    assert error_mm == pytest.approx(0.075, abs=0.02)
    assert 0.7 * error_mm < farther.sigma_x_mm < 2 * error_mm
    assert steady.sigma_x_mm < 0.5 * farther.sigma_x_mm


def test_leds_that_moved_without_the_print_correct_nothing_unseen(bench: Bench) -> None:
    """A frame that came loose: the print lies where it lay, aside of where it is looked for."""
    bench.check(Motion(0.8))
    assert "front_wrong_camera" in codes(bench.measured(Motion()))


@pytest.mark.parametrize("seed", [2, 3])
def test_another_print_is_not_measured_where_the_picture_is_corrected(bench: Bench, seed: int) -> None:
    bench.check(DRIFT)
    foreign = bench.measured(DRIFT, DottedPrint(seed))
    assert not foreign.valid
    assert codes(foreign) & {"front_wrong_camera", "front_distorted"}


def test_after_the_correction_the_view_is_that_of_the_calibration(
    bench: Bench, calibration: Calibration
) -> None:
    bench.check(DRIFT)
    assert codes(bench.measured(DRIFT)) == {"compensated"}
    assert bench.check(Motion()).verdict == "good"
    assert bench.measured(Motion()).valid
    assert codes(bench.measured(DRIFT)) == {"front_wrong_camera"}
    front = calibration.targets[0]
    appearance = bench.chain.locators["left"].appearance
    assert (appearance.flat, appearance.fingerprint) == (front.flat, front.fingerprint)


def test_what_is_too_far_to_correct_leaves_the_view_where_it_was(
    bench: Bench, calibration: Calibration
) -> None:
    bench.check(DRIFT)
    bench.check(Motion(3.0))
    knocked = bench.measured(Motion(3.0))
    assert codes(knocked) == {"geometry_drift", "front_wrong_camera"}
    assert bench.chain.locators["left"].appearance.fingerprint is calibration.targets[0].fingerprint


def test_the_fingerprint_follows_every_check_and_the_flat_only_what_matters(bench: Bench) -> None:
    """Another flat costs a window; a view that is looked for 0.05 px aside would cost sigma."""
    bench.check(DRIFT)
    first = bench.chain.locators["left"].appearance
    found = bench.check(replace(DRIFT, u_px=DRIFT.u_px + 0.05), seed=2)
    second = bench.chain.locators["left"].appearance
    assert second.flat is first.flat
    assert second.fingerprint is not None
    similarity = found.targets["front"].similarity
    assert similarity is not None
    assert second.fingerprint.moved == pytest.approx(similarity.affine)
    bench.check(replace(DRIFT, u_px=DRIFT.u_px + 0.3), seed=3)
    assert bench.chain.locators["left"].appearance.flat is not first.flat
