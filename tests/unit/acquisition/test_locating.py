"""The thread that locates spots: slow, hanging, broken, and its end."""

import asyncio
import logging
import re
import threading
import time
from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
import pytest
from support.clock import FakeClock, stop
from support.frames import Blob, frame, light
from support.located import SPOT, located

from altd.acquisition.acquiring import acquire
from altd.acquisition.auto_exposure.control import ExposureControl, ExposureFigures
from altd.acquisition.frame_pairs import MAX_BEHIND_NS, FramePairs
from altd.acquisition.locating import (
    MAX_WAITING_PAIRS,
    LocatedPairs,
    Locating,
    LocatingStalledError,
    locate_frame,
)
from altd.config import ExposureSettings
from altd.measuring.pairing import Pairer
from altd.measuring.spot_locator import Located
from altd.ports import CameraEndedError, CameraTimeoutError
from altd.records import Frame, Origin, PixelArray
from altd.status.health import Health
from altd.vision.localise import locate

PIXELS = frame(light(Blob(300, 200))).pixels
PERIOD_NS = 10_000_000
LONG_S = 60.0  # only a hang takes that long


def shot(sequence: int) -> Frame:
    return Frame("front", sequence, sequence, PIXELS)


class Locator:
    """Finds the same spot in every frame, after ``work`` was done on it."""

    camera = "front"

    def __init__(self, work: Callable[[Frame], object] = lambda frame: None) -> None:
        self.work = work
        self.begun = threading.Event()
        self.frames: list[Frame] = []

    def locate(self, frame: Frame) -> Located:
        self.frames.append(frame)
        self.begun.set()
        self.work(frame)
        return located("front", frame.sequence, frame.t_ns)


class Bench:
    """The thread between frames and loop, of one camera or of two."""

    def __init__(self, locator: Locator, rear: Locator | None = None) -> None:
        self.locator = locator
        self.locators = {"front": locator} | ({} if rear is None else {"rear": rear})
        locating = Locating(self.locators, {})  # type: ignore[arg-type]
        pairer: Pairer[Frame] = Pairer(tuple(self.locators), "sequence", 10_000_000, 30_000_000)
        self.pairs = FramePairs(pairer, locating.arrived, FakeClock())
        self.located = LocatedPairs(self.pairs)
        self.task = asyncio.create_task(locating.run(self.located))

    def put(self, number: int, pixels: PixelArray = PIXELS) -> None:
        for camera in self.locators:
            self.pairs.put(replace(shot(number), camera=camera, pixels=pixels), wait=False)

    async def take(self) -> list[int]:
        return [pair.sequence for pair in await self.located.take()]

    async def take_for_ever(self) -> None:
        while True:
            await self.take()

    async def begun(self) -> None:
        assert await asyncio.to_thread(self.locator.begun.wait, LONG_S)


async def test_what_is_located_in_the_thread_wakes_the_loop() -> None:
    bench = Bench(Locator(lambda frame: threads.add(threading.current_thread().name)))
    threads: set[str] = set()
    for number in range(3):
        bench.put(number)
        assert await bench.take() == [number]
    assert threads == {"locate"}
    await stop(bench.task)


def test_the_exposure_is_shown_what_was_found_and_nothing_of_a_frame_that_is_not_new() -> None:
    exposure = ExposureControl(ExposureSettings(), 20.0, 20)
    repeated = Locator()
    repeated.locate = lambda frame: replace(located("front", 1), found=None)  # type: ignore[method-assign]
    assert locate_frame(shot(1), repeated, exposure) is not None  # type: ignore[arg-type]
    assert exposure.figures is None
    assert locate_frame(shot(1), Locator(), exposure) is not None  # type: ignore[arg-type]
    level = round(float(np.quantile(PIXELS[190:211, 290:311], 0.98)) / 255, 2)
    assert exposure.figures == ExposureFigures(
        "auto, but this camera has no adjustable setting", pytest.approx(level, abs=0.01), None, None, 0
    )
    assert SPOT.diameter_px == 40.0  # a quarter of it is the half side of the square


