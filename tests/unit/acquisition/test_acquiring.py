"""Cameras that are lost, refuse, hang and end, and their exposure, by the thread that takes their frames."""

import asyncio
import itertools
import threading
from dataclasses import replace

import pytest
from support.clock import FakeClock
from support.scripted_camera import PERIOD_S, AllFrames, ScriptedCamera, SettableCamera, exposure_of

from altd.acquisition import acquiring
from altd.acquisition.acquiring import acquire
from altd.acquisition.auto_exposure.rule import Setting
from altd.ports import (
    CameraBusyError,
    CameraEndedError,
    CameraError,
    CameraLostError,
    CameraNotFoundError,
    CameraRefusedError,
)
from altd.records import Frame
from altd.status.health import CameraTrouble, Component, State


async def test_a_lost_camera_is_closed_and_opened_again(component: Component, clock: FakeClock) -> None:
    camera = ScriptedCamera(clock, "frame", CameraError("unplugged"), "frame")
    frames = AllFrames()
    task = asyncio.create_task(acquire(camera, frames, component))
    await clock.until(lambda: component.state is State.FAILED)
    assert component.message == "unplugged; trying again"
    await clock.until(lambda: component.state is State.OK)
    assert camera.calls == ["open", "close", "open"]
    assert component.counters["failures"] == 1
    await clock.stop(task)
    assert camera.calls[-1] == "close"


async def test_a_source_at_its_end_ends_quietly(component: Component, clock: FakeClock) -> None:
    camera = ScriptedCamera(clock, "frame", "frame", CameraEndedError("the recording is at its end"))
    frames = AllFrames()
    await clock.run(acquire(camera, frames, component))
    await clock.until(lambda: component.state is State.ENDED)
    assert component.counters["frames"] == 2
    assert camera.calls == ["open", "close"]
    assert [f.sequence for f in await frames.take(clock)] == [1, 2]


async def test_every_frame_is_counted_also_when_it_ends_between_two_reports(
    component: Component, clock: FakeClock
) -> None:
    class Counting:
        frames = 0

        def put(self, frame: Frame, wait: bool) -> None:
            self.frames += 1

        def close(self) -> None:
            pass

    sink = Counting()
    task = asyncio.create_task(acquire(ScriptedCamera(clock, "frame"), sink, component))
    await clock.advance(2.5 * PERIOD_S)
    assert sink.frames == 2
    assert "frames" not in component.counters, "reported already: nothing is shown by this test"
    await clock.stop(task)
    assert component.counters["frames"] == sink.frames


async def test_a_defect_in_a_driver_ends_the_daemon_not_just_the_thread(
    component: Component, clock: FakeClock
) -> None:
    with pytest.raises(ZeroDivisionError):
        await clock.run(acquire(ScriptedCamera(clock, "frame", ZeroDivisionError()), AllFrames(), component))


@pytest.mark.parametrize("call", ["open", "next_frame", "set_exposure", "close"])
async def test_a_camera_that_hangs_does_not_hold_the_shutdown(
    component: Component, monkeypatch: pytest.MonkeyPatch, call: str, clock: FakeClock
) -> None:
    camera = SettableCamera(clock, "frame", CameraLostError("unplugged") if call == "close" else "frame")
    held = threading.Event()

    def hang(*_: object) -> Frame:
        held.set()
        clock.hold(camera.hang)
        raise CameraError("too late")

    monkeypatch.setattr(camera, call, hang)
    monkeypatch.setattr(acquiring, "_LIMITS", replace(acquiring._LIMITS, close_s=0.05))  # noqa: SLF001
    task = asyncio.create_task(acquire(camera, AllFrames(), component, exposure_of()))
    await clock.until(held.is_set)
    await clock.stop(task)
    assert not camera.hang.is_set()
    clock.release(camera.hang)


@pytest.mark.parametrize(
    ("error", "sentence", "trouble"),
    [
        (CameraNotFoundError("/dev/video7"), "not found: /dev/video7; trying again", CameraTrouble.NOT_FOUND),
        (CameraBusyError("/dev/video7"), "busy: /dev/video7; trying again", CameraTrouble.BUSY),
        (CameraLostError("/dev/video7"), "lost: /dev/video7; trying again", CameraTrouble.LOST),
        (CameraRefusedError("no Y10"), "refused: no Y10; trying again", CameraTrouble.REFUSED),
        (CameraError("no idea"), "no idea; trying again", None),
    ],
)
async def test_a_camera_that_cannot_be_opened_is_tried_again_and_says_why(
    component: Component,
    monkeypatch: pytest.MonkeyPatch,
    error: CameraError,
    sentence: str,
    trouble: CameraTrouble | None,
    clock: FakeClock,
) -> None:
    camera = ScriptedCamera(clock)
    tried: list[float] = []

    def refuse() -> None:
        tried.append(clock.now_ns * 1e-9)
        if len(tried) <= 3:
            raise error

    monkeypatch.setattr(camera, "open", refuse)
    task = asyncio.create_task(acquire(camera, AllFrames(), component))
    await clock.until(lambda: component.state is State.FAILED)
    assert component.message == sentence
    assert component.trouble is trouble
    await clock.until(lambda: component.state is State.OK)
    pauses = [after - before for before, after in itertools.pairwise(tried)]
    assert pauses == pytest.approx([0.2, 0.4, 0.5])
    assert component.counters["failures"] == 3
    await clock.stop(task)


