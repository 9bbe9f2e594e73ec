"""Predictions from windows of the past: at rest, on the way, starting, stopping."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable

import numpy as np
import pytest

from altd.measuring.motion_memory import MotionMemory
from altd.records.spots import Motion

PERIOD_NS = 50_000_000
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


def acceleration(motion: Motion) -> float:
    assert motion.acceleration is not None
    return motion.acceleration


def probable_rate(motion: Motion) -> float:
    assert motion.probable_rate is not None
    return motion.probable_rate


def test_how_a_rate_changes_is_known_when_two_windows_share_no_exposure() -> None:
    known = [motion.acceleration is not None for motion in learned([0.0] * 30)]
    assert known == [False] * 20 + [True] * 10


def test_at_rest_noise_of_the_rates_is_not_taken_for_motion() -> None:
    motions = learned(of_sliding_windows(lambda t_s: 0.0, 4000))[400:]
    assert math.sqrt(np.mean([probable_rate(motion) ** 2 for motion in motions])) < 0.8 * SIGMA_RATE
    assert math.sqrt(np.mean([acceleration(motion) ** 2 for motion in motions])) < 0.8 * SIGMA_RATE


def test_steady_motion_is_a_rate_and_no_acceleration() -> None:
    motions = learned(of_sliding_windows(lambda t_s: 5.0, 2000))[400:]
    squares = [probable_rate(motion) ** 2 for motion in motions]
    assert np.mean(squares) == pytest.approx(25.0, rel=0.01)
    assert max(map(acceleration, motions)) < 0.2


def test_a_rate_as_small_as_its_noise_is_not_understated() -> None:
    motions = learned(of_sliding_windows(lambda t_s: SIGMA_RATE, 4000))[400:]
    squares = [probable_rate(motion) ** 2 for motion in motions]
    assert SIGMA_RATE**2 < np.mean(squares) < 2.0 * SIGMA_RATE**2


def test_the_acceleration_of_a_path_is_not_understated() -> None:
    speed, period_s = 5.0, 23.0
    path = of_sliding_windows(lambda t_s: speed * math.sin(2 * math.pi * t_s / period_s), 3000)
    squares = [acceleration(motion) ** 2 for motion in learned(path)[600:]]
    assert 1.0 < np.mean(squares) / ((2 * math.pi * speed / period_s) ** 2 / 2) < 1.5


def test_the_first_change_of_the_rate_counts_at_once_and_is_forgotten_with_time() -> None:
    motions = learned([0.0] * 100 + [5.0] * 1200)
    assert acceleration(motions[99]) == 0.0
    assert acceleration(motions[102]) == pytest.approx(5.0, rel=0.01)
    assert 0.5 < acceleration(motions[200]) < 5.0
    assert acceleration(motions[-1]) < 0.1


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
    assert acceleration(set_back) > 0.5


def test_a_change_over_a_gap_may_have_come_within_two_windows() -> None:
    memory = MotionMemory()
    learned([0.0], memory)
    assert acceleration(learned([5.0], memory, first=100)[0]) == pytest.approx(5.0 / 1.9, rel=0.01)


def test_windows_that_show_no_motion_teach_nothing() -> None:
    assert MotionMemory().add(0, 0, 0.0, {}) == {}
