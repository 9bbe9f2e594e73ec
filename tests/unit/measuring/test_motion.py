"""Rates, vibration and onset of the spots of a window, what past windows add, and ``sigma_now``.

The spots move on made-up paths with known motion, the machine as the simulator says.
"""

import math
from collections.abc import Callable, Iterable

import numpy as np
import pytest
from support.moving_machine import KEYS, machine

from altd.config import Installation, Measuring
from altd.measuring.averaging import mean_spots
from altd.measuring.motion_memory import MotionMemory
from altd.reasons import Reason
from altd.records import FrameSet, MeanSpots, NoSpot, Spot
from altd.records.spots import Motion, SpotMotion

TARGETS = ("front", "rear")
PERIOD_NS = 50_000_000
NOISE_PX = 0.02


def motion_of(front_u_px: np.ndarray, missing: tuple[int, ...] = ()) -> SpotMotion | None:
    """The motion of a window in which the front spot moves along u; the rear one rests, with its noise."""
    rng = np.random.default_rng(int(1e6 * abs(front_u_px[0])))
    sets = []
    for number, u_px in enumerate(front_u_px):
        rear = Spot(*rng.normal((310.0, 220.0), NOISE_PX), NOISE_PX, 44.0, 180.0)
        front = Spot(float(u_px), 200.0 + rng.normal(0, NOISE_PX), NOISE_PX, 44.0, 180.0)
        gone = NoSpot(Reason.SPOT_MISSING)
        spots = {"front": gone if number in missing else front, "rear": rear}
        sets.append(FrameSet(number, number * PERIOD_NS, spots))
    mean = mean_spots(sets, TARGETS, len(sets))
    assert isinstance(mean, MeanSpots), mean
    return mean.motion


@pytest.mark.parametrize("missing", [(), (2, 3, 4, 9)])
def test_the_rate_has_the_covariance_of_monte_carlo(missing: tuple[int, ...]) -> None:
    rng = np.random.default_rng(1)
    rates, variances = [], []
    for _ in range(1000):
        motion = motion_of(300.0 + 0.15 * np.arange(20) + rng.normal(0, 0.1, 20), missing)
        rates.append(motion.rate_px_per_s[0])
        variances.append(motion.rate_covariance[0, 0])
    assert np.mean(rates) == pytest.approx(3.0, abs=0.02)
    assert np.sqrt(np.mean(variances)) == pytest.approx(np.std(rates), rel=0.1)


def test_vibration_is_the_scatter_without_the_noise_of_the_spots() -> None:
    rng = np.random.default_rng(2)
    shake_px, found = 0.1, []
    for _ in range(400):
        motion = motion_of(300.0 + rng.normal(0, np.hypot(shake_px, NOISE_PX), 20))
        found.append(np.diag(motion.vibration_px2))
    front_u, *others = np.mean(found, axis=0)
    assert front_u == pytest.approx(shake_px**2, rel=0.15)  # drawn a tenth towards the noise
    assert np.abs(others).max() < 0.1 * NOISE_PX**2


def test_a_sway_as_long_as_the_window_is_vibration() -> None:
    motion = motion_of(300.0 + 2.0 * np.sin(2 * np.pi * np.arange(20) / 20.0 + np.pi / 2))
    assert abs(motion.rate_px_per_s[0]) < 0.1 * 2.0 * 2 * np.pi  # its highest speed
    assert np.sqrt(motion.vibration_px2[0, 0]) > 0.9 * 2.0 / np.sqrt(2.0)


@pytest.mark.parametrize("moved", [1, 3, 6])
def test_a_beam_that_begins_to_move_is_seen_by_its_first_exposure(moved: int) -> None:
    rng = np.random.default_rng(3)
    speed_px_per_s = 20.0
    way = np.concatenate([np.zeros(20 - moved), speed_px_per_s * 0.05 * np.arange(1, moved + 1)])
    motion = motion_of(300.0 + way + rng.normal(0, NOISE_PX, 20))
    assert motion.onset_px_per_s[0] == pytest.approx(speed_px_per_s, rel=0.05)
    assert abs(motion.rate_px_per_s[0]) < 0.1  # the mean itself stands still


