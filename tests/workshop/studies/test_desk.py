"""The path of a desk unit: screen plates, ``altd calibrate``, beams with truth."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from hw_sim.desk import FIELD_MM, speckle_contrast
from studies.bench import rms
from studies.desk import CASES, LINEAR, Case, Trial

MOVING = next(case for case in CASES if case.name == "JPEG 95, rolling, 5 mm/s")
DRAWN = next(case for case in CASES if case.is_drawn)


def test_webcams_calibrated_from_a_screen_measure_moving_beams_and_know_their_errors(tmp_path: Path) -> None:
    found = Trial(tmp_path).found(MOVING, 12)
    assert not found.refused
    assert np.abs(found.errors[:, :2]).max() < 0.06
    assert np.abs(found.errors[:, 2:]).max() < 0.02
    assert np.abs(found.ratios).max() < 5.0


def test_the_sigma_of_units_with_a_coherent_laser_is_not_too_small(tmp_path: Path) -> None:
    found = Trial(tmp_path).found(Case("speckle", LINEAR, units=(1, 2)), 12)
    assert 0.6 < rms(found.ratios) < 1.1
    assert np.abs(found.ratios).max() < 4.0


def test_units_whose_screens_err_as_stated_err_as_their_sigma_says(tmp_path: Path) -> None:
    found = Trial(tmp_path).found(replace(DRAWN, units=(1, 2)), 6)
    assert rms(found.errors[:, :2]) > 0.2
    assert 0.5 < rms(found.ratios) < 1.5
    assert np.abs(found.ratios).max() < 4.0


def test_speckle_scatters_less_from_pixel_to_pixel_where_a_pixel_sees_more_of_it() -> None:
    """Two polarisations leave 1/√2 of a grain; 480 rows see 3.5 grains of 0.0125 mm² a pixel: 0.34."""
    assert abs(speckle_contrast(1e-6) - 2**-0.5) < 1e-6
    assert abs(speckle_contrast(FIELD_MM / 480) - 0.34) < 0.01
