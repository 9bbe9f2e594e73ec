"""The measurement object as it is sent while the unit runs: what is true now, beside what was measured."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import pytest

from altd.files.documents import line_of
from altd.records import Measurement
from altd.status.measurement_json import as_object, as_object_now
from tools.pages.example import AGE_S, MEASURED

KEYS = ("x_mm", "y_mm", "yaw_deg", "pitch_deg")


def test_what_replay_writes_stays_as_it_is_and_nothing_of_now_is_in_it() -> None:
    assert as_object_now(MEASURED, AGE_S).items() >= as_object(MEASURED).items()
    assert "now" not in line_of(as_object(MEASURED))
    assert "rates" not in line_of(as_object(MEASURED))


def test_sigma_now_grows_with_age() -> None:
    sigmas = [as_object_now(MEASURED, age_s)["sigma_now"]["x_mm"] for age_s in (0.0, 0.5, 1.0, 10.0)]
    assert sigmas == sorted(sigmas)
    assert sigmas[0] == pytest.approx(math.hypot(0.004, 0.0102), abs=1e-4)
    # sigma, vibration and the way of 10 s at 0.0512 mm/s; half of 0.004 mm/s² over 10 s
    assert sigmas[-1] == pytest.approx(math.hypot(0.004, 0.0102, 0.512, 0.2), abs=1e-3)


def test_rates_are_per_second_with_their_sigma() -> None:
    rates = as_object_now(MEASURED, AGE_S)["rates"]
    assert rates["y_mm_per_s"] == -0.0214
    assert rates["sigma"]["y_mm_per_s"] == 0.0031
    assert [*rates] == [*(f"{key}_per_s" for key in KEYS), "sigma"]


@pytest.mark.parametrize(
    ("measurement", "age_s"),
    [
        (MEASURED.without_numbers(()), AGE_S),
        (replace(MEASURED, motions={}), AGE_S),
        (MEASURED, None),
    ],
)
def test_what_is_not_known_is_null(measurement: Measurement, age_s: float | None) -> None:
    document = json.loads(line_of(as_object_now(measurement, age_s)))
    assert document["sigma_now"] == dict.fromkeys(KEYS)
    if age_s is not None:
        rates = dict.fromkeys(f"{key}_per_s" for key in KEYS)
        assert document["rates"] == {**rates, "sigma": rates}


def test_frames_ahead_of_the_clock_are_not_better_than_those_of_now() -> None:
    assert as_object_now(MEASURED, -5.0)["sigma_now"] == as_object_now(MEASURED, 0.0)["sigma_now"]
