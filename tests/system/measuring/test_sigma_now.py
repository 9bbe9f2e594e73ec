"""Sigma of now against the truth of a moving, vibrating machine.

The essential cells of ``docs/studies/sigma-now.md``, without pictures.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from support.moving_machine import KEYS, Machine, machine

from altd.config import Measuring
from altd.records import Measurement

LATE_S = (0.0, 0.5, 1.0)
TRIALS, EXPOSURES, KNOWN_FROM = 24, 60, 36


@pytest.mark.parametrize("vibrates", [False, True])
@pytest.mark.parametrize("speed_mm_per_s", [0.0, 0.5, 5.0])
def test_the_error_is_as_large_as_sigma_says_whenever_it_is_read(
    speed_mm_per_s: float, vibrates: bool
) -> None:
    ratios = []
    for seed in range(TRIALS):
        moving = machine(seed, speed_mm_per_s, vibrates=vibrates)
        for measurement in moving.measured(range(EXPOSURES), Measuring())[KNOWN_FROM::3]:
            assert measurement.valid
            ratios.append([_ratio(measurement, moving, late_s) for late_s in LATE_S])
    of_cells = np.sqrt(np.mean(np.square(ratios), axis=0))
    assert of_cells.min() > 0.8
    assert of_cells.max() < 1.25


def _ratio(measurement: Measurement, moving: Machine, late_s: float) -> np.ndarray:
    read_ns = measurement.light_ns + round(late_s * 1e9)
    values = np.array([measurement.values[key].value for key in KEYS])
    sigmas = [measurement.sigma_at(key, (read_ns - measurement.t_ns) * 1e-9) for key in KEYS]
    ratio: np.ndarray = (values - moving.truth(read_ns)) / np.array(sigmas, dtype=np.float64)
    return ratio


def test_every_third_exposure_lost_it_still_holds() -> None:
    ratios = []
    for seed in range(TRIALS):
        moving = machine(seed, 2.0, vibrates=True)
        numbers = [number for number in range(EXPOSURES) if number % 3]
        for measurement in [m for m in moving.measured(numbers, Measuring()) if m.sequence > KNOWN_FROM + 9]:
            assert measurement.valid
            ratios.append(_ratio(measurement, moving, 0.5))
    assert 0.8 < math.sqrt(np.mean(np.square(ratios))) < 1.25