class TickingCamera:
    """Exposes every 10 ms, and is asked for the next frame at once; ``expose`` resumes it."""

    name = "front"
    origin = Origin.CAMERA
    playback = False
    waits = False
    exposure_range = None
    identity = None

    def __init__(self, clock: FakeClock) -> None:
        self.clock = clock
        self.last = 0
        self.is_over = False
        self.allowed, self.asked = threading.Semaphore(0), threading.Semaphore(0)

    def open(self) -> None: ...

    def next_frame(self, timeout_s: float) -> Frame:
        self.asked.release()
        self.allowed.acquire()
        if self.is_over:
            self.allowed.release()
            raise CameraTimeoutError("no frame")
        self.last += 1
        self.clock.now_ns += PERIOD_NS
        return Frame("front", self.last, self.clock.now_ns, PIXELS)

    def expose(self, count: int) -> None:
        """So many frames, each of which waits to be located when this returns."""
        for _ in range(count):
            self.allowed.release()
            assert self.asked.acquire(timeout=LONG_S)

    def set_exposure(self, exposure_ms: float, gain_db: float) -> None: ...

    def close(self) -> None: ...


async def test_a_camera_located_slower_than_it_delivers_is_soon_measured_newest() -> None:
    """Locating takes five periods; that holds up neither the driver nor what comes after a second."""
    clock = FakeClock(PERIOD_NS)
    camera, ages, done = TickingCamera(clock), list[int](), threading.Event()

    def slowly(frame: Frame) -> None:
        if not ages:
            assert camera.asked.acquire(timeout=LONG_S)
        ages.append(camera.last - frame.sequence)
        if len(ages) < 40:
            camera.expose(5)
        else:
            done.set()

    bench = Bench(Locator(slowly))
    component = Health(clock).component("camera front")
    acquiring = asyncio.create_task(acquire(camera, bench.pairs, component))
    taking = asyncio.create_task(bench.take_for_ever())
    assert await asyncio.to_thread(camera.asked.acquire, timeout=LONG_S)
    camera.allowed.release()
    assert await asyncio.to_thread(done.wait, LONG_S)
    camera.is_over = True
    camera.allowed.release()
    await stop(bench.task)
    await stop(acquiring)
    await stop(taking)
    behind = MAX_BEHIND_NS // (5 * PERIOD_NS) + 1
    assert ages == [*range(0, 4 * behind, 4), *[0] * (40 - behind)]
    assert bench.pairs.dropped["front"] == bench.locator.frames[-1].sequence - 40
    assert "lost" not in component.counters


async def test_a_loop_that_is_held_up_finds_some_frame_sets_and_then_the_others() -> None:
    bench = Bench(Locator())
    bench.put(0)
    await bench.begun()
    for number in range(1, 3 * MAX_WAITING_PAIRS):
        bench.put(number)
        while len(bench.locator.frames) <= min(number, MAX_WAITING_PAIRS):
            time.sleep(0.001)  # noqa: ASYNC251  the loop is held up
    assert await bench.take() == list(range(MAX_WAITING_PAIRS))
    last = 3 * MAX_WAITING_PAIRS - 1
    taken: list[int] = []
    while last not in taken:
        taken += await bench.take()
    assert taken == list(range(MAX_WAITING_PAIRS, last + 1))
    await stop(bench.task)


LARGE = np.zeros((1024, 1024), np.uint8)


async def test_the_large_frames_of_a_set_are_located_side_by_side() -> None:
    """Each waits until the other is being located, too."""
    both = threading.Barrier(2)
    bench = Bench(*(Locator(lambda frame: both.wait(LONG_S)) for _ in range(2)))
    for number in range(3):
        bench.put(number, LARGE)
        (pair,) = await bench.located.take()
        assert pair.sequence == number
        assert set(pair.items) == {"front", "rear"}
    await stop(bench.task)


async def test_small_frames_are_located_one_after_the_other() -> None:
    threads: list[str] = []
    bench = Bench(*(Locator(lambda frame: threads.append(threading.current_thread().name)) for _ in range(2)))
    bench.put(1)
    (pair,) = await bench.located.take()
    assert set(pair.items) == {"front", "rear"}
    assert threads == ["locate", "locate"]
    await stop(bench.task)


@pytest.mark.parametrize("pixels", [PIXELS, LARGE])
async def test_a_defect_beside_is_raised_too(pixels: PixelArray) -> None:
    bench = Bench(Locator(), Locator(lambda frame: 1 / 0))
    bench.put(1, pixels)
    with pytest.raises(ZeroDivisionError):
        await bench.task


