"""Threads that locate spots: slow ones, hanging ones, broken ones, and their end."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
import pytest
from support.clock import stop
from support.frames import Blob, frame, light
from support.located import SPOT, located

from altd.acquisition import locating
from altd.acquisition.acquiring import acquire
from altd.acquisition.auto_exposure.control import ExposureControl, ExposureFigures
from altd.acquisition.buffers import Buffers
from altd.acquisition.latest_frames import LatestFrames
from altd.acquisition.latest_of_each import LatestOfEach
from altd.acquisition.locating import LocatingStalledError, locate_frame, locate_frames
from altd.config import ExposureSettings
from altd.measuring.spot_locator import Located
from altd.ports import CameraEndedError, CameraTimeoutError
from altd.records import Frame, Origin
from altd.runtime.clock import SystemClock
from altd.status.health import Health
from altd.vision.localise import locate

PIXELS = frame(light(Blob(300, 200))).pixels
PERIOD_NS = 10_000_000


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
    """The thread between its two slots."""

    def __init__(
        self, locator: Locator, exposure: ExposureControl | None = None, waits: bool = False
    ) -> None:
        self.locator = locator
        self.frames = LatestFrames(["front"])
        self.located: LatestOfEach[Located] = LatestOfEach(["front"], SystemClock())
        self.task = asyncio.create_task(
            locate_frames(Buffers(self.frames, self.located), locator, None, waits)  # type: ignore[arg-type]
        )

    async def take(self) -> list[int]:
        async with asyncio.timeout(5.0):
            return [one.sequence for one in await self.located.take(wake_for_each=False)]


async def until(condition: Callable[[], bool], limit_s: float = 5.0) -> None:
    deadline = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < deadline
        await asyncio.sleep(0.005)


async def test_what_is_located_in_the_thread_wakes_the_loop() -> None:
    bench = Bench(Locator(lambda frame: threads.add(threading.current_thread().name)))
    threads: set[str] = set()
    for number in range(3):
        bench.frames.put(shot(number), wait=False)
        assert await bench.take() == [number]
    assert threads == {"locate-front"}
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
        "auto, but this camera has nothing to set", pytest.approx(level, abs=0.01), None, None, 0
    )
    assert SPOT.diameter_px == 40.0  # a quarter of it is the half side of the square


class TickingCamera:
    """Exposes every 10 ms; like a driver with one buffer it loses what is not fetched in time."""

    name = "front"
    origin = Origin.CAMERA
    playback = False
    waits = False
    exposure_range = None
    identity = None

    def __init__(self) -> None:
        self.begin_ns = time.monotonic_ns()
        self.last = 0

    def open(self) -> None: ...

    def next_frame(self, timeout_s: float) -> Frame:
        time.sleep(max((self.begin_ns + (self.last + 1) * PERIOD_NS - time.monotonic_ns()) * 1e-9, 0.0))
        self.last = (time.monotonic_ns() - self.begin_ns) // PERIOD_NS
        return Frame("front", self.last, self.begin_ns + self.last * PERIOD_NS, PIXELS)

    def set_exposure(self, exposure_ms: float, gain_db: float) -> None: ...

    def close(self) -> None: ...


async def test_a_camera_located_slower_than_it_delivers_is_measured_newest_and_the_rest_counted() -> None:
    """Locating takes five periods; that holds up neither the driver nor what comes next."""
    camera, ages_ns = TickingCamera(), list[int]()

    def slowly(frame: Frame) -> None:
        ages_ns.append((camera.begin_ns + camera.last * PERIOD_NS) - frame.t_ns)
        time.sleep(0.05)

    bench = Bench(Locator(slowly))
    component = Health(SystemClock()).component("camera front")
    acquiring = asyncio.create_task(acquire(camera, bench.frames, component))
    taken: list[int] = []
    while len(taken) < 15:
        taken += await bench.take()
    await stop(acquiring)
    await stop(bench.task)
    lost = component.counters.get("lost", 0)
    assert lost <= 0.1 * camera.last  # by the driver: the machine was busy
    assert max(ages_ns) <= 2 * PERIOD_NS
    begun = len(bench.locator.frames)
    assert 3 * begun <= bench.frames.dropped["front"] <= 6 * begun
    assert taken == sorted(set(taken))


async def test_a_defect_in_the_localiser_is_raised() -> None:
    bench = Bench(Locator(lambda frame: 1 / 0))
    bench.frames.put(shot(1), wait=False)
    with pytest.raises(ZeroDivisionError):
        await bench.task


async def test_a_frame_that_is_never_done_is_a_defect(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(locating, "_CHECK_INTERVAL_S", 0.01)
    monkeypatch.setattr(locating, "_JOIN_TIMEOUT_S", 0.1)
    may_end = threading.Event()
    bench = Bench(Locator(lambda frame: may_end.wait(10)))
    bench.frames.put(shot(7), wait=False)
    with pytest.raises(LocatingStalledError, match=r"camera front: exposure 7 is not located within 0\.2 s"):
        await bench.task
    may_end.set()


async def test_a_process_that_was_stopped_meanwhile_has_not_located_longer(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Stopped as a whole, it finds an old frame in hand; here the loop alone stands still."""
    monkeypatch.setattr(locating, "_CHECK_INTERVAL_S", 0.02)
    may_end = threading.Event()
    bench = Bench(Locator(lambda frame: may_end.wait(10)))
    bench.frames.put(shot(7), wait=False)
    await until(bench.locator.begun.is_set)
    time.sleep(1.0)  # noqa: ASYNC251  more than twice what is allowed
    await asyncio.sleep(0.1)
    may_end.set()
    assert await bench.take() == [7]
    await stop(bench.task)


