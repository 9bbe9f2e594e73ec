"""Limits of the tests, their power, and what a verification does not decide."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import scipy.stats

from altd.calibration.verification.estimate import Estimate, Estimated, Scatter
from altd.calibration.verification.verdict import Judgement, LimitTest, Result, judge, variance_ratio_quantile
from altd.records import Limits
from altd.records.limits import NO_LIMITS

REFERENCE = Limits(0.002, 30.0, 0.03, 0.1)
CALIBRATION = Limits(0.002, 40.0, 0.04, 0.2)
NOTHING = Estimated(0.0, 0.0)
GOOD = Estimate(
    scale_ppm=(Estimated(0.0, 50.0), NOTHING),
    square_mrad=NOTHING,
    offsets_mm=np.zeros((2, 2)),
    rotations_mrad=np.zeros(2),
    directions_deg=np.zeros((2, 2)),
    zero_deg=(Estimated(0.0, 0.001), NOTHING),
    upright_deg=(NOTHING, NOTHING),
    displacement=Scatter(0.01, 0.01, 30.0),
    direction=Scatter(0.003, 0.003, 30.0),
    residuals=(),
)


def judged(estimate: Estimate = GOOD, reference: Limits | None = REFERENCE) -> Judgement:
    return judge(estimate, reference, CALIBRATION)


def found(judgement: Judgement, key: str) -> LimitTest:
    return next(test for test in judgement.tests if test.key == key)


def test_limits_share_five_per_cent_among_the_tests() -> None:
    judgement = judged()
    assert (judgement.verdict, judgement.made, judgement.reasons) == (Result.PASSED, 7, ())
    scale = found(judgement, "scale_x_ppm")
    assert scale.sigma == pytest.approx(math.sqrt(50**2 + 30**2 + 40**2))
    assert scale.limit == pytest.approx(scale.sigma * scipy.stats.norm.ppf(1 - 0.05 / 14))
    zero = found(judgement, "zero_yaw_deg")
    # both orientations: nothing of the reference's beam, all of the calibration's
    assert zero.sigma == pytest.approx(math.hypot(0.001, math.degrees(0.2e-3)))
    scatter = found(judgement, "standard_deviation_mm")
    ratio = scipy.stats.f.ppf(1 - 0.05 / 7, 30, 45)
    assert scatter.limit == pytest.approx(0.01 * math.sqrt(ratio), rel=1e-3)


def test_the_smallest_detectable_error_fails_with_95_per_cent() -> None:
    judgement = judged()
    scale = found(judgement, "scale_x_ppm")
    assert scale.detectable is not None
    assert scipy.stats.norm(scale.detectable, scale.sigma).sf(scale.limit) == pytest.approx(0.95, abs=1e-3)
    scatter = found(judgement, "standard_deviation_mm")
    assert scatter.detectable is not None
    assert scatter.limit is not None
    assert scipy.stats.f(30, 45).sf((scatter.limit / scatter.detectable) ** 2) == pytest.approx(
        0.95, abs=1e-3
    )


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"scale_ppm": (Estimated(-400.0, 50.0), NOTHING)}, "scale of x is beyond its limit"),
        ({"square_mrad": Estimated(0.2, 0.0)}, "squareness is beyond its limit"),
        ({"zero_deg": (NOTHING, Estimated(0.05, 0.001))}, "zero of pitch is beyond its limit"),
        ({"displacement": Scatter(0.016, 0.01, 30.0)}, "standard deviation of x, y is beyond its limit"),
        ({"direction": Scatter(0.005, 0.003, 30.0)}, "standard deviation of yaw, pitch is beyond its limit"),
    ],
)
def test_one_error_beyond_its_limit_fails_the_unit(change: dict[str, object], reason: str) -> None:
    judgement = judged(replace(GOOD, **change))  # type: ignore[arg-type]
    assert (judgement.verdict, judgement.reasons) == (Result.FAILED, (reason,))


def test_nothing_is_tested_against_a_reference_of_which_nothing_is_known() -> None:
    judgement = judged(replace(GOOD, square_mrad=Estimated(9.0, 0.0)), None)
    assert (judgement.verdict, judgement.made) == (Result.NOT_DECIDED, 0)
    assert judgement.reasons == ("the uncertainty of the reference is unknown: its header states no limits",)


def test_what_the_reference_does_not_state_is_not_tested() -> None:
    judgement = judged(reference=replace(REFERENCE, stage_scale_ppm=None))
    assert (judgement.verdict, judgement.made) == (Result.NOT_DECIDED, 5)
    assert judgement.reasons == tuple(
        f"scale of {axis}: the reference's limits do not state stage_scale_ppm" for axis in "xy"
    )


def test_without_a_turned_set_the_zero_is_that_of_the_stated_beam_or_not_tested() -> None:
    upright = replace(GOOD, zero_deg=None, upright_deg=(Estimated(0.001, 0.001), NOTHING))
    zero = found(judged(upright), "zero_yaw_deg")
    assert zero.value == 0.001
    assert zero.parts["reference"] == pytest.approx(math.degrees(0.1e-3))
    unstated = judged(upright, replace(REFERENCE, beam_normal_mm_per_m=None))
    assert (unstated.verdict, unstated.made) == (Result.PASSED, 5)
    assert found(unstated, "zero_yaw_deg").result is Result.NOT_DECIDED


def test_few_degrees_of_freedom_and_other_reasons_leave_it_open_unless_a_test_fails() -> None:
    few = replace(GOOD, displacement=Scatter(0.1, 0.01, 4.0))
    judgement = judged(few)
    assert judgement.verdict is Result.NOT_DECIDED
    assert "4.0 degrees of freedom" in judgement.reasons[0]
    assert judge(GOOD, REFERENCE, NO_LIMITS, ["why"]).reasons == ("why",)
    failed = judge(replace(GOOD, square_mrad=Estimated(9.0, 0.0)), REFERENCE, CALIBRATION, ["why"])
    assert failed.verdict is Result.FAILED


def test_quantiles_are_those_of_scipy() -> None:
    for freedom in (8, 12, 34.5, 200):
        for below in (45, 1e6):
            for probability in (0.05, 0.5, 0.95, 0.995):
                expected = scipy.stats.f.ppf(probability, freedom, below)
                assert variance_ratio_quantile(probability, freedom, below) == pytest.approx(
                    expected, rel=5e-3
                )
