"""Whether the LEDs shone during an exposure, at times that the test lays side by side."""

from __future__ import annotations

import pytest
from support.clock import FakeClock
from support.frames import frame, light

from altd.acquisition.self_check.frames import LedLog, Light
from altd.records import Frame

MS = 1_000_000
PIXELS = frame(light()).pixels


def shot(middle_ms: float, exposure_ms: float | None = 4.0) -> Frame:
    return Frame("front", 1, round(middle_ms * MS), PIXELS, exposure_ms=exposure_ms)


@pytest.fixture
def log() -> LedLog:
    """On from 1000…1003 ms, off from 1300…1302 ms."""
    clock = FakeClock(1000 * MS)
    log = LedLog(clock, {"front": 50 * MS})
    log.begin(True)
    clock.now_ns = 1003 * MS
    log.done()
    clock.now_ns = 1300 * MS
    log.begin(False)
    clock.now_ns = 1302 * MS
    log.done()
    clock.now_ns = 2000 * MS
    return log


@pytest.mark.parametrize(
    ("middle_ms", "said"),
    [
        (900, Light.OFF),
        (987, Light.OFF),
        (989, Light.SWITCHED),  # it ends at 991 ms, and clocks may differ by 10 ms
        (1001, Light.SWITCHED),
        (1014, Light.SWITCHED),
        (1016, Light.ON),
        (1287, Light.ON),
        (1289, Light.SWITCHED),
        (1313, Light.SWITCHED),
        (1315, Light.OFF),
    ],
)
def test_an_exposure_that_may_hold_the_edge_is_neither_on_nor_off(
    log: LedLog, middle_ms: float, said: Light
) -> None:
    assert log.of(shot(middle_ms)) is said


@pytest.mark.parametrize(
    ("middle_ms", "said"),
    [(939, Light.OFF), (941, Light.SWITCHED), (1062, Light.SWITCHED), (1064, Light.ON), (1363, Light.OFF)],
)
def test_an_unknown_exposure_reaches_from_frame_to_frame(log: LedLog, middle_ms: float, said: Light) -> None:
    assert log.of(shot(middle_ms, None)) is said


def test_an_exposure_that_outlasts_the_light_is_not_dark(log: LedLog) -> None:
    assert log.of(shot(1150, 600.0)) is Light.SWITCHED


def test_while_the_leds_are_being_switched_nobody_knows() -> None:
    clock = FakeClock(1000 * MS)
    log = LedLog(clock, {"front": 50 * MS})
    log.begin(True)
    clock.now_ns = 1400 * MS
    assert log.of(shot(1390)) is Light.SWITCHED
    assert log.last_switched_ns == clock.now_ns


def test_leds_that_fail_are_taken_for_dark_after_a_second_and_not_before() -> None:
    clock = FakeClock(1000 * MS)
    log = LedLog(clock, {"front": 50 * MS})
    log.begin(True)
    clock.now_ns = 1400 * MS
    log.lost()
    assert log.of(shot(2380)) is Light.SWITCHED
    assert log.of(shot(2420)) is Light.OFF


def test_lit_leds_that_are_let_go_are_dark_after_a_second() -> None:
    clock = FakeClock(1000 * MS)
    log = LedLog(clock, {"front": 50 * MS})
    log.begin(True)
    log.done()
    clock.now_ns = 1400 * MS
    log.lost()
    assert [log.of(shot(t_ms)) for t_ms in (1300, 1395, 2380, 2420)] == [
        Light.ON,
        Light.SWITCHED,
        Light.SWITCHED,
        Light.OFF,
    ]


def test_a_check_that_is_long_past_is_remembered_by_nobody(log: LedLog) -> None:
    assert log.of(shot(60_000)) is Light.OFF
    assert LedLog(FakeClock(), {}).last_switched_ns is None
    assert log.last_switched_ns == 1302 * MS
