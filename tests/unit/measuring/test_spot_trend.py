"""The light of a spot is that which fell, whatever exposure and gain; trends are medians of minutes."""

from __future__ import annotations

import math
import pickle

import numpy as np
import pytest

from altd.measuring.spot_trend import (
    BUCKET_NS,
    RECENT_BUCKETS,
    REFERENCE_BUCKETS,
    Trend,
    residual_share,
)
from altd.records import Frame, Spot
from altd.vision.localise import locate

SECOND = 10**9


def frame_with(
    light: float, radius_px: float, exposure_ms: float | None, gain_db: float | None, bits: int = 8
) -> Frame:
    """A Gaussian spot of that light (counts · px² / ms at 0 dB) and 1/e² radius, with noise of one count."""
    v, u = np.mgrid[0:200, 0:240]
    peak = light * (exposure_ms or 1.0) * 10 ** ((gain_db or 0.0) / 20) / (math.pi * radius_px**2 / 2)
    spot = peak * np.exp(-2 * ((u - 120.3) ** 2 + (v - 99.6) ** 2) / radius_px**2)
    noisy = spot + np.random.default_rng(7).normal(10.0, 1.0, spot.shape)
    full = (1 << bits) - 1
    kind = np.uint8 if bits == 8 else np.uint16
    return Frame("front", 1, 0, noisy.round().clip(0, full).astype(kind), bits, False, exposure_ms, gain_db)


def light_of(frame: Frame) -> float | None:
    spot = locate(frame)
    assert isinstance(spot, Spot), spot
    return spot.light_per_ms


@pytest.mark.parametrize(
    ("radius_px", "exposure_ms", "gain_db"),
    [
        (14.0, 1.0, 0.0),
        (14.0, 2.0, 0.0),
        (14.0, 0.5, 0.0),
        (14.0, 0.5, 6.0206),
        (10.0, 0.6, None),
        (25.0, 4.0, 0.0),
    ],
)
def test_light_is_that_which_fell(radius_px: float, exposure_ms: float, gain_db: float | None) -> None:
    light = 30_000.0
    assert light_of(frame_with(light, radius_px, exposure_ms, gain_db)) == pytest.approx(light, rel=0.06)


def test_half_the_laser_is_half_the_light_though_auto_exposure_hides_it() -> None:
    whole, half = frame_with(40_000, 14.0, 1.0, 0.0), frame_with(20_000, 14.0, 2.0, 0.0)
    assert whole.pixels.max() == pytest.approx(int(half.pixels.max()), abs=3)
    bright, dim = light_of(whole), light_of(half)
    assert bright is not None
    assert dim is not None
    assert dim / bright == pytest.approx(0.5, rel=0.02)


def test_light_is_not_known_without_the_exposure() -> None:
    assert light_of(frame_with(30_000, 14.0, None, None)) is None


def test_residuals_are_a_share_of_what_makes_a_spot_distorted() -> None:
    # 0.015 diameters of displacement by unexplained light: docs/calibration.md
    assert residual_share(Spot(0.0, 0.0, 0.01, 40.0, 100.0, excess_px=0.3)) == pytest.approx(0.5)


def fed(trend: Trend, minutes: int, value: float, begin_minute: int = 0, per_s: int = 20) -> int:
    """Samples of so many minutes; returns the minute that follows."""
    period_ns = SECOND // per_s
    for number in range(minutes * 60 * per_s):
        trend.add(begin_minute * BUCKET_NS + number * period_ns, value)
    return begin_minute + minutes


def test_a_trend_knows_its_reference_after_half_an_hour_and_what_is_now_after_ten_minutes() -> None:
    trend = Trend()
    minute = fed(trend, RECENT_BUCKETS, 5.0)
    assert trend.figures.recent is None  # the tenth minute is not over
    minute = fed(trend, REFERENCE_BUCKETS - RECENT_BUCKETS, 5.0, minute)
    assert (trend.figures.recent, trend.figures.reference) == (5.0, None)
    minute = fed(trend, 11, 3.0, minute)
    assert trend.figures.reference == 5.0
    assert trend.figures.share == pytest.approx(0.6)


def test_outliers_do_not_count() -> None:
    trend = Trend()
    minute = fed(trend, 31, 5.0)
    for number in range(60 * 15):
        trend.add(minute * BUCKET_NS + number * SECOND, 5.0 if number % 3 else 0.1)
    assert trend.figures.share == pytest.approx(1.0)


def test_what_is_not_a_number_and_minutes_with_few_spots_count_for_nothing() -> None:
    trend = Trend()
    minute = fed(trend, 31, 5.0)
    for _ in range(30):
        minute += 1
        for second in range(19):
            trend.add(minute * BUCKET_NS + second * SECOND, 0.1)
        trend.add(minute * BUCKET_NS + 30 * SECOND, math.nan)
    assert trend.figures.share == pytest.approx(1.0)


def test_a_reference_that_is_given_is_kept() -> None:
    trend = Trend(reference=10.0)
    fed(trend, 40, 5.0)
    assert trend.figures.share == pytest.approx(0.5)


def test_memory_is_bounded() -> None:
    trend = Trend()
    minute = fed(trend, 40, 5.0, per_s=2)
    before = len(pickle.dumps(trend))
    fed(trend, 2000, 5.0, minute, per_s=1)
    assert len(pickle.dumps(trend)) < 1.2 * before
