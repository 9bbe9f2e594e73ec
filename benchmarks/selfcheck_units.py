"""Simulated units for ``benchmarks.selfcheck``: calibrated by a scan, then checked and measured."""

import math
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from altd.calibration.calibrating import calibrate
from altd.config import Measuring
from altd.instruments.beam.instrument import BeamInstrument
from altd.measuring.calibration import Calibration
from altd.recording.reader import open_recording
from altd.records import Fault, FloatArray, Frame, MeanSpots, Spot
from altd.selfcheck.records import LedView
from altd.selfcheck.verdict import Compensation, compensated, flat_now
from altd.vision.frame_leds import locate_leds
from altd.vision.localise import locate
from benchmarks.harness import quiet
from hw_sim.assembly import FIELD_HALF_MM
from hw_sim.beam import BeamPose
from hw_sim.scan import STAGE_STREAM, record_scan
from hw_sim.stage import Stage
from hw_sim.unit import CAMERAS, Unit, UnitConfig

HARD_LUX = 1000.0
"""Ambient light in the brightest surroundings of App. A.1."""
WIDE, TIGHT = FIELD_HALF_MM, (76.0, 60.0)
"""Half of the field of view, mm: with all frame LEDs, or with some of them cut by the border."""
EXPOSURES = 2
"""Exposures of each camera for a measurement."""
KEYS = ("x_mm", "y_mm", "yaw_deg", "pitch_deg")


def calibrated(seed: int, field_half_mm: tuple[float, float] = WIDE) -> Calibration:
    """Calibration of a simulated unit, from its own scan."""
    with tempfile.TemporaryDirectory(prefix="altd-bench-") as folder:
        unit = Unit(UnitConfig(seed=seed, field_half_mm=field_half_mm))
        stage = Stage(np.random.default_rng([seed, STAGE_STREAM]))
        record_scan(Path(folder, "scan"), unit, stage, 2, quiet)
        return calibrate([open_recording(Path(folder, "scan"))]).calibration


class CheckedUnit:
    """A unit whose exposures are counted; ``exact`` draws every photon, which takes longer."""

    def __init__(self, seed: int, field_half_mm: tuple[float, float] = WIDE, *, exact: bool = False) -> None:
        self.unit = Unit(UnitConfig(seed=seed, lux=HARD_LUX, field_half_mm=field_half_mm))
        self._exact = exact
        self._sequence = 1000

    def views(self, pairs: int) -> dict[str, LedView]:
        """Exposures of one check: ``pairs`` of each camera with the LEDs on and as many with them off."""
        frames: dict[tuple[str, bool], list[Frame]] = {(c, on): [] for c in CAMERAS for on in (True, False)}
        for _ in range(pairs):
            for on in (True, False):
                self.unit.leds_on = on
                for camera in CAMERAS:
                    frames[camera, on].append(self._expose(camera))
                self._sequence += 1
        self.unit.leds_on = False
        return {c: LedView(tuple(frames[c, True]), tuple(frames[c, False])) for c in CAMERAS}

    def with_new_references(self, calibration: Calibration, pairs: int = 2) -> Calibration:
        """Calibration with LED references from current frames, as ``altd calibrate`` takes them."""
        targets = []
        for target in calibration.targets:
            view = self.views(pairs)[target.name]
            found = [
                np.array([(spot.u_px, spot.v_px) for spot in locate_leds(lit, dark).spots])
                for lit, dark in zip(view.lit, view.dark, strict=True)
            ]
            targets.append(replace(target, leds_px=np.mean(found, axis=0)))
        return replace(calibration, targets=tuple(targets))

    def measured(
        self, calibration: Calibration, poses: Sequence[BeamPose], compensation: Compensation | None
    ) -> tuple[FloatArray, FloatArray]:
        """Errors and sigmas, each (poses, 4): x and y mm, yaw and pitch °; NaN where it is not measured."""
        instrument = BeamInstrument(calibration, Measuring())
        errors, sigmas = np.full((len(poses), 4), np.nan), np.full((len(poses), 4), np.nan)
        for row, pose in enumerate(poses):
            self.unit.place(pose)
            mean = self._mean_spots(calibration, compensation)
            if mean is None:
                continue
            solved = instrument.solve(mean if compensation is None else compensated(mean, compensation))
            if isinstance(solved, Fault):
                continue
            angles = (math.degrees(math.atan(slope)) for slope in (pose.slope_x, pose.slope_y))
            values = [solved.values[key] for key in KEYS]
            errors[row] = np.array([value.value for value in values]) - (pose.x_mm, pose.y_mm, *angles)
            sigmas[row] = [value.sigma or math.nan for value in values]
        return errors, sigmas

    def _mean_spots(self, calibration: Calibration, compensation: Compensation | None) -> MeanSpots | None:
        spots: Mapping[str, list[Spot]] = {camera: [] for camera in CAMERAS}
        for _ in range(EXPOSURES):
            for camera in CAMERAS:
                target = next(each for each in calibration.targets if each.name == camera)
                flat = target.flat
                if flat is not None and compensation is not None:
                    flat = flat_now(flat, compensation.transforms[camera])
                spot = locate(self._expose(camera), target.localiser, flat)
                if not isinstance(spot, Spot):
                    return None
                spots[camera].append(spot)
            self._sequence += 1
        px = np.array([[np.mean([(s.u_px, s.v_px) for s in spots[camera]], axis=0)] for camera in CAMERAS])
        variances = [np.mean([s.sigma_px**2 for s in spots[camera]]) / EXPOSURES for camera in CAMERAS]
        covariance = np.diag(np.repeat(variances, 2))
        return MeanSpots(
            CAMERAS, px.reshape(-1, 2), covariance, 0, EXPOSURES, 0, shapes=(None,) * len(CAMERAS)
        )

    def _expose(self, camera: str) -> Frame:
        t_ns = self._sequence * self.unit.config.period_ns
        return self.unit.expose(camera, self._sequence, t_ns, exact=self._exact)
