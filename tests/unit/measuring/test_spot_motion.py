"""Rates, vibration and onset of the spots of a window, by made-up paths with known motion."""

from __future__ import annotations

import numpy as np
import pytest

from altd.measuring.averaging import mean_spots
from altd.reasons import Reason
from altd.records import FrameSet, MeanSpots, NoSpot, Spot
from altd.records.spots import SpotMotion

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
        sets.append(
            FrameSet(
                number, number * PERIOD_NS, {"front": gone if number in missing else front, "rear": rear}
            )
        )
    mean = mean_spots(sets, TARGETS, len(sets))
    assert isinstance(mean, MeanSpots), mean
    return mean.motion


@pytest.mark.parametrize("missing", [(), (2, 3, 4, 9)])
def test_the_rate_has_the_covariance_of_monte_carlo(missing: tuple[int, ...]) -> None:
    rng = np.random.default_rng(1)
    rates, variances = [], []
    for _ in range(1000):
        motion = motion_of(300.0 + 0.15 * np.arange(20) + rng.normal(0, 0.1, 20), missing)
        assert motion is not None
        rates.append(motion.rate_px_per_s[0])
        variances.append(motion.rate_covariance[0, 0])
    assert np.mean(rates) == pytest.approx(3.0, abs=0.02)
    assert np.sqrt(np.mean(variances)) == pytest.approx(np.std(rates), rel=0.1)


def test_vibration_is_the_scatter_without_the_noise_of_the_spots() -> None:
    rng = np.random.default_rng(2)
    shake_px, found = 0.1, []
    for _ in range(400):
        motion = motion_of(300.0 + rng.normal(0, np.hypot(shake_px, NOISE_PX), 20))
        assert motion is not None
        found.append(np.diag(motion.vibration_px2))
    front_u, *others = np.mean(found, axis=0)
    assert front_u == pytest.approx(shake_px**2, rel=0.15)  # drawn a tenth towards the noise
    assert np.abs(others).max() < 0.1 * NOISE_PX**2


def test_a_sway_as_long_as_the_window_is_vibration() -> None:
    motion = motion_of(300.0 + 2.0 * np.sin(2 * np.pi * np.arange(20) / 20.0 + np.pi / 2))
    assert motion is not None
    assert abs(motion.rate_px_per_s[0]) < 0.1 * 2.0 * 2 * np.pi  # its highest speed
    assert np.sqrt(motion.vibration_px2[0, 0]) > 0.9 * 2.0 / np.sqrt(2.0)


@pytest.mark.parametrize("moved", [1, 3, 6])
def test_a_beam_that_begins_to_move_is_seen_by_its_first_exposure(moved: int) -> None:
    rng = np.random.default_rng(3)
    speed_px_per_s = 20.0
    way = np.concatenate([np.zeros(20 - moved), speed_px_per_s * 0.05 * np.arange(1, moved + 1)])
    motion = motion_of(300.0 + way + rng.normal(0, NOISE_PX, 20))
    assert motion is not None
    assert motion.onset_px_per_s[0] == pytest.approx(speed_px_per_s, rel=0.05)
    assert abs(motion.rate_px_per_s[0]) < 0.1  # the mean itself stands still


def test_an_outlier_that_is_not_the_newest_is_no_onset() -> None:
    path = np.full(20, 300.0)
    path[10] += 40.0
    motion = motion_of(path)
    assert motion is not None
    assert not motion.onset_px_per_s.any()


@pytest.mark.parametrize("count", [1, 2, 3])
def test_so_few_exposures_show_no_motion(count: int) -> None:
    assert motion_of(np.full(count, 300.0)) is None


def test_times_are_those_of_the_exposures_that_count() -> None:
    motion = motion_of(np.full(20, 300.0))
    assert motion is not None
    times_s = (np.arange(20) - 9.5) / 20.0
    assert motion.span_s == pytest.approx(0.95)
    assert motion.onset_s == pytest.approx(0.475)
    assert motion.spread_s2 == pytest.approx(np.mean(times_s**2))
