"""The rule as tables, and what it looks at; the closed loop is in test_exposure_loop.py."""

import numpy as np
import pytest
from support.frames import Blob, frame, light

from altd.acquisition.auto_exposure.rule import (
    HIGH,
    LOW,
    TARGET,
    BrightnessSample,
    Content,
    ExposureRule,
    Setting,
    limits_of,
    sample_brightness,
    setting_for,
)
from altd.config import ExposureSettings
from altd.ports import ExposureRange
from altd.reasons import Reason
from altd.records import Frame, NoSpot, Spot

LIMITS = ExposureRange(0.02, 20.0, 0.0, 12.0)
WINDOW = 20
HERE = Setting(2.0, 0.0)
OVEREXPOSED = BrightnessSample(Content.OVEREXPOSED, 1.0)
BRIGHTEST = setting_for(1000.0, LIMITS)


def spot(level: float) -> BrightnessSample:
    return BrightnessSample(Content.SPOT, level)


def nothing(level: float) -> BrightnessSample:
    return BrightnessSample(Content.NOTHING, level)


def rule(limits: ExposureRange = LIMITS) -> ExposureRule:
    return ExposureRule(limits, WINDOW)


def settled(present: Setting = HERE) -> ExposureRule:
    one = rule()
    assert one.next(spot(TARGET), present) is None
    return one


def asked(
    one: ExposureRule, sample: BrightnessSample, present: Setting = HERE, limit: int = 200
) -> tuple[int, Setting]:
    """After how many such frames another setting is asked for, and which."""
    for count in range(1, limit + 1):
        if (setting := one.next(sample, present)) is not None:
            return count, setting
    raise AssertionError("no picture was requested")


@pytest.mark.parametrize(
    ("light_ms", "setting"),
    [
        (0.001, Setting(0.02, 0.0)),
        (5.0, Setting(5.0, 0.0)),
        (20.0, Setting(20.0, 0.0)),
        (40.0, Setting(20.0, 6.0206)),
        (1000.0, Setting(20.0, 12.0)),
    ],
)
def test_exposure_comes_first_and_gain_only_where_it_does_not_do(light_ms: float, setting: Setting) -> None:
    found = setting_for(light_ms, LIMITS)
    assert (found.exposure_ms, found.gain_db) == pytest.approx(
        (setting.exposure_ms, setting.gain_db), abs=1e-4
    )


def test_the_limits_are_those_of_config_camera_and_frame_rate_together() -> None:
    control = ExposureSettings(shortest_ms=0.1, longest_ms=30.0, largest_gain_db=12.0)
    wide, narrow = ExposureRange(0.01, 900.0, 0.0, 48.0), ExposureRange(0.5, 8.0, 2.0, 6.0)
    assert limits_of(control, wide, fps=20.0) == ExposureRange(0.1, 30.0, 0.0, 12.0)
    assert limits_of(control, narrow, fps=20.0) == ExposureRange(0.5, 8.0, 2.0, 6.0)
    assert limits_of(control, wide, fps=50.0).longest_ms == pytest.approx(18.0)


@pytest.mark.parametrize("level", [LOW, 0.5, HIGH])
def test_in_the_band_nothing_is_asked_for(level: float) -> None:
    one = settled()
    assert all(one.next(spot(level), HERE) is None for _ in range(500))


@pytest.mark.parametrize("level", [0.05, 0.2, 0.34, 0.81, 0.95])
def test_out_of_the_band_for_a_whole_window_it_goes_to_the_middle(level: float) -> None:
    count, setting = asked(settled(), spot(level))
    assert count == WINDOW
    assert setting.light * level / HERE.light == pytest.approx(TARGET)


def test_a_clipped_spot_comes_into_the_band_whatever_was_clipped() -> None:
    _, setting = asked(settled(), spot(1.0))
    for overexposed in (1.0, 2.0):
        assert LOW <= overexposed * setting.light / HERE.light <= HIGH


@pytest.mark.parametrize(
    "samples",
    [
        ([spot(0.9)] * (WINDOW - 1) + [spot(0.79)]) * 20,
        ([spot(0.9)] * (WINDOW - 1) + [spot(0.2)] * (WINDOW - 1)) * 10,
        [OVEREXPOSED] * 2 + [spot(TARGET)] * 5,
    ],
    ids=["one exposure back in the band", "now too bright and now too dark", "a flash"],
)
def test_what_does_not_last_changes_nothing(samples: list[BrightnessSample]) -> None:
    one = settled()
    assert all(one.next(sample, HERE) is None for sample in samples)


@pytest.mark.parametrize("sample", [spot(0.1), spot(1.0), OVEREXPOSED])
def test_until_the_level_was_in_the_band_three_exposures_do(sample: BrightnessSample) -> None:
    assert asked(rule(), sample)[0] == 3


