import math

import numpy as np
import pytest

from altd.selfcheck.history import DAY_S, CheckHistory
from altd.selfcheck.records import LedState, SelfCheck, Similarity, TargetDrift, Verdict

RADIUS_PX = 330.0
NOISE_PX = 0.0055
"""Of one LED in one pair of hw_sim's frames, an axis."""
IN_UNITS = np.array([1.0, 1.0, math.degrees(1 / RADIUS_PX), 1e6 / RADIUS_PX])
"""One px at the LEDs as shift, shift, turn and scale."""


def check(vector: np.ndarray, sigma_px: float, target: str = "front") -> SelfCheck:
    u, v, turn, scale = vector.tolist()
    covariance = np.diag((sigma_px * IN_UNITS) ** 2)
    similarity = Similarity((375.0, 240.0), (u, v), turn, scale, covariance, RADIUS_PX)
    drift = TargetDrift(target, 6, 6, (LedState.USED,) * 6, similarity=similarity, rms_px=0.0)
    return SelfCheck(Verdict.GOOD, {target: drift}, {})


def days_until_told(
    px_a_day: np.ndarray, seed: int, days: int = 15, checks_a_day: int = 1, noise_px: float = NOISE_PX
) -> int | None:
    """Days until a drift in four directions is reported; None: never. The reference is off by its noise."""
    rng = np.random.default_rng(seed)
    each = noise_px / math.sqrt(6)
    reference = rng.normal(0, each, 4)
    history = CheckHistory.empty()
    for number in range(days * checks_a_day):
        day = number / checks_a_day
        found = reference + rng.normal(0, each, 4) + px_a_day * day
        history = history.with_check(check(found * IN_UNITS, each * math.sqrt(2)), 5e8 + day * DAY_S)
        if history.slow_drifts:
            return math.ceil(day)
    return None


@pytest.mark.parametrize("checks_a_day", [1, 6])
@pytest.mark.parametrize(
    "direction", [(1, 0, 0, 0), (-1, 0, 0, 0), (0.7, -0.7, 0, 0), (0, 0, 1, 0), (0, 0, 0, -1)]
)
def test_a_fiftieth_px_a_day_is_told_within_ten_days(direction: tuple[float, ...], checks_a_day: int) -> None:
    for seed in range(10):
        told = days_until_told(0.02 * np.array(direction), seed, checks_a_day=checks_a_day)
        assert told <= 10


def test_ten_thousand_checks_without_a_drift_tell_none() -> None:
    """100 calibrations of 25 days with four checks each: a reference that is off is off in all its checks."""
    assert [days_until_told(np.zeros(4), seed, 25, 4) for seed in range(100)] == [None] * 100


def test_a_noisier_unit_needs_more_and_tells_no_more_often() -> None:
    noisy = 10 * NOISE_PX
    assert [days_until_told(np.zeros(4), seed, 25, 1, noisy) for seed in range(100)] == [None] * 100
    told = [days_until_told(np.array([0.02, 0, 0, 0]), seed, 40, 1, noisy) for seed in range(10)]
    assert all(day is not None for day in told)


def test_a_warm_afternoon_is_no_drift() -> None:
    history = CheckHistory.empty()
    for hour in range(24 * 20):
        warmth = 0.08 * math.sin(2 * math.pi * hour / 24)
        history = history.with_check(check(np.array([warmth, 0, 0, 0]), 0.003), hour * 3600.0)
    assert history.slow_drifts == ()


def test_what_is_told_is_how_far_and_how_fast_and_of_which_target() -> None:
    history = CheckHistory.empty()
    for day in range(12):
        shifted = np.array([0.03 * day, -0.04 * day, 0, 0])
        history = history.with_check(check(shifted, 0.003, "rear"), day * DAY_S)
        history = history.with_check(check(np.zeros(4), 0.003, "front"), day * DAY_S)
    (drift,) = history.slow_drifts
    assert drift.target == "rear"
    assert drift.px_per_day == pytest.approx(0.05, rel=1e-6)
    assert drift.shift_px == pytest.approx((0.27, -0.36), rel=1e-6)  # mean of the days 8, 9 and 10


def test_a_drift_that_was_mended_is_told_no_more() -> None:
    history = CheckHistory.empty()
    for day in range(60):
        shift = 0.02 * day if day < 15 else 0.0
        history = history.with_check(check(np.array([shift, 0, 0, 0]), 0.003), day * DAY_S)
        if day == 14:
            assert history.slow_drifts
    assert history.slow_drifts == ()


def test_a_check_that_knows_nothing_leaves_the_history_as_it_is() -> None:
    known = CheckHistory.empty().with_check(check(np.zeros(4), 0.003), 0.0)
    nothing = SelfCheck(Verdict.UNKNOWN, {"front": TargetDrift("front", 6, 2, (LedState.DARK,) * 6)}, {})
    assert known.with_check(nothing, DAY_S) == known


def test_a_clock_that_is_set_back_closes_no_day() -> None:
    history = CheckHistory.empty().with_check(check(np.zeros(4), 0.003), 10 * DAY_S)
    back = history.with_check(check(np.zeros(4), 0.003), 3 * DAY_S)
    assert back.targets["front"].days == ()
    assert back.targets["front"].today.checks == 2
