"""Light of a spot is that which fell, whatever exposure and gain; trends; changes on one target."""

import math
import pickle
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from altd.measuring.light_balance import LightBalance
from altd.measuring.spot_trend import (
    BUCKET_NS,
    RECENT_BUCKETS,
    REFERENCE_BUCKETS,
    MedianTrend,
    SuddenResidual,
    residual_share,
)
from altd.records import FloatArray, Frame, MeanSpots, Spot, SpotShape
from altd.vision.localise import MIN_DISTORTION_DIAMETERS, locate
from altd.vision.settings import LightReference

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
    assert dim / bright == pytest.approx(0.5, rel=0.02)


def test_light_is_not_known_without_the_exposure() -> None:
    assert light_of(frame_with(30_000, 14.0, None, None)) is None


def test_residuals_are_a_share_of_what_makes_a_spot_distorted() -> None:
    # 0.015 diameters of displacement by unexplained light: docs/calibration.md
    assert residual_share(Spot(0.0, 0.0, 0.01, 40.0, 100.0, excess_px=0.3)) == pytest.approx(0.5)


def fed(trend: MedianTrend, minutes: int, value: float, begin_minute: int = 0, per_s: int = 20) -> int:
    """Samples of so many minutes; returns the minute that follows."""
    period_ns = SECOND // per_s
    for number in range(minutes * 60 * per_s):
        trend.add(begin_minute * BUCKET_NS + number * period_ns, value)
    return begin_minute + minutes


def test_a_trend_knows_its_reference_after_half_an_hour_and_what_is_now_after_ten_minutes() -> None:
    trend = MedianTrend()
    minute = fed(trend, RECENT_BUCKETS, 5.0)
    assert trend.figures.recent is None  # the tenth minute is not over
    minute = fed(trend, REFERENCE_BUCKETS - RECENT_BUCKETS, 5.0, minute)
    assert (trend.figures.recent, trend.figures.reference) == (5.0, None)
    minute = fed(trend, 11, 3.0, minute)
    assert trend.figures.reference == 5.0
    assert trend.figures.share == pytest.approx(0.6)


def test_outliers_do_not_count() -> None:
    trend = MedianTrend()
    minute = fed(trend, 31, 5.0)
    for number in range(60 * 15):
        trend.add(minute * BUCKET_NS + number * SECOND, 5.0 if number % 3 else 0.1)
    assert trend.figures.share == pytest.approx(1.0)


def test_what_is_not_a_number_and_minutes_with_few_spots_count_for_nothing() -> None:
    trend = MedianTrend()
    minute = fed(trend, 31, 5.0)
    for _ in range(30):
        minute += 1
        for second in range(19):
            trend.add(minute * BUCKET_NS + second * SECOND, 0.1)
        trend.add(minute * BUCKET_NS + 30 * SECOND, math.nan)
    assert trend.figures.share == pytest.approx(1.0)


def test_a_reference_that_is_given_is_kept() -> None:
    trend = MedianTrend(reference=10.0)
    fed(trend, 40, 5.0)
    assert trend.figures.share == pytest.approx(0.5)


def test_memory_is_bounded() -> None:
    trend = MedianTrend()
    minute = fed(trend, 40, 5.0, per_s=2)
    before = len(pickle.dumps(trend))
    fed(trend, 2000, 5.0, minute, per_s=1)
    assert len(pickle.dumps(trend)) < 1.2 * before


RADIUS_PX = 20.0
ROUND = SpotShape(4 / RADIUS_PX**2, 0.0, 4 / RADIUS_PX**2, 1.0)
FRAMES = 20
RANDOM = np.random.default_rng(27)


@pytest.fixture(autouse=True)
def same_noise() -> None:
    """Each test draws the same numbers, whichever ran before it in its process."""
    RANDOM.bit_generator.state = np.random.default_rng(27).bit_generator.state


def mean(
    t_s: float,
    front: FloatArray | float = 1000.0,
    rear: FloatArray | float = 800.0,
    at_radii: tuple[float, float] = (0.0, 0.0),
    noise: float = 0.005,
) -> MeanSpots:
    """A window of exposures whose spots have that light, ``noise`` of it too."""
    lights = np.stack(np.broadcast_arrays(front, rear, np.ones(FRAMES))[:2], axis=1)
    logs = np.log(lights) + RANDOM.normal(0.0, noise, lights.shape)
    px = np.full((2, 2), 300.0) + RADIUS_PX * np.array(at_radii)
    return MeanSpots(
        ("front", "rear"),
        px,
        np.eye(4),
        round(t_s * SECOND),
        FRAMES,
        0,
        shapes=(ROUND, ROUND),
        log_lights=np.stack([logs, np.full_like(logs, noise)], axis=2),
    )


