"""The benchmark of ``altd verify``: right and wrong units, by the stated confidence and power."""

import pytest
import scipy.stats

from altd.calibration.verification.verdict import Result
from benchmarks.verification import Change, VerifiedUnit, power, run


def test_of_forty_units_wrong_ones_fail_and_right_ones_pass() -> None:
    outcome = run(100, 40, 4)
    assert (outcome.right, outcome.wrong) == (30, 10)
    # at 5 % more than 5 of 30 fail once in 300 runs, at 90 % fewer than 6 of 10 are found once in 60
    assert outcome.false_alarms <= 5
    assert outcome.detected >= 6
    assert outcome.expected == pytest.approx(9.0, abs=0.1)


def test_a_pattern_twice_as_strong_as_the_stated_one_fails() -> None:
    judgement = VerifiedUnit(1).verified(Change(pattern=2.0))
    assert judgement.verdict is Result.FAILED
    assert "standard deviation of x, y is beyond its limit" in judgement.reasons


def test_the_stated_power_is_that_of_a_normal_distribution() -> None:
    factor = scipy.stats.norm.ppf(1 - 0.05 / 14)
    assert power(4.0, 7) == pytest.approx(scipy.stats.norm.sf(factor, 4.0), abs=1e-6)
