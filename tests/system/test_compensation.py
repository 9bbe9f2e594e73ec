"""A camera moves after its calibration; the LEDs find it, what is corrected is held against the truth.

The chain is the daemon's, and what sets it right after a check; the test advances the time here.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest
from support.clock import FakeClock
from support.measurements import beam_chain

from altd.acquisition.self_check.correction import Correction
from altd.acquisition.self_check.geometry_state import GeometryState
from altd.config import Measuring, SelfCheckSettings
from altd.measuring.calibration import Calibration
from altd.records import Frame, Measurement
from altd.selfcheck.records import DriftLimits, LedView
from altd.selfcheck.verdict import judge
from altd.vision.hot_pixels import HotPixels, places_of
from hw_sim.beam import BeamPose
from hw_sim.displacement import Displacement
from hw_sim.measure import random_poses
from hw_sim.unit import CAMERAS, FRONT, REAR, Unit, UnitConfig

LUX = 1000.0
"""The brightest surroundings of App. A.1."""
WINDOW = 4
POSES = random_poses(40, 280.0, np.random.default_rng([3, 9]))
MOVED = Displacement((0.5, 0.33), turn_deg=0.1)
"""0.6 px."""
KEYS = ("x_mm", "y_mm", "yaw_deg", "pitch_deg")
REFUSED = {f"{target}_{reason}" for target in CAMERAS for reason in ("wrong_camera", "distorted")}

Expose = Callable[[str, int], Frame]


class Bench:
    """A chain, what corrects it, and the unit with seed 3 before it."""

    def __init__(self, calibration: Calibration) -> None:
        self._calibration = calibration
        self._geometry = GeometryState(
            SelfCheckSettings(compensate=True), DriftLimits(), calibration, FakeClock()
        )
        self._chain = beam_chain(calibration, Measuring(window=WINDOW), correct=self._geometry.correct)
        self._correction = Correction(self._chain.locators, calibration, {name: name for name in CAMERAS})
        self._sequence = 1000
        self.unit = Unit(UnitConfig(seed=3, lux=LUX))

    def check(self) -> None:
        """Two exposures with the LEDs on and two with them off, and what follows from them."""
        frames: dict[tuple[str, bool], list[Frame]] = {(c, on): [] for c in CAMERAS for on in (True, False)}
        for on in (True, False, True, False):
            self.unit.leds_on = on
            self._sequence += 1
            for camera in CAMERAS:
                frames[camera, on].append(self.exposed(camera, self._sequence))
        seen = {c: LedView(tuple(frames[c, True]), tuple(frames[c, False])) for c in CAMERAS}
        self._geometry.take(judge(seen, self._calibration, None, DriftLimits()))
        self._correction.apply(self._geometry)

    def exposed(self, camera: str, sequence: int) -> Frame:
        return self.unit.expose(camera, sequence, sequence * self.unit.config.period_ns)

    def measured(self, pose: BeamPose, expose: Expose | None = None) -> Measurement:
        """The first full window of a beam at rest there, after a pause."""
        self.unit.place(pose)
        self._sequence += 50
        for _ in range(WINDOW):
            self._sequence += 1
            for camera in CAMERAS:
                told = self._chain.push((expose or self.exposed)(camera, self._sequence))
        return told[-1].with_findings(self._geometry.finding(told[-1].valid))


def codes(measurement: Measurement) -> set[str]:
    """Without what every measurement of this unit says."""
    return {str(fault) for fault in measurement.status} - {"simulated", "rehearsal"}


@dataclass(frozen=True)
class Errors:
    """Measured minus true, and sigma, (poses, 4) each."""

    errors: np.ndarray
    sigmas: np.ndarray

    @classmethod
    def of(cls, measurements: Sequence[Measurement]) -> Errors:
        errors = [
            np.subtract([measurement.number(key) for key in KEYS], truth(pose))
            for measurement, pose in zip(measurements, POSES, strict=True)
        ]
        sigmas = [[measurement.sigma(key) for key in KEYS] for measurement in measurements]
        return cls(np.array(errors, dtype=float), np.array(sigmas, dtype=float))

    @property
    def rms(self) -> np.ndarray:
        return np.sqrt(np.mean(self.errors**2, axis=0))


def truth(pose: BeamPose) -> list[float]:
    slopes = pose.slope_x, pose.slope_y
    return [pose.x_mm, pose.y_mm, *(math.degrees(math.atan(slope)) for slope in slopes)]


@pytest.fixture(scope="module")
def normal(calibration_of_unit_3: Calibration) -> Errors:
    """Of the unit as it was calibrated."""
    bench = Bench(calibration_of_unit_3)
    bench.check()
    return Errors.of([bench.measured(pose) for pose in POSES])


@pytest.mark.parametrize("camera", CAMERAS)
def test_errors_and_sigma_are_as_before_the_camera_moved(
    calibration_of_unit_3: Calibration, normal: Errors, camera: str
) -> None:
    bench = Bench(calibration_of_unit_3)
    bench.unit.displace(camera, MOVED)
    bench.check()
    measurements = [bench.measured(pose) for pose in POSES]
    assert all(measurement.valid for measurement in measurements)
    assert all(codes(measurement) == {"compensated"} for measurement in measurements)
    corrected = Errors.of(measurements)
    assert np.all(corrected.rms < 1.3 * normal.rms)
    assert 0.8 < np.sqrt(np.mean((corrected.errors / corrected.sigmas) ** 2)) < 1.25
    assert np.all(np.median(corrected.sigmas, axis=0) < 1.25 * np.median(normal.sigmas, axis=0))


def without_hot_pixels(calibration: Calibration) -> Calibration:
    targets = []
    for target in calibration.targets:
        assert target.fingerprint is not None
        none = HotPixels(places_of([]), places_of([]))
        targets.append(replace(target, fingerprint=replace(target.fingerprint, hot=none)))
    return replace(calibration, targets=tuple(targets))


@pytest.mark.parametrize("beside_px", [(0.7, 0.0), (-0.5, 0.5), (-0.5, -0.33)])
def test_a_camera_that_moves_on_after_the_check_is_wrong_until_the_next(
    calibration_of_unit_3: Calibration, beside_px: tuple[float, float]
) -> None:
    """With the last one it is back where it was calibrated, and turned."""
    bench = Bench(without_hot_pixels(calibration_of_unit_3))
    bench.unit.displace(FRONT, MOVED)
    bench.check()
    farther = (MOVED.shift_px[0] + beside_px[0], MOVED.shift_px[1] + beside_px[1])
    bench.unit.displace(FRONT, replace(MOVED, shift_px=farther))
    for pose in POSES[:4]:
        knocked = bench.measured(pose)
        assert not knocked.valid
        assert "front_wrong_camera" in codes(knocked)
    bench.check()
    assert codes(bench.measured(POSES[0])) == {"compensated"}


def test_a_small_shift_after_the_check_is_in_the_uncertainty(calibration_of_unit_3: Calibration) -> None:
    """0.3 px, ten times what x is off by otherwise."""
    bench = Bench(calibration_of_unit_3)
    bench.unit.displace(FRONT, MOVED)
    bench.check()
    bench.unit.displace(FRONT, replace(MOVED, shift_px=(MOVED.shift_px[0] + 0.3, MOVED.shift_px[1])))
    measurements = [bench.measured(pose) for pose in POSES[:10]]
    assert all(measurement.valid for measurement in measurements)
    errors_mm = [m.number("x_mm") - pose.x_mm for m, pose in zip(measurements, POSES, strict=False)]  # type: ignore[operator]
    sigmas_mm = [m.sigma("x_mm") for m in measurements]
    assert np.mean(np.abs(errors_mm)) > 0.05
    assert np.max(np.abs(errors_mm) / np.array(sigmas_mm, dtype=float)) < 2.5


@pytest.mark.parametrize("known_by", ["hot pixels and print", "print"])
@pytest.mark.parametrize("what", ["of another unit", "exchanged", "mirrored", "front twice"])
def test_pictures_of_others_are_refused_while_a_drift_is_corrected(
    calibration_of_unit_3: Calibration, what: str, known_by: str
) -> None:
    known = calibration_of_unit_3
    bench = Bench(without_hot_pixels(known) if known_by == "print" else known)
    bench.unit.displace(FRONT, MOVED)
    bench.check()
    other = Unit(UnitConfig(seed=103, lux=LUX)) if what == "of another unit" else None

    def expose(camera: str, sequence: int) -> Frame:
        if what == "exchanged":
            return replace(bench.exposed(REAR if camera == FRONT else FRONT, sequence), camera=camera)
        if what == "front twice":
            return replace(bench.exposed(FRONT, sequence), camera=camera)
        frame = bench.exposed(camera, sequence)
        if other is not None:
            other.place(pose)
            return other.expose(camera, sequence, frame.t_ns)
        return replace(frame, pixels=np.ascontiguousarray(frame.pixels[:, ::-1]))

    for pose in POSES[:3]:
        refused = bench.measured(pose, expose)
        assert not refused.valid
        assert codes(refused) & REFUSED, codes(refused)
    assert bench.measured(POSES[3]).valid
