"""Films that take light at a part of the front spot, drawn from the optics alone."""

import math
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from support.made_once import loaded_once
from support.optics import Beam, Scene, Unit, patch, poses, random_beams, scan, write

from altd.calibration.calibrating import calibrate
from altd.config import Measuring
from altd.instruments.beam.instrument import BeamInstrument
from altd.measuring.calibration import Calibration
from altd.measuring.chain import MeasuringChain, View
from altd.recording.reader import open_recording
from altd.records import Frame, Measurement

UNIT = Unit(seed=5)
EXPOSURE_MS = 10.0
KEYS = ("x_mm", "y_mm", "yaw_deg", "pitch_deg")


def calibrated() -> Calibration:
    with TemporaryDirectory() as folder:
        path = write(Path(folder), "scan", scan(UNIT), exposure_ms=EXPOSURE_MS)
        return calibrate([open_recording(path)]).calibration


def measured(beams: list[Beam], scenes: list[Scene]) -> list[Measurement]:
    """The first measurement of each beam after a start, from two exposures."""
    calibration, measuring = loaded_once("optics-5", calibrated), Measuring(window=2, every=2)
    views = [View(name, name) for name in ("front", "rear")]
    found = []
    for number, (beam, scene) in enumerate(zip(beams, scenes, strict=True)):
        chain = MeasuringChain(views, calibration, measuring, BeamInstrument(calibration, measuring))
        for t_s, name, pixels, _ in poses(UNIT, [beam], scene, seed=number):
            t_ns = round(t_s * 1e9)
            pixels.flags.writeable = False
            frame = Frame(name, round(t_s * 20), t_ns, pixels, exposure_ms=EXPOSURE_MS)
            found += chain.push(frame)
    return found


def errors_per_sigma(beams: list[Beam], found: list[Measurement]) -> np.ndarray:
    rows = []
    for beam, measurement in zip(beams, found, strict=True):
        if measurement.values:
            slopes = [math.degrees(math.atan(slope)) for slope in (beam.slope_x, beam.slope_y)]
            values = [measurement.values[key] for key in KEYS]
            truth = (beam.x, beam.y, *slopes)
            rows.append([(of.value - true) / of.sigma for of, true in zip(values, truth, strict=True)])
    return np.array(rows)


def test_what_a_film_does_from_the_start_is_in_sigma_or_refused() -> None:
    """Without the light of the scan the errors are 1.9 sigmas rms, up to 5.9, and nothing is refused."""
    rng, beams = np.random.default_rng(8), random_beams(20, seed=8)
    films = []
    for beam in beams:
        x_mm, y_mm = rng.uniform(-8, 8, 2)
        films.append(
            patch(
                beam.x + x_mm, beam.y + y_mm, rng.uniform(5, 15), rng.uniform(0.03, 0.15), rng.uniform(0.5, 4)
            )
        )
    clean = beams[::3]
    without = errors_per_sigma(clean, measured(clean, [Scene()] * len(clean)))
    behind = errors_per_sigma(beams, measured(beams, [Scene(film=film) for film in films]))
    assert len(without) == len(clean)
    assert np.sqrt(np.square(without).mean()) < 1.25
    assert len(behind) > 0.6 * len(beams)
    assert np.sqrt(np.square(behind).mean()) < 1.4
    assert np.abs(behind).max() < 5
