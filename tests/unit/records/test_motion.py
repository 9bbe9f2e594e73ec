"""Distance of the truth from a mean of the past, by formulas of motion; numbers of things in sentences."""

import math

import numpy as np
import pytest

from altd.records import counted
from altd.records.spots import Motion

TIMES_S = (np.arange(20) - 9.5) / 20.0
"""Of the exposures of one window, from their middle."""
SPREAD_S2 = float(np.mean(TIMES_S**2))


def motion(rate: float = 0.0, vibration: float = 0.0, acceleration: float = 0.0) -> Motion:
    return Motion(rate, 0.0, vibration, 0.0, 0.475, SPREAD_S2, abs(rate), acceleration)


def since(of: Motion, age_s: float) -> float:
    variance = of.variance_since(age_s)
    assert variance is not None
    return math.sqrt(variance)


@pytest.mark.parametrize("age_s", [0.0, 0.475, 1.0, 1.475])
def test_of_steady_motion_it_is_the_way_gone(age_s: float) -> None:
    assert since(motion(rate=-5.0), age_s) == pytest.approx(5.0 * age_s)


@pytest.mark.parametrize("age_s", [0.0, 0.475, 1.0, 1.475])
def test_of_accelerated_motion_it_is_the_distance_from_the_mean_of_the_window(age_s: float) -> None:
    mean = np.mean(0.5 * 3.0 * TIMES_S**2)
    assert since(motion(acceleration=3.0), age_s) == pytest.approx(abs(0.5 * 3.0 * age_s**2 - mean))


def test_vibration_counts_in_full_at_any_age() -> None:
    assert [since(motion(vibration=0.05), age_s) for age_s in (0.0, 1.0)] == pytest.approx([0.05, 0.05])


def test_a_beam_that_left_goes_on_from_where_it_was_seen_last() -> None:
    leaving = Motion(0.0, 0.01, 0.0, 5.0, 0.4, SPREAD_S2, 0.0, 0.0)
    assert [since(leaving, age_s) for age_s in (0.3, 0.4, 0.9)] == pytest.approx([0.0, 0.0, 2.5])


@pytest.mark.parametrize(("probable_rate", "acceleration"), [(None, None), (0.1, None), (None, 0.1)])
def test_what_was_not_seen_is_not_known(probable_rate: float | None, acceleration: float | None) -> None:
    assert Motion(0.1, 0.1, 0.1, 0.0, 0.4, 0.1, probable_rate, acceleration).variance_since(1.0) is None


@pytest.mark.parametrize(
    ("number", "said"), [(0, "0 exposures"), (1, "1 exposure"), (2, "2 exposures"), (21, "21 exposures")]
)
def test_only_one_is_singular(number: int, said: str) -> None:
    assert counted(number, "exposure") == said