def test_an_outlier_that_is_not_the_newest_is_no_onset() -> None:
    path = np.full(20, 300.0)
    path[10] += 40.0
    motion = motion_of(path)
    assert not motion.onset_px_per_s.any()


@pytest.mark.parametrize("count", [1, 2, 3])
def test_so_few_exposures_show_no_motion(count: int) -> None:
    assert motion_of(np.full(count, 300.0)) is None


def test_times_are_those_of_the_exposures_that_count() -> None:
    motion = motion_of(np.full(20, 300.0))
    times_s = (np.arange(20) - 9.5) / 20.0
    assert motion.span_s == pytest.approx(0.95)
    assert motion.onset_s == pytest.approx(0.475)
    assert motion.spread_s2 == pytest.approx(np.mean(times_s**2))


SPAN_S = 0.95
SIGMA_RATE = 0.04


def window(rate: float) -> dict[str, Motion]:
    return {"x_mm": Motion(rate, SIGMA_RATE, 0.05, 0.0, 0.475, 0.083)}


def learned(rates: Iterable[float], memory: MotionMemory | None = None, first: int = 0) -> list[Motion]:
    """After each of the windows, one an exposure."""
    memory = memory or MotionMemory()
    return [
        memory.add((first + number) * PERIOD_NS, (first + number + 10) * PERIOD_NS, SPAN_S, window(rate))[
            "x_mm"
        ]
        for number, rate in enumerate(rates)
    ]


def of_sliding_windows(rate: Callable[[float], float], count: int, seed: int = 1) -> list[float]:
    """Rates as windows that share 19 of 20 exposures estimate them: true one a time, and noise like that."""
    rng = np.random.default_rng(seed)
    times_s = (np.arange(20) - 9.5) / 20.0
    weights = times_s / (times_s @ times_s)
    noise = np.convolve(rng.normal(0.0, SIGMA_RATE / np.linalg.norm(weights), count + 19), weights, "valid")
    return [rate(number / 20.0) + float(noise[number]) for number in range(count)]


def test_how_a_rate_changes_is_known_when_two_windows_share_no_exposure() -> None:
    known = [motion.acceleration is not None for motion in learned([0.0] * 30)]
    assert known == [False] * 20 + [True] * 10


def test_at_rest_noise_of_the_rates_is_not_taken_for_motion() -> None:
    motions = learned(of_sliding_windows(lambda t_s: 0.0, 4000))[400:]
    assert math.sqrt(np.mean([motion.probable_rate**2 for motion in motions])) < 0.8 * SIGMA_RATE
    assert math.sqrt(np.mean([motion.acceleration**2 for motion in motions])) < 0.8 * SIGMA_RATE


def test_steady_motion_is_a_rate_and_no_acceleration() -> None:
    motions = learned(of_sliding_windows(lambda t_s: 5.0, 2000))[400:]
    squares = [motion.probable_rate**2 for motion in motions]
    assert np.mean(squares) == pytest.approx(25.0, rel=0.01)
    assert max(motion.acceleration for motion in motions) < 0.2


def test_a_rate_as_small_as_its_noise_is_not_understated() -> None:
    motions = learned(of_sliding_windows(lambda t_s: SIGMA_RATE, 4000))[400:]
    squares = [motion.probable_rate**2 for motion in motions]
    assert SIGMA_RATE**2 < np.mean(squares) < 2.0 * SIGMA_RATE**2


def test_the_acceleration_of_a_path_is_not_understated() -> None:
    speed, period_s = 5.0, 23.0
    path = of_sliding_windows(lambda t_s: speed * math.sin(2 * math.pi * t_s / period_s), 3000)
    squares = [motion.acceleration**2 for motion in learned(path)[600:]]
    assert 1.0 < np.mean(squares) / ((2 * math.pi * speed / period_s) ** 2 / 2) < 1.5


