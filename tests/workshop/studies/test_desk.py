"""The path of a desk unit: screen plates, ``altd calibrate``, beams with truth."""

from pathlib import Path

import numpy as np

from studies.desk import CASES, Trial

MOVING = next(case for case in CASES if case.name == "JPEG 95, rolling shutter, 5 mm/s")
BEAMS = 12


def test_webcams_calibrated_from_a_screen_measure_moving_beams_and_know_their_errors(tmp_path: Path) -> None:
    errors, ratios = Trial(tmp_path).errors(MOVING, BEAMS)
    assert len(errors) == BEAMS
    assert np.abs(errors[:, :2]).max() < 0.05
    assert np.abs(errors[:, 2:]).max() < 0.02
    assert np.abs(ratios).max() < 5.0
