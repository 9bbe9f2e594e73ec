from __future__ import annotations

import asyncio
import itertools
import re
import threading
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from support.clock import FakeClock, stop
from support.frames import Blob, frame, light

from altd.acquisition import acquiring, camera_report
from altd.acquisition.acquiring import acquire
from altd.acquisition.auto_exposure.control import ExposureControl
from altd.acquisition.auto_exposure.rule import Setting
from altd.acquisition.latest_frames import LatestFrames, keep_mark
from altd.acquisition.latest_of_each import LatestOfEach
from altd.config import ExposureSettings
from altd.ports import (
    CameraBusyError,
    CameraEndedError,
    CameraError,
    CameraLostError,
    CameraMistimedError,
    CameraNotFoundError,
    CameraRefusedError,
    CameraTimeoutError,
    ExposureRange,
)
from altd.records import Frame, Origin
from altd.runtime.clock import SystemClock
from altd.status.health import Component, Health, State

PIXELS = frame(light(Blob(300, 200))).pixels

SLOW_MACHINE_S = 0.5


class ScriptedCamera:
    """Each call of next_frame does what the next line of the script says; then frames for ever.

    A number lets so many frames be lost.
    """

    name = "front"
    origin = Origin.CAMERA
    playback = False
    waits = False
    exposure_range = None
    identity = None

    def __init__(self, *script: Exception | str | int) -> None:
        self.script = list(script)
        self.calls: list[str] = []
        self.hang = threading.Event()
        self.number = 0

    def open(self) -> None:
        self.calls.append("open")

    def next_frame(self, timeout_s: float) -> Frame:
        step = self.script.pop(0) if self.script else "frame"
        if isinstance(step, Exception):
            raise step
        if step == "hang":
            self.hang.wait(20)
        if isinstance(step, int):
            self.number += step
        time.sleep(0.002)
        self.number += 1
        return Frame("front", self.number, time.monotonic_ns(), PIXELS)

    def set_exposure(self, exposure_ms: float, gain_db: float) -> None:
        self.calls.append(f"expose {exposure_ms:g} ms {gain_db:g} dB")

    def close(self) -> None:
        self.calls.append("close")


@pytest.fixture
def component() -> Component:
    return Health(SystemClock()).component("camera front")


def newest() -> LatestOfEach[Frame]:
    return LatestOfEach(["front"], SystemClock(), keep_mark)


async def until(condition: Callable[[], bool], limit_s: float = 5.0) -> None:
    deadline = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < deadline
        await asyncio.sleep(0.005)


async def test_a_lost_camera_is_closed_and_opened_again(component: Component) -> None:
    camera = ScriptedCamera("frame", CameraError("unplugged"), "frame")
    frames = newest()
    task = asyncio.create_task(acquire(camera, frames, component))
    await until(lambda: component.state is State.FAILED)
    assert component.message == "unplugged; trying again"
    await until(lambda: component.state is State.OK)
    assert camera.calls == ["open", "close", "open"]
    assert component.counters["failures"] == 1
    await stop(task)
    assert camera.calls[-1] == "close"


class LyingCamera(ScriptedCamera):
    """Stamps each frame off by what the next line of the script says, s."""

    def __init__(self, *off_s: float) -> None:
        super().__init__()
        self.off_s = list(off_s)

    def next_frame(self, timeout_s: float) -> Frame:
        frame = super().next_frame(timeout_s)
        off_s = self.off_s.pop(0) if self.off_s else 0.0
        return replace(frame, t_ns=frame.t_ns + round(off_s * 1e9))