async def test_the_way_of_each_frame_is_logged_where_that_is_asked_for(
    caplog: pytest.LogCaptureFixture,
) -> None:
    with caplog.at_level(logging.DEBUG, "altd.frames"):
        bench = Bench(Locator())
        for number in range(3):
            bench.put(number)
        while 2 not in await bench.take():
            pass
        await stop(bench.task)
    lines = [re.sub(r"-?\d+\.\d+ ms", "T", line) for line in caplog.messages]
    expected = (f"exposure {n}: paired after T|frame {n} of front: located in T: {SPOT}" for n in range(3))
    assert sorted(lines) == sorted("|".join(expected).split("|"))


async def test_a_frame_that_is_never_done_is_a_defect() -> None:
    clock, may_end = FakeClock.of_loop(), threading.Event()
    bench = Bench(Locator(lambda frame: may_end.wait(LONG_S)))
    bench.put(7)
    await bench.begun()
    await clock.until(bench.task.done)
    with pytest.raises(LocatingStalledError, match=r"camera front: exposure 7 is not located within 5 s"):
        await bench.task
    clock.end()
    may_end.set()


async def test_a_process_that_was_stopped_meanwhile_has_not_located_longer() -> None:
    """Stopped as a whole, it finds an old frame in hand."""
    clock, may_end = FakeClock.of_loop(), threading.Event()
    bench = Bench(Locator(lambda frame: may_end.wait(LONG_S)))
    bench.put(7)
    await bench.begun()
    await clock.jump(3600.0)
    await clock.advance(1.0)
    may_end.set()
    assert await bench.take() == [7]
    await clock.stop(bench.task)
    clock.end()


async def test_frame_after_frame_in_hand_is_no_stall() -> None:
    clock, may_go_on = FakeClock.of_loop(), threading.Semaphore(0)
    bench = Bench(Locator(lambda frame: may_go_on.acquire()))
    taken = 0
    for number in range(10):
        bench.put(number)
        await clock.advance(3.0)
        may_go_on.release()
        taken += len(await bench.take())
    assert taken == 10
    await clock.stop(bench.task)
    clock.end()


async def test_shutting_down_waits_for_a_picture_of_twelve_megapixels_and_no_longer() -> None:
    cv2.setNumThreads(1)
    pixels = np.random.default_rng(0).integers(0, 20, (3000, 4096), dtype=np.uint8)
    large = Frame("front", 1, 0, pixels)
    ended = threading.Event()
    bench = Bench(Locator(lambda frame: [locate(large) for _ in range(5)] and ended.set()))
    bench.put(1)
    await bench.begun()
    bench.put(2)
    await stop(bench.task)
    assert ended.is_set()
    assert [frame.sequence for frame in bench.locator.frames] == [1]


async def test_a_localiser_that_hangs_does_not_hold_the_shutdown() -> None:
    clock, may_end = FakeClock.of_loop(), threading.Event()
    bench = Bench(Locator(lambda frame: may_end.wait(LONG_S)))
    bench.put(1)
    await bench.begun()
    began_ns = clock.now_ns
    await clock.stop(bench.task)
    assert clock.now_ns - began_ns < 3.5e9
    clock.end()
    may_end.set()


class EndingCamera(TickingCamera):
    """At its end after three frames."""

    waits = True

    def next_frame(self, timeout_s: float) -> Frame:
        if self.last >= 3:
            raise CameraEndedError("the recording is at its end")
        if self.last and timeout_s <= 0:
            raise CameraTimeoutError("not yet")
        self.last += 1
        return Frame("front", self.last, self.last, PIXELS)


async def test_all_frames_of_a_camera_that_ends_are_located_and_then_the_thread_ends_too() -> None:
    bench = Bench(Locator())
    clock = FakeClock(PERIOD_NS)
    component = Health(clock).component("camera front")
    acquiring = asyncio.create_task(acquire(EndingCamera(clock), bench.pairs, component))
    acquiring.add_done_callback(lambda _: bench.pairs.end("front"))
    taken: list[int] = []
    while len(taken) < 3:
        taken += await bench.take()
    assert taken == [1, 2, 3]
    await asyncio.gather(acquiring, bench.task)
    assert await bench.take() == []  # woken, so that nothing waits without end
