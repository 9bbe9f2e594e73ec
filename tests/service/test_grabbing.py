from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Callable

import pytest
from support.clock import stop
from support.frames import Blob, frame, light

from altd.ports import CameraEndedError, CameraError, CameraTimeoutError
from altd.records import Frame, Origin
from altd.service import grabbing
from altd.service.clock import SystemClock
from altd.service.grabbing import grab
from altd.service.health import Component, Health, State
from altd.service.inbox import Inbox

PIXELS = frame(light(Blob(300, 200))).pixels


class ScriptedCamera:
    """Each call of next_frame does what the next line of the script says; then frames for ever."""

    name = "front"
    origin = Origin.CAMERA
    waits = False
    exposure_range = None

    def __init__(self, *script: Exception | str) -> None:
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


async def until(condition: Callable[[], bool], limit_s: float = 5.0) -> None:
    deadline = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < deadline
        await asyncio.sleep(0.005)


async def test_a_lost_camera_is_closed_and_opened_again(component: Component) -> None:
    camera = ScriptedCamera("frame", CameraError("unplugged"), "frame")
    inbox = Inbox(["front"])
    task = asyncio.create_task(grab(camera, inbox, component))
    await until(lambda: component.state is State.FAILED)
    assert component.message == "unplugged; trying again"
    await until(lambda: component.state is State.OK)
    assert camera.calls == ["open", "close", "open"]
    assert component.counters["failures"] == 1
    await stop(task)
    assert camera.calls[-1] == "close"


async def test_the_journal_hears_of_a_lost_camera_once(
    component: Component, caplog: pytest.LogCaptureFixture
) -> None:
    camera = ScriptedCamera(*[CameraError("unplugged")] * 2, "frame")
    task = asyncio.create_task(grab(camera, Inbox(["front"]), component))
    await until(lambda: component.state is State.OK)
    await stop(task)
    assert caplog.messages == ["camera front: unplugged; trying again"]


async def test_a_camera_that_times_out_stays_open_and_is_said_to(component: Component) -> None:
    camera = ScriptedCamera("frame", CameraTimeoutError("late"), "hang")
    task = asyncio.create_task(grab(camera, Inbox(["front"]), component))
    await until(lambda: component.state is State.DEGRADED)
    camera.hang.set()
    await until(lambda: component.state is State.OK)
    assert camera.calls == ["open"]
    await stop(task)


async def test_a_source_at_its_end_ends_quietly(component: Component) -> None:
    camera = ScriptedCamera("frame", "frame", CameraEndedError("the recording is at its end"))
    inbox = Inbox(["front"])
    await grab(camera, inbox, component)
    await until(lambda: component.state is State.ENDED)
    assert component.counters["frames"] == 2
    assert camera.calls == ["open", "close"]
    assert [f.sequence for f in await inbox.take()] == [2]


async def test_a_defect_in_a_driver_ends_the_daemon_not_just_the_thread(component: Component) -> None:
    with pytest.raises(ZeroDivisionError):
        await grab(ScriptedCamera("frame", ZeroDivisionError()), Inbox(["front"]), component)


async def test_a_camera_that_hangs_does_not_hold_the_shutdown(
    component: Component, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(grabbing, "_FAREWELL_S", 0.2)
    camera = ScriptedCamera("frame", "hang")
    task = asyncio.create_task(grab(camera, Inbox(["front"]), component))
    await until(lambda: component.counters.get("frames") == 1)
    started = time.monotonic()
    await stop(task)
    assert time.monotonic() - started < 2.0
    camera.hang.set()