@pytest.mark.parametrize(
    ("off_s", "why"),
    [
        (3600.0, "stamped 3"),
        (-10.0, " s old"),
        (-1.0, " s before the one before it"),
    ],
)
async def test_a_frame_whose_time_cannot_be_true_is_counted_said_and_left_out(
    component: Component, off_s: float, why: str
) -> None:
    camera = LyingCamera(0.0, 0.0, off_s)
    frames = newest()
    task = asyncio.create_task(acquire(camera, frames, component))
    taken: list[Frame] = []
    while component.counters.get("mistimed", 0) < 1 or len(taken) < 5:
        taken += await frames.take(wake_for_each=False)
    assert all(earlier.t_ns < later.t_ns for earlier, later in itertools.pairwise(taken))
    assert max(frame.t_ns for frame in taken) <= time.monotonic_ns()
    assert component.counters["mistimed"] == 1
    assert component.state is State.DEGRADED
    assert component.message.startswith("not measured: exposure 3 is ")
    assert why in component.message
    await stop(task)


class SettableLyingCamera(LyingCamera):
    exposure_range = ExposureRange(0.1, 10.0, 0.0, 0.0)


async def test_a_mark_of_a_change_outlives_a_frame_whose_time_cannot_be_true(component: Component) -> None:
    camera = SettableLyingCamera(3600.0)
    exposure = ExposureControl(ExposureSettings(exposure_ms=3.0), 20.0, 20)
    frames = newest()
    task = asyncio.create_task(acquire(camera, frames, component, exposure))
    (first,) = await frames.take(wake_for_each=False)
    assert first.changing
    await until(lambda: component.counters.get("mistimed") == 1)
    await stop(task)


async def test_a_frame_of_which_nobody_knows_the_time_is_counted_and_said_and_is_not_lost(
    component: Component,
) -> None:
    """Exposure 2 came and was left out; the camera stays open."""
    camera = ScriptedCamera("frame", CameraMistimedError(2, "exposure 2 came late"), 1, *["frame"] * 9)
    frames = newest()
    task = asyncio.create_task(acquire(camera, frames, component))
    taken: list[Frame] = []
    while len(taken) < 5:
        taken += await frames.take(wake_for_each=False)
    await until(lambda: component.counters.get("mistimed") == 1)
    assert "lost" not in component.counters
    assert component.message == "not measured: exposure 2 came late"
    await stop(task)
    assert camera.calls.count("open") == 1


async def test_a_source_that_waits_has_a_clock_of_its_own(component: Component) -> None:
    camera = LyingCamera(*[3600.0] * 20)
    camera.waits = True
    frames = newest()
    task = asyncio.create_task(acquire(camera, frames, component))
    assert len(await frames.take(wake_for_each=False)) == 1
    assert "mistimed" not in component.counters
    await stop(task)


async def test_the_journal_hears_of_a_lost_camera_once(
    component: Component, caplog: pytest.LogCaptureFixture
) -> None:
    camera = ScriptedCamera(*[CameraError("unplugged")] * 2, "frame")
    task = asyncio.create_task(acquire(camera, newest(), component))
    await until(lambda: component.state is State.OK)
    await stop(task)
    assert caplog.messages == ["camera front: unplugged; trying again"]


async def test_a_camera_that_times_out_stays_open_and_is_said_to(component: Component) -> None:
    camera = ScriptedCamera("frame", CameraTimeoutError("late"), "hang")
    task = asyncio.create_task(acquire(camera, newest(), component))
    await until(lambda: component.state is State.DEGRADED)
    camera.hang.set()
    await until(lambda: component.state is State.OK)
    assert camera.calls == ["open"]
    await stop(task)


@pytest.mark.parametrize(
    ("script", "why"),
    [
        (("frame", "frame", *[CameraTimeoutError("late")] * 3, "hang"), ""),
        (("frame", "frame", "hang"), "the driver does not return; "),
        (("frame", "frame", CameraLostError("unplugged"), CameraTimeoutError("late"), "hang"), ""),
    ],
)
async def test_the_time_without_a_frame_counts_from_the_last_frame_on(
    script: tuple[Exception | str, ...], why: str
) -> None:
    """Of the injected clock, whatever happens between: time-outs, a held driver, another opening."""
    clock = FakeClock(8_000_000_000)
    component = Health(clock).component("camera front")
    camera = ScriptedCamera(*script)
    task = asyncio.create_task(acquire(camera, newest(), component))
    await until(lambda: component.counters.get("frames") == 2)
    await until(lambda: not camera.script)
    clock.now_ns += 900_000_000
    await until(lambda: component.message == f"{why}no frame for 0.9 s")
    clock.now_ns += 5_100_000_000
    assert component.message.endswith("no frame for 6.0 s")
    clock.now_ns += 54_000_000_000
    assert component.message.endswith("no frame for 1 min")
    camera.hang.set()
    await until(lambda: component.state is State.OK)
    assert component.message == ""
    await stop(task)