def test_the_first_change_of_the_rate_counts_at_once_and_is_forgotten_with_time() -> None:
    motions = learned([0.0] * 100 + [5.0] * 1200)
    assert motions[99].acceleration == 0.0
    assert motions[102].acceleration == pytest.approx(5.0, rel=0.01)
    assert 0.5 < motions[200].acceleration < 5.0
    assert motions[-1].acceleration < 0.1


def test_after_a_long_silence_nothing_is_known_and_never_by_times_that_go_back() -> None:
    memory = MotionMemory()
    assert learned([1.0] * 60, memory)[-1].acceleration is not None
    assert learned([1.0], memory, first=1000)[0].acceleration is None
    assert learned([1.0] * 60, memory, first=1001)[-1].acceleration is not None
    assert learned([1.0], memory, first=500)[0].acceleration is None


def test_outliers_that_set_the_middle_back_forget_nothing() -> None:
    memory = MotionMemory()
    learned([0.0] * 40 + [5.0] * 40, memory)
    set_back = memory.add(78 * PERIOD_NS, 91 * PERIOD_NS, SPAN_S, window(5.0))["x_mm"]
    assert set_back.acceleration > 0.5


def test_a_change_over_a_gap_may_have_come_within_two_windows() -> None:
    memory = MotionMemory()
    learned([0.0], memory)
    assert learned([5.0], memory, first=100)[0].acceleration == pytest.approx(5.0 / 1.9, rel=0.01)


def test_at_rest_it_is_hardly_larger_than_sigma() -> None:
    last = machine(1, 0.0, vibrates=False).measured(range(200), Measuring())[-1]
    for key in KEYS:
        sigma, now = last.sigma(key), last.sigma_at(key, 1.5)
        assert sigma < now < 1.5 * sigma


def test_rates_are_those_of_the_beam_with_the_signs_of_its_installation() -> None:
    moving = machine(3, 5.0, vibrates=False)
    signs = Installation.model_validate({"sign_x": -1, "sign_pitch": -1, "offset_yaw_deg": 3.0})
    last = moving.measured(range(40), Measuring(), signs)[-1]
    step_ns = 1_000_000
    truth = (moving.truth(last.t_ns + step_ns) - moving.truth(last.t_ns - step_ns)) / (2 * step_ns * 1e-9)
    for key, sign, rate in zip(KEYS, (-1, 1, 1, -1), truth, strict=True):
        found = last.rates[key]
        assert found.value == pytest.approx(sign * rate, abs=4 * found.sigma + 0.02 * abs(rate))
        assert found.sigma < 0.05


@pytest.mark.parametrize("window", [1, 3])
def test_where_too_few_exposures_are_averaged_it_is_not_known(window: int) -> None:
    last = machine(1, 2.0, vibrates=False).measured(range(60), Measuring(window=window))[-1]
    assert last.valid
    assert last.rates == {}
    assert [last.sigma_at(key, 0.1) for key in KEYS] == [None] * 4


def test_it_is_not_known_before_the_motion_was_seen_to_last() -> None:
    measurements = machine(1, 2.0, vibrates=False).measured(range(60), Measuring())
    known = [m.sigma_at("x_mm", 0.5) is not None for m in measurements if m.valid]
    assert known.index(True) in range(20, 30)
    assert all(known[known.index(True) :])


def test_every_quantity_with_a_sigma_has_one_of_now_and_no_other() -> None:
    last = machine(1, 0.0, vibrates=False).measured(range(60), Measuring())[-1]
    with_sigma = {key for key, value in last.values.items() if value.sigma is not None}
    assert with_sigma == {each.key for each in last.quantities.of_unit if each.has_sigma} - {"roll_deg"}
    assert {key for key in last.values if last.sigma_at(key, 0.5) is not None} == with_sigma
    assert last.sigma_at("yaw_mm_per_m", 0.5) is last.sigma_at("roll_deg", 0.5) is None