def test_a_spot_that_saturates_is_not_waited_for() -> None:
    count, setting = asked(settled(), OVEREXPOSED)
    assert count == 3
    assert setting.light == pytest.approx(HERE.light / 4)


def test_a_spot_that_went_out_is_waited_for_and_then_looked_for_upwards_to_the_end() -> None:
    one, present, steps = settled(), HERE, []
    for _ in range(400):
        if (setting := one.next(nothing(0.02), present)) is not None:
            steps.append(setting)
            present = setting
    assert asked(settled(), nothing(0.02))[0] == 2 * WINDOW
    assert [step.light for step in steps] == pytest.approx([8.0, 32.0, BRIGHTEST.light])
    assert steps[-1] == BRIGHTEST


def test_a_search_ends_where_the_spot_was_good() -> None:
    one, present = settled(), HERE
    while (setting := one.next(nothing(0.02), present)) != setting_for(1000.0, LIMITS):
        present = setting or present
    count, setting = asked(one, OVEREXPOSED, BRIGHTEST)
    assert count == 3
    assert setting == HERE


def test_a_search_floods_no_frame() -> None:
    """Background that makes 0.03 of full scale at 2 ms."""
    one, present = rule(), HERE
    for _ in range(300):
        level = 0.03 * present.light / HERE.light
        assert level <= 0.5 + 1e-9
        present = one.next(nothing(level), present) or present
    assert 0.03 * present.light / HERE.light > 0.45


@pytest.mark.parametrize(
    ("sample", "end"),
    [
        (OVEREXPOSED, 0.0),
        (spot(1.0), 0.0),
        (nothing(0.0), 1e9),
        (spot(0.05), 1e9),
        (BrightnessSample(Content.OTHER, 0.2), HERE.light),
    ],
)
def test_at_the_end_of_its_range_or_where_it_mends_nothing_it_rests(
    sample: BrightnessSample, end: float
) -> None:
    present = setting_for(max(end, 1e-9), LIMITS)
    one = rule()
    assert all(one.next(sample, present) is None for _ in range(500))


SPOT = Blob(300, 200, peak=150.0)


@pytest.mark.parametrize(("bits", "scale"), [(8, 1.0), (10, 4.01), (12, 16.06), (16, 257.0)])
def test_the_level_is_that_of_the_peak_with_the_background_whatever_the_depth(
    bits: int, scale: float
) -> None:
    taken = frame(light(SPOT) * scale, background=8.0 * scale, bits=bits)
    sample = sample_brightness(taken, Spot(300, 200, 0.01, 44.0, 150.0 * scale))
    assert sample.content is Content.SPOT
    assert sample.level == pytest.approx(158 / 255, rel=0.03)


def test_hot_pixels_do_not_raise_the_level() -> None:
    taken = frame(light(SPOT))
    pixels = taken.pixels.copy()
    pixels[195:205:3, 300] = 255
    assert sample_brightness(Frame("front", 0, 0, pixels), Spot(300, 200, 0.01, 44.0, 150.0)).level < 0.65


def test_at_the_edge_of_the_picture_there_is_a_level_too() -> None:
    taken = frame(light(Blob(2, 1, peak=150.0)))
    assert sample_brightness(taken, Spot(2, 1, 0.01, 44.0, 150.0)).level == pytest.approx(158 / 255, rel=0.05)


def flooded() -> Frame:
    return Frame("front", 0, 0, np.full((480, 752), 255, np.uint8))


@pytest.mark.parametrize(
    ("taken", "why", "content"),
    [
        (frame(light(Blob(300, 200, peak=5000.0))), Reason.SATURATED, Content.OVEREXPOSED),
        (frame(light(Blob(300, 200, peak=5000.0))), Reason.AMBIGUOUS, Content.OVEREXPOSED),
        (flooded(), Reason.SPOT_MISSING, Content.OVEREXPOSED),
        (frame(light(SPOT)), Reason.AMBIGUOUS, Content.OTHER),
        (frame(light(SPOT)), Reason.CUT_BY_EDGE, Content.OTHER),
        (frame(light()), Reason.SPOT_MISSING, Content.NOTHING),
    ],
)
def test_what_a_frame_without_a_spot_shows(taken: Frame, why: Reason, content: Content) -> None:
    assert sample_brightness(taken, NoSpot(why)).content is content


def test_hot_pixels_alone_are_not_over_exposed() -> None:
    pixels = frame(light()).pixels.copy()
    pixels[np.random.default_rng(1).integers(0, 480, 60), np.random.default_rng(2).integers(0, 752, 60)] = 255
    sample = sample_brightness(Frame("front", 0, 0, pixels), NoSpot(Reason.SPOT_MISSING))
    assert sample.content is Content.NOTHING
    assert sample.level < 0.1