async def test_frame_after_frame_in_hand_is_no_stall(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(locating, "_CHECK_INTERVAL_S", 0.005)
    bench = Bench(Locator(lambda frame: time.sleep(0.02)), waits=True)
    taken = 0
    for number in range(30):
        bench.frames.put(shot(number), wait=False)
        taken += len(await bench.take())
    assert taken == 30
    await stop(bench.task)


async def test_shutting_down_waits_for_a_picture_of_twelve_megapixels_and_no_longer() -> None:
    cv2.setNumThreads(1)
    pixels = np.random.default_rng(0).integers(0, 20, (3000, 4096), dtype=np.uint8)
    large = Frame("front", 1, 0, pixels)
    ended = threading.Event()
    bench = Bench(Locator(lambda frame: [locate(large) for _ in range(5)] and ended.set()))
    bench.frames.put(shot(1), wait=False)
    await until(bench.locator.begun.is_set)
    bench.frames.put(shot(2), wait=False)
    await stop(bench.task)
    assert ended.is_set()
    assert [frame.sequence for frame in bench.locator.frames] == [1]


async def test_a_localiser_that_hangs_does_not_hold_the_shutdown(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(locating, "_JOIN_TIMEOUT_S", 0.2)
    may_end = threading.Event()
    bench = Bench(Locator(lambda frame: may_end.wait(10)))
    bench.frames.put(shot(1), wait=False)
    await until(bench.locator.begun.is_set)
    began_s = time.monotonic()
    await stop(bench.task)
    assert time.monotonic() - began_s < 1.0
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
    bench = Bench(Locator(lambda frame: time.sleep(0.01)), waits=True)
    component = Health(SystemClock()).component("camera front")
    acquiring = asyncio.create_task(acquire(EndingCamera(), bench.frames, component))
    acquiring.add_done_callback(lambda _: bench.frames.end("front"))
    taken: list[int] = []
    while len(taken) < 3:
        taken += await bench.take()
    assert taken == [1, 2, 3]
    async with asyncio.timeout(5.0):
        await asyncio.gather(acquiring, bench.task)
    assert await bench.take() == []  # woken, so that nothing waits in a slot for ever