def after(balance: LightBalance, *means: MeanSpots, is_valid: bool = True) -> float:
    """The change of the rear target after these windows."""
    changed: tuple[float, ...] = ()
    for each in means:
        changed = balance.changed_light(each)
        if is_valid:
            balance.update(replace(each, changed_light=changed))
    assert changed[0] == 0.0
    return changed[1]


@pytest.mark.parametrize(
    ("times_s", "of"),
    [
        (
            range(100),
            lambda t_s: {"front": 1000.0, "rear": 800.0} if t_s < 50 else {"front": 100.0, "rear": 80.0},
        ),
        # a lens that darkens towards the edge, while the machine drives by 0.4 radii a second
        (
            np.arange(0.0, 60.0, 0.5),
            lambda t_s: {"rear": 800.0 * math.exp(-0.006 * t_s), "at_radii": (0.4 * t_s, 0.0)},
        ),
        (range(0, 3600 * 24 * 14, 3600), lambda t_s: {"rear": 800.0 * math.exp(-0.001 * t_s / 3600)}),
        (range(200), lambda _: {"noise": 0.2}),
    ],
    ids=["on both targets alike", "by the lens", "dust of weeks", "noise of dim spots"],
)
def test_what_is_no_change(times_s: Iterable[float], of: Callable[[float], dict[str, Any]]) -> None:
    balance = LightBalance()
    assert {after(balance, mean(t_s, **of(t_s))) for t_s in times_s} == {0.0}


@pytest.mark.parametrize("share", [2.0, 1.4, 0.7])
@pytest.mark.parametrize("target", ["front", "rear"])
def test_light_that_is_added_or_lost_on_one_target_is_seen(target: str, share: float) -> None:
    front, rear = (share * 1000.0, 800.0) if target == "front" else (1000.0, share * 800.0)
    changed = after(LightBalance(), mean(0.0), mean(1.0, front, rear))
    assert changed == pytest.approx(math.expm1(abs(math.log(share))), rel=0.15)


@pytest.mark.parametrize("frames", [1, 4, 16])
def test_the_disturbed_part_of_a_window_counts_from_its_first_exposure_to_its_last(frames: int) -> None:
    """The mean spot is displaced by that part too."""
    share = 0.4 * frames / FRAMES
    disturbed = np.where(np.arange(FRAMES) >= FRAMES - frames, 1.4 * 800.0, 800.0)
    for rear in (disturbed, disturbed[::-1]):
        changed = after(LightBalance(), mean(0.0), mean(0.5, rear=rear))
        assert 0.6 * share < changed < 1.1 * share


def test_a_second_light_that_stays_is_not_forgotten_within_ten_minutes_though_the_spots_vibrate() -> None:
    balance = LightBalance()
    after(balance, mean(0.0))
    for t_s in np.arange(1.0, 600.0):
        changed = after(balance, mean(t_s, rear=1000.0, at_radii=(0.2 * math.sin(t_s), 0.2 * math.cos(t_s))))
        assert changed > 0.18
    assert after(balance, mean(600.0)) < 0.04


FALL_OFF = (0.0, 0.3, 0.0, -0.8, 0.0, -0.5)


def calibrated_light() -> list[LightReference]:
    """Of targets whose lenses darken towards the edge."""
    return [LightReference((math.log(light), *FALL_OFF[1:]), 0.006) for light in (1000.0, 800.0)]


def fallen_off(at_radii: float) -> float:
    px = np.array([300.0 + RADIUS_PX * at_radii, 300.0])
    return math.exp(float(LightReference.powers(px) @ FALL_OFF))


@pytest.mark.parametrize("loss", [0.03, 0.1])
def test_a_film_that_was_there_from_the_start_is_seen_against_the_calibration(loss: float) -> None:
    light = fallen_off(0.0)
    balance = LightBalance(calibrated_light())
    assert after(balance, mean(0.0, 1000.0 * light, 800.0 * light)) == 0.0
    for seconds in (1.0, 60.0):  # and it is not forgotten
        film = mean(seconds, 1000.0 * light * (1 - loss), 800.0 * light)
        assert after(balance, film) == pytest.approx(loss, rel=0.4)
    assert after(LightBalance(calibrated_light()), film) == pytest.approx(loss, rel=0.4)


