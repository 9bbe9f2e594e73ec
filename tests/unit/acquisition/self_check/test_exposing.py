"""The frames of a check, by cameras and LEDs on the test's clock, and whether the LEDs shone during each."""

import asyncio

import numpy as np
import pytest
from support.clock import FakeClock, settle
from support.frames import frame, light
from support.lit_cameras import CAMERAS, Leds, LitCameras, QuickLamps

from altd.acquisition.self_check.exposing import CheckExposer, CheckFailedError, CheckFrames
from altd.acquisition.self_check.frames import LedLog, Light, MarkedFrames
from altd.records import Frame

EXPOSURES = 3


class Bench:
    def __init__(self) -> None:
        self.clock = FakeClock.of_loop()
        self.leds = Leds()
        self.cameras = LitCameras(self.clock, self.leds)
        log = LedLog(self.clock, dict.fromkeys(CAMERAS, 50_000_000))
        self.frames = MarkedFrames(log, CAMERAS)
        self.lamps = QuickLamps(self.leds, self.clock)
        self.exposer = CheckExposer(self.lamps, log, self.frames, self.clock, EXPOSURES, 1e4)
        self.task: asyncio.Task[CheckFrames] = asyncio.create_task(self.exposer.expose())

    async def expose(self, count: int) -> None:
        await settle()
        await self.cameras.expose(self.frames, count)


async def test_a_check_has_frames_of_each_light_and_ends_dark() -> None:
    bench = Bench()
    await bench.expose(20)
    found = await bench.task
    for seen, frames in (("dark", found.before), ("lit", found.lit), ("dark", found.after)):
        assert {camera: len(of) for camera, of in frames.items()} == dict.fromkeys(CAMERAS, EXPOSURES)
        wanted = 200 if seen == "lit" else 0
        assert all(int(frame.pixels.max()) == wanted for of in frames.values() for frame in of)
    assert bench.leds.switched == [True, False]


async def test_every_frame_is_handed_on_and_those_under_leds_are_marked() -> None:
    bench = Bench()
    await bench.expose(20)
    await bench.task
    assert len(bench.cameras.marked) == 40
    assert all(frame.leds_on for frame in bench.cameras.marked if np.any(frame.pixels))
    assert not any(frame.leds_on for frame in (*bench.cameras.marked[:4], bench.cameras.marked[-1]))
    marked = [frame for frame in bench.cameras.marked if frame.leds_on]
    lost = {camera: sum(frame.camera == camera for frame in marked) for camera in CAMERAS}
    assert lost["front"] == lost["rear"] <= EXPOSURES + 2
    counted = bench.frames.marked
    assert lost["front"] == counted[Light.ON]["front"] + counted[Light.SWITCHED]["front"]


async def test_exposures_during_a_change_are_not_taken() -> None:
    bench = Bench()
    bench.cameras.changing = {1, 5, 6, 12}
    await bench.expose(24)
    found = await bench.task
    frames = [f for of in (found.before, found.lit, found.after) for each in of.values() for f in each]
    assert not any(frame.changing for frame in frames)


@pytest.mark.parametrize("exposures_before", [2, 5, 8], ids=["before the LEDs", "under them", "after them"])
async def test_a_check_starts_over_when_the_exposure_is_set_meanwhile(exposures_before: int) -> None:
    bench = Bench()
    await bench.expose(exposures_before)
    bench.cameras.exposure_ms = 1.4
    await bench.expose(30)
    found = await bench.task
    frames = [f for of in (found.before, found.lit, found.after) for each in of.values() for f in each]
    assert {frame.exposure_ms for frame in frames} == {1.4}
    assert bench.leds.switched == [True, False] * 2


async def test_a_camera_that_falls_silent_under_leds_ends_the_check_and_the_light() -> None:
    bench = Bench()
    await bench.expose(5)
    assert bench.leds.lit
    bench.cameras.silent = {"rear"}
    await bench.expose(6)
    await bench.clock.advance(2.0)
    with pytest.raises(
        CheckFailedError, match="not every camera had 3 steady exposures with the LEDs on"
    ) as e:
        await bench.task
    assert e.value.has_begun
    assert not bench.leds.lit


async def test_without_frames_the_leds_are_not_lit_at_all() -> None:
    bench = Bench()
    bench.cameras.silent = {"rear"}
    await bench.expose(5)
    await bench.clock.advance(2.0)
    with pytest.raises(CheckFailedError, match="off, before they were lit") as error:
        await bench.task
    assert not error.value.has_begun
    assert bench.leds.switched == []


async def test_leds_that_cannot_be_switched_are_named() -> None:
    bench = Bench()
    bench.leds.refuses = "GPIO chip 'unit': 'LED_A' taken by 'torch'"
    await bench.expose(6)
    with pytest.raises(CheckFailedError, match="could not be switched: GPIO chip 'unit': 'LED_A' taken by"):
        await bench.task
    await bench.expose(25)
    assert not bench.cameras.marked[-1].leds_on  # it measures on


async def test_leds_that_are_not_at_hand_are_named_and_take_no_exposure() -> None:
    bench = Bench()
    bench.lamps.lost = "GPIO chip 'unit' is gone; trying again"
    await bench.expose(6)
    with pytest.raises(CheckFailedError, match="could not be switched: GPIO chip 'unit' is gone"):
        await bench.task
    assert not any(frame.leds_on for frame in bench.cameras.marked)
    assert bench.leds.switched == []


async def test_a_daemon_that_ends_during_a_check_leaves_no_light() -> None:
    bench = Bench()
    await bench.expose(5)
    assert bench.leds.lit
    bench.task.cancel()
    await asyncio.gather(bench.task, return_exceptions=True)
    assert bench.task.cancelled()
    assert not bench.leds.lit


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
    ("exposure_ms", "off_ms", "switched_ms", "on_ms"),
    [
        # it ends 2 ms after its middle, and clocks may differ by 10 ms
        (4.0, (900, 987, 1315), (989, 1001, 1014, 1289, 1313), (1016, 1287)),
        # of an unknown one, from frame to frame
        (None, (939, 1363), (941, 1062), (1064,)),
        # one that outlasts the light
        (600.0, (), (1150,), ()),
    ],
)
def test_an_exposure_that_may_hold_the_edge_is_neither_on_nor_off(
    log: LedLog,
    exposure_ms: float | None,
    off_ms: tuple[int, ...],
    switched_ms: tuple[int, ...],
    on_ms: tuple[int, ...],
) -> None:
    for said, middles_ms in ((Light.OFF, off_ms), (Light.SWITCHED, switched_ms), (Light.ON, on_ms)):
        assert {log.of(shot(middle_ms, exposure_ms)) for middle_ms in middles_ms} <= {said}


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