async def test_a_camera_that_never_delivered_counts_from_when_it_was_wanted() -> None:
    clock = FakeClock(8_000_000_000)
    component = Health(clock).component("camera front")
    camera = ScriptedCamera(CameraTimeoutError("late"), "hang")
    task = asyncio.create_task(acquire(camera, newest(), component))
    await until(lambda: component.state is State.DEGRADED)
    clock.now_ns += 12_000_000_000
    assert component.message.endswith("no frame for 12 s")
    camera.hang.set()
    await stop(task)


async def test_a_camera_that_is_back_but_delivers_nothing_is_no_longer_said_to_have_failed(
    component: Component,
) -> None:
    camera = ScriptedCamera("frame", CameraLostError("unplugged"), CameraTimeoutError("late"), "hang")
    task = asyncio.create_task(acquire(camera, newest(), component))
    await until(lambda: component.state is State.FAILED)
    await until(lambda: component.state is State.DEGRADED)
    assert re.fullmatch(r"no frame for \d\.\d s", component.message)
    camera.hang.set()
    await until(lambda: component.state is State.OK)
    await stop(task)


async def test_a_source_at_its_end_ends_quietly(component: Component) -> None:
    camera = ScriptedCamera("frame", "frame", CameraEndedError("the recording is at its end"))
    frames = newest()
    await acquire(camera, frames, component)
    await until(lambda: component.state is State.ENDED)
    assert component.counters["frames"] == 2
    assert camera.calls == ["open", "close"]
    assert [f.sequence for f in await frames.take(wake_for_each=False)] == [2]


async def test_a_defect_in_a_driver_ends_the_daemon_not_just_the_thread(component: Component) -> None:
    with pytest.raises(ZeroDivisionError):
        await acquire(ScriptedCamera("frame", ZeroDivisionError()), newest(), component)


@pytest.mark.parametrize("call", ["open", "next_frame", "set_exposure", "close"])
async def test_a_camera_that_hangs_does_not_hold_the_shutdown(
    component: Component, monkeypatch: pytest.MonkeyPatch, call: str
) -> None:
    monkeypatch.setattr(acquiring, "_JOIN_TIMEOUT_S", 0.2)
    camera = SettableCamera("frame", CameraLostError("unplugged") if call == "close" else "frame")
    held = threading.Event()

    def hang(*_: object) -> Frame:
        held.set()
        camera.hang.wait(20)
        raise CameraError("too late")

    monkeypatch.setattr(camera, call, hang)
    task = asyncio.create_task(acquire(camera, newest(), component, exposure_of()))
    await until(held.is_set)
    started = time.monotonic()
    await stop(task)
    assert time.monotonic() - started < 2.0
    camera.hang.set()


async def test_a_driver_that_is_held_in_a_call_is_said_to_within_a_second(
    component: Component,
) -> None:
    camera = ScriptedCamera("frame", "hang")
    task = asyncio.create_task(acquire(camera, newest(), component))
    await until(lambda: component.state is State.OK)
    heard = time.monotonic()
    await until(lambda: component.state is State.DEGRADED)
    assert time.monotonic() - heard < 1.0 + SLOW_MACHINE_S
    assert re.fullmatch(r"the driver does not return; no frame for \d\.\d s", component.message)
    camera.hang.set()
    await until(lambda: component.state is State.OK)
    await stop(task)