def test_a_film_that_the_beam_drives_behind_is_seen_and_the_lens_is_not() -> None:
    balance = LightBalance(calibrated_light())
    for at in np.arange(0.0, 8.0, 0.2):  # radii
        front, rear = 1000.0 * fallen_off(at), 800.0 * fallen_off(at)
        film = 0.95 if at > 6 else 1.0
        changed = after(balance, mean(at, front * film, rear, at_radii=(at, 0.0)))
        assert changed > 0.02 if film < 1 else changed == 0.0, at


def test_one_target_without_calibrated_light_leaves_the_start_unknown() -> None:
    assert after(LightBalance([*calibrated_light()[:1], None]), mean(0.0, 100.0)) == 0.0


def test_nothing_is_known_without_the_light_and_it_is_followed_again_when_it_comes_back() -> None:
    balance = LightBalance()
    after(balance, mean(0.0))
    assert balance.changed_light(mean(1.0, rear=math.nan)) == ()
    assert after(balance, mean(2.0, rear=1100.0)) > 0.3


def test_a_lamp_in_place_of_the_beam_changes_no_reference_and_the_beam_is_known_again() -> None:
    balance = LightBalance()
    after(balance, mean(0.0))
    for t_s in range(1, 600):
        assert after(balance, mean(t_s, front=20.0, at_radii=(9.0, 0.0)), is_valid=False) > 5.0
    assert after(balance, mean(600.0)) == 0.0


def test_a_change_that_stays_is_usual_after_hours_without_a_valid_measurement() -> None:
    """After a window was cleaned, for example."""
    balance = LightBalance()
    after(balance, mean(0.0))
    hours = [after(balance, mean(3600.0 * hour, rear=1200.0), is_valid=False) for hour in (0.1, 1, 2, 3)]
    assert hours[0] > 0.4
    assert hours == sorted(hours, reverse=True)
    assert hours[-1] == 0.0


def test_single_exposures_of_unknown_light_do_not_hide_a_change() -> None:
    rear = np.where(np.arange(FRAMES) % 3 == 0, np.nan, 1100.0)
    assert after(LightBalance(), mean(0.0), mean(1.0, rear=rear)) > 0.3


def test_a_window_whose_middle_is_set_back_by_outliers_is_compared_and_teaches_nothing() -> None:
    balance = LightBalance()
    after(balance, mean(100.0))
    for t_s in (99.6, 99.7, 99.5):
        assert after(balance, mean(t_s, rear=1100.0)) > 0.3


def test_a_recording_that_begins_again_has_another_reference() -> None:
    assert after(LightBalance(), mean(100.0), mean(0.0, rear=1100.0)) == 0.0


def rejected(shares: FloatArray, px_per_exposure: float = 0.5) -> list[bool]:
    """Which exposures are rejected, for residuals as shares of the limit, of a beam that drives."""
    sudden, diameter_px = SuddenResidual(), 40.0
    limit_px = MIN_DISTORTION_DIAMETERS * diameter_px
    return [
        not isinstance(
            sudden.checked(
                Spot(300.0 + px_per_exposure * number, 200.0, 0.02, diameter_px, 150.0, share * limit_px)
            ),
            Spot,
        )
        for number, share in enumerate(shares)
    ]


def test_a_residual_that_grows_from_one_exposure_to_the_next_is_rejected_until_it_is_gone() -> None:
    noise = np.random.default_rng(5).uniform(0.0, 0.1, 60)
    shares = noise + np.where((np.arange(60) >= 20) & (np.arange(60) < 40), 0.6, 0.0)
    is_rejected = rejected(shares)
    assert is_rejected == [23 <= number < 43 for number in range(60)]


@pytest.mark.parametrize(
    "shares",
    [
        np.linspace(0.0, 0.9, 60),
        np.where(np.arange(60) < 30, 0.1, 0.4),
        np.random.default_rng(6).uniform(0.0, 1.0, 2000),
        np.where(np.arange(60) == 30, 0.8, 0.0),
    ],
    ids=["dust that the beam reaches", "dust of a dusty unit", "turbulent air", "one exposure"],
)
def test_a_residual_that_grows_otherwise_is_not_rejected(shares: FloatArray) -> None:
    assert not any(rejected(shares))


def test_other_dust_after_a_jump_of_the_beam_is_not_rejected() -> None:
    assert not any(rejected(np.where(np.arange(60) < 30, 0.0, 0.6), px_per_exposure=3.0))