async def test_a_failure_is_news_again_when_the_camera_was_well_for_long(
    component: Component, caplog: pytest.LogCaptureFixture, clock: FakeClock
) -> None:
    frames = ["frame"] * 201  # of 20 a second
    camera = ScriptedCamera(
        clock, *frames, CameraLostError("unplugged"), *frames, CameraLostError("unplugged")
    )
    task = asyncio.create_task(acquire(camera, AllFrames(), component))
    await clock.until(lambda: component.counters.get("failures") == 2 and component.state is State.OK)
    await clock.stop(task)
    assert caplog.messages == ["camera front: lost: unplugged; trying again"] * 2


async def test_a_camera_is_heard_of_while_it_fails_and_not_once_nobody_looks_after_it(
    component: Component, clock: FakeClock
) -> None:
    task = asyncio.create_task(
        acquire(ScriptedCamera(clock, *[CameraError("unplugged")] * 50), AllFrames(), component)
    )
    await clock.until(lambda: component.state is State.FAILED)
    heard_ns = component.heard_ns
    await clock.until(lambda: component.heard_ns > heard_ns + 500_000_000)
    await clock.stop(task)
    # by its clock, without waiting: what it said last is true no more
    later_ns = component.clock.monotonic_ns() + 5_000_000_000
    assert component.silent_s(later_ns) is not None
    assert component.silent_s(later_ns - 4_900_000_000) is None


async def test_a_new_setpoint_is_applied_between_two_frames_and_the_frames_of_the_change_are_marked(
    component: Component, clock: FakeClock
) -> None:
    camera, exposure, frames = SettableCamera(clock), exposure_of(10.0), AllFrames()
    task = asyncio.create_task(acquire(camera, frames, component, exposure))
    for exposure_ms in (10.0, 40.0, 160.0, 20.0):
        exposure.setpoint = Setting(exposure_ms, 0.0)
        counted = len(frames.frames)
        await clock.until(lambda counted=counted: len(frames.frames) > counted + 12)  # type: ignore[misc]
    await clock.stop(task)
    certain = [frame for frame in frames.frames if not frame.changing]
    assert all(frame.pixels[0, 0] == frame.exposure_ms for frame in certain)
    assert [frame.exposure_ms for frame in frames.frames if frame.changing] == [
        ms for ms in (10.0, 40.0, 160.0, 20.0) for _ in range(4)
    ]
    assert [call for call in camera.calls if "expose" in call] == [
        f"expose {ms} ms 0 dB" for ms in (10, 40, 160, 20)
    ]


async def test_a_camera_that_was_opened_again_gets_its_exposure_again(
    component: Component, clock: FakeClock
) -> None:
    camera = SettableCamera(clock, "frame", CameraLostError("unplugged"), "frame")
    task = asyncio.create_task(acquire(camera, AllFrames(), component, exposure_of()))
    await clock.until(lambda: camera.calls.count("expose 10 ms 0 dB") == 2)
    await clock.stop(task)
    assert camera.calls == ["open", "expose 10 ms 0 dB", "close"] * 2


async def test_a_camera_that_changes_its_picture_by_itself_goes_on_and_health_says_so(
    component: Component, clock: FakeClock
) -> None:
    camera = ScriptedCamera(clock, *["frame"] * 20, 3)
    camera.automatic = "gain_automatic", "white_balance_automatic"
    task = asyncio.create_task(acquire(camera, AllFrames(), component))
    await clock.until(lambda: component.state is State.DEGRADED)
    assert component.message == "stays on: gain_automatic, white_balance_automatic"
    assert component.trouble is CameraTrouble.AUTOMATIC
    await clock.until(lambda: component.message.startswith("3 frames lost in the last second; stays on"))
    assert component.trouble is None
    await clock.stop(task)


async def test_a_camera_that_refuses_an_exposure_goes_on_and_health_says_so(
    component: Component, caplog: pytest.LogCaptureFixture, clock: FakeClock
) -> None:
    camera, exposure = SettableCamera(clock), exposure_of()
    camera.refusal = CameraRefusedError("the register is locked")
    task = asyncio.create_task(acquire(camera, AllFrames(), component, exposure))
    await clock.until(lambda: component.counters.get("frames", 0) >= 3)
    assert component.state is State.DEGRADED
    assert component.message == "exposure refused: the register is locked"
    assert component.trouble is CameraTrouble.EXPOSURE_REFUSED
    assert component.counters["refused_exposures"] == 1
    camera.refusal = None
    exposure.setpoint = Setting(20.0, 0.0)
    await clock.until(lambda: component.state is State.OK)
    await clock.stop(task)
    assert camera.calls == ["open", "expose 10 ms 0 dB", "expose 20 ms 0 dB", "close"]
    assert caplog.messages == ["camera front: exposure refused: the register is locked"]