async def test_a_source_whose_frames_nobody_takes_is_well(
    component: Component, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(camera_report, "STALL_TIMEOUT_S", 0.1)
    camera = ScriptedCamera()
    camera.waits = True
    frames = newest()
    task = asyncio.create_task(acquire(camera, frames, component))
    await until(lambda: component.counters.get("frames") == 2)
    await asyncio.sleep(0.6)
    assert component.state is State.OK
    await stop(task)


async def test_lost_frames_are_counted_and_spoken_of_for_a_second(component: Component) -> None:
    camera = ScriptedCamera("frame", 2, "frame", 1, "frame")
    task = asyncio.create_task(acquire(camera, newest(), component))
    await until(lambda: component.counters.get("frames", 0) >= 5)
    assert component.state is State.DEGRADED
    assert component.message == "3 frames lost in the last second"
    assert component.counters["lost"] == 3
    await until(lambda: component.state is State.OK)
    assert component.message == ""
    assert component.counters["lost"] == 3
    await stop(task)


async def test_losses_are_forgotten_even_when_no_frame_follows(component: Component) -> None:
    camera = ScriptedCamera("frame", 2, *[CameraTimeoutError("late")] * 2, "frame", "hang")
    task = asyncio.create_task(acquire(camera, newest(), component))
    await until(lambda: component.counters.get("lost") == 2)
    await until(lambda: component.message.startswith("the driver does not return; no frame for "))
    camera.hang.set()
    await until(lambda: component.state is State.OK)
    await stop(task)


async def test_a_camera_that_starts_to_count_anew_has_lost_nothing(component: Component) -> None:
    camera = ScriptedCamera("frame", -500, "frame", CameraLostError("unplugged"), 700, "frame")
    task = asyncio.create_task(acquire(camera, newest(), component))
    await until(lambda: component.counters.get("frames", 0) >= 6)
    assert "lost" not in component.counters
    await stop(task)


@pytest.mark.parametrize(
    ("error", "sentence"),
    [
        (CameraNotFoundError("/dev/video7"), "not found: /dev/video7; trying again"),
        (CameraBusyError("/dev/video7"), "busy: /dev/video7; trying again"),
        (CameraLostError("/dev/video7"), "lost: /dev/video7; trying again"),
        (CameraRefusedError("no Y10"), "refused: no Y10; trying again"),
        (CameraError("no idea"), "no idea; trying again"),
    ],
)
async def test_a_camera_that_cannot_be_opened_is_tried_again_and_says_why(
    component: Component, monkeypatch: pytest.MonkeyPatch, error: CameraError, sentence: str
) -> None:
    camera = ScriptedCamera()
    tried: list[float] = []

    def refuse() -> None:
        tried.append(time.monotonic())
        if len(tried) <= 3:
            raise error

    monkeypatch.setattr(camera, "open", refuse)
    task = asyncio.create_task(acquire(camera, newest(), component))
    await until(lambda: component.state is State.FAILED)
    assert component.message == sentence
    await until(lambda: component.state is State.OK)
    pauses = [after - before for before, after in itertools.pairwise(tried)]
    assert max(pauses) < 0.5 + SLOW_MACHINE_S
    assert pauses[0] < 0.2 + SLOW_MACHINE_S
    assert component.counters["failures"] == 3
    await stop(task)


async def test_the_journal_hears_each_of_two_failures_that_alternate_once(
    component: Component, caplog: pytest.LogCaptureFixture
) -> None:
    script = [CameraLostError("unplugged"), CameraNotFoundError("nothing there")] * 2
    task = asyncio.create_task(acquire(ScriptedCamera(*script, "frame"), newest(), component))
    await until(lambda: component.state is State.OK)
    await stop(task)
    assert caplog.messages == [
        "camera front: lost: unplugged; trying again",
        "camera front: not found: nothing there; trying again",
    ]


async def test_a_failure_is_news_again_when_the_camera_was_well_for_long(
    component: Component, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(acquiring, "_LOG_AGAIN_AFTER_S", 0.05)
    frames = ["frame"] * 50
    camera = ScriptedCamera(*frames, CameraLostError("unplugged"), *frames, CameraLostError("unplugged"))
    task = asyncio.create_task(acquire(camera, newest(), component))
    await until(lambda: component.counters.get("failures") == 2 and component.state is State.OK)
    await stop(task)
    assert caplog.messages == ["camera front: lost: unplugged; trying again"] * 2


class SettableCamera(ScriptedCamera):
    """Uses a setting from the third frame after it on, and writes into the pixels how many ms it had."""

    exposure_range = ExposureRange(1.0, 200.0, 0.0, 0.0)

    def __init__(self, *script: Exception | str | int) -> None:
        super().__init__(*script)
        self.used_ms = 1.0
        self.coming: list[float] = [1.0] * 2
        self.refusal: Exception | None = None

    def set_exposure(self, exposure_ms: float, gain_db: float) -> None:
        super().set_exposure(exposure_ms, gain_db)
        if self.refusal is not None:
            raise self.refusal
        self.used_ms = exposure_ms

    def next_frame(self, timeout_s: float) -> Frame:
        taken = super().next_frame(timeout_s)
        self.coming.append(self.used_ms)
        pixels = np.full((4, 4), round(self.coming.pop(0)), np.uint8)
        return Frame("front", taken.sequence, taken.t_ns, pixels)


def exposure_of(exposure_ms: float = 10.0) -> ExposureControl:
    return ExposureControl(ExposureSettings(control="fixed", exposure_ms=exposure_ms), 4.0, 20)


class AllFrames(LatestFrames):
    """Keeps every frame."""

    def __init__(self) -> None:
        super().__init__(["front"])
        self.frames: list[Frame] = []

    def put(self, frame: Frame, wait: bool) -> None:
        self.frames.append(frame)


async def test_a_new_setpoint_is_applied_between_two_frames_and_the_frames_of_the_change_are_marked(
    component: Component,
) -> None:
    camera, exposure, frames = SettableCamera(), exposure_of(10.0), AllFrames()
    task = asyncio.create_task(acquire(camera, frames, component, exposure))
    for exposure_ms in (10.0, 40.0, 160.0, 20.0):
        exposure.setpoint = Setting(exposure_ms, 0.0)
        counted = len(frames.frames)
        await until(lambda counted=counted: len(frames.frames) > counted + 12)  # type: ignore[misc]
    await stop(task)
    certain = [frame for frame in frames.frames if not frame.changing]
    assert all(frame.pixels[0, 0] == frame.exposure_ms for frame in certain)
    assert [frame.exposure_ms for frame in frames.frames if frame.changing] == [
        ms for ms in (10.0, 40.0, 160.0, 20.0) for _ in range(4)
    ]
    assert [call for call in camera.calls if "expose" in call] == [
        f"expose {ms} ms 0 dB" for ms in (10, 40, 160, 20)
    ]


async def test_a_camera_that_was_opened_again_gets_its_exposure_again(component: Component) -> None:
    camera = SettableCamera("frame", CameraLostError("unplugged"), "frame")
    task = asyncio.create_task(acquire(camera, newest(), component, exposure_of()))
    await until(lambda: camera.calls.count("expose 10 ms 0 dB") == 2)
    await stop(task)
    assert camera.calls == ["open", "expose 10 ms 0 dB", "close"] * 2


async def test_a_camera_that_refuses_an_exposure_goes_on_and_health_says_so(
    component: Component, caplog: pytest.LogCaptureFixture
) -> None:
    camera, exposure = SettableCamera(), exposure_of()
    camera.refusal = CameraRefusedError("the register is locked")
    task = asyncio.create_task(acquire(camera, newest(), component, exposure))
    await until(lambda: component.counters.get("frames", 0) >= 3)
    assert component.state is State.DEGRADED
    assert component.message == "exposure refused: the register is locked"
    assert component.counters["refused_exposures"] == 1
    camera.refusal = None
    exposure.setpoint = Setting(20.0, 0.0)
    await until(lambda: component.state is State.OK)
    await stop(task)
    assert camera.calls == ["open", "expose 10 ms 0 dB", "expose 20 ms 0 dB", "close"]
    assert caplog.messages == ["camera front: exposure refused: the register is locked"]
