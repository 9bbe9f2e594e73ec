"""Units drawn from the optics, calibrated at 20 °C and measured at −10 and +60 °C."""

import math
from pathlib import Path

import numpy as np
import pytest
from support import optics
from support.cli import altd_here
from support.optics import Unit

from altd.app.replay import replay_of
from altd.config import Expansion, Installation
from altd.instruments.beam.instrument import BeamInstrument
from altd.measuring.chain import MeasuringChain
from altd.recording.reader import open_recording

CALIBRATED_C = 20.0
KEYS = ("x_mm", "y_mm", "yaw_deg", "pitch_deg")
BEAMS = optics.random_beams(16, seed=5)
TRUTH = np.array(
    [(b.x, b.y, math.degrees(math.atan(b.slope_x)), math.degrees(math.atan(b.slope_y))) for b in BEAMS]
)
FRAMES = {"aluminium": (23.0, 23.0), "cameras with frames that do not grow": (0.0, 23.0)}
"""Expansion of what holds the cameras, and of what holds the targets, ppm/K."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("warm")
    scan = optics.write(folder / "scan", "scan", optics.scan(Unit()), temperature_c=CALIBRATED_C)
    assert altd_here("calibrate", scan, "-o", folder / "calibration.json").status == 0
    for frame, (view_ppm, distance_ppm) in FRAMES.items():
        for celsius in (-10.0, 60.0):
            per_k = 1e-6 * view_ppm, 1e-6 * distance_ppm
            warm = Unit(warm_k=celsius - CALIBRATED_C, expansion_per_k=per_k)
            rows = optics.poses(warm, BEAMS, exposures=1)
            optics.write(folder / f"{frame} {celsius:g}", "measurement", rows)
    return folder


def measured(
    folder: Path, frame: str, celsius: float, expansion: Expansion | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Errors and sigmas (n, 4) of ``KEYS``, without a thermometer or with one and what is known of it."""
    installation = Installation()
    if expansion is not None:
        installation = Installation(thermometer="frame", expansion=expansion)
    replay = replay_of(open_recording(folder / f"{frame} {celsius:g}"), folder / "calibration.json", 1)
    instrument = BeamInstrument(replay.calibration, replay.measuring, installation, lambda: celsius)
    chain = MeasuringChain(replay.views, replay.calibration, replay.measuring, instrument)
    found = [m for row in replay.recording.rows for m in chain.push(replay.recording.frame(row))]
    assert len(found) == len(BEAMS)
    assert all(measurement.valid for measurement in found)
    values = np.array([[m.values[key].value for key in KEYS] for m in found])
    return values - TRUTH, np.array([[m.values[key].sigma for key in KEYS] for m in found])


def scale_ppm(errors: np.ndarray, of: slice) -> float:
    """Error proportional to the quantity, of both axes."""
    return 1e6 * float(np.sum(errors[:, of] * TRUTH[:, of]) / np.sum(TRUTH[:, of] ** 2))


PLACE, ANGLE = slice(0, 2), slice(2, 4)
NOISE_PPM = 250.0
"""Of a scale by sixteen beams with errors of 0.012 mm and 0.003°: 60 to 100 ppm."""


@pytest.mark.parametrize("celsius", [-10.0, 60.0])
@pytest.mark.parametrize("frame", FRAMES)
def test_the_stated_expansion_is_removed(folder: Path, frame: str, celsius: float) -> None:
    """Fig. 3.17; a frame of one metal keeps all angles, so its distance must not be corrected alone."""
    view_ppm, distance_ppm = FRAMES[frame]
    warmer_k = celsius - CALIBRATED_C
    before, _ = measured(folder, frame, celsius)
    assert scale_ppm(before, PLACE) == pytest.approx(-view_ppm * warmer_k, abs=NOISE_PPM)
    assert scale_ppm(before, ANGLE) == pytest.approx((distance_ppm - view_ppm) * warmer_k, abs=NOISE_PPM)
    known = Expansion(
        distance_ppm_per_k=distance_ppm,
        distance_sigma_ppm_per_k=1.0,
        view_ppm_per_k=view_ppm,
        view_sigma_ppm_per_k=1.0,
    )
    after, sigmas = measured(folder, frame, celsius, known)
    assert abs(scale_ppm(after, PLACE)) < NOISE_PPM
    assert abs(scale_ppm(after, ANGLE)) < NOISE_PPM
    rms_of_z = np.sqrt(np.mean((after / sigmas) ** 2, axis=0))
    assert (rms_of_z < 1.3).all(), rms_of_z


@pytest.mark.parametrize("stated", [{}, {"distance_ppm_per_k": 23.0, "distance_sigma_ppm_per_k": 1.0}])
@pytest.mark.parametrize("celsius", [-10.0, 60.0])
def test_an_expansion_that_is_not_stated_is_in_sigma(
    folder: Path, celsius: float, stated: dict[str, float]
) -> None:
    """Also where the distance is corrected and the cameras, of the same metal, are forgotten."""
    errors, sigmas = measured(folder, "aluminium", celsius, Expansion(**stated))
    rms_of_z = np.sqrt(np.mean((errors / sigmas) ** 2, axis=0))
    assert (rms_of_z < 1.3).all(), rms_of_z
