from __future__ import annotations

import asyncio

import pytest
from support.clock import FakeClock
from support.scripted_camera import AllFrames, SettableCamera, exposure_of

from altd.acquisition.acquiring import acquire
from altd.acquisition.auto_exposure.rule import Setting
from altd.ports import CameraLostError, CameraRefusedError
from altd.status.health import Component, State


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


async def test_a_camera_that_refuses_an_exposure_goes_on_and_health_says_so(
    component: Component, caplog: pytest.LogCaptureFixture, clock: FakeClock
) -> None:
    camera, exposure = SettableCamera(clock), exposure_of()
    camera.refusal = CameraRefusedError("the register is locked")
    task = asyncio.create_task(acquire(camera, AllFrames(), component, exposure))
    await clock.until(lambda: component.counters.get("frames", 0) >= 3)
    assert component.state is State.DEGRADED
    assert component.message == "exposure refused: the register is locked"
    assert component.counters["refused_exposures"] == 1
    camera.refusal = None
    exposure.setpoint = Setting(20.0, 0.0)
    await clock.until(lambda: component.state is State.OK)
    await clock.stop(task)
    assert camera.calls == ["open", "expose 10 ms 0 dB", "expose 20 ms 0 dB", "close"]
    assert caplog.messages == ["camera front: exposure refused: the register is locked"]
