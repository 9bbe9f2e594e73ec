from __future__ import annotations

import asyncio
import itertools
import threading
import time

import pytest
from support.clock import stop
from support.scripted_camera import ScriptedCamera, SettableCamera, exposure_of, newest, until

from altd.acquisition import acquiring
from altd.acquisition.acquiring import acquire
from altd.ports import (
    CameraBusyError,
    CameraEndedError,
    CameraError,
    CameraLostError,
    CameraNotFoundError,
    CameraRefusedError,
)
from altd.records import Frame
from altd.status.health import Component, State

SLOW_MACHINE_S = 0.5


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


async def test_the_journal_hears_of_a_lost_camera_once(
    component: Component, caplog: pytest.LogCaptureFixture
) -> None:
    camera = ScriptedCamera(*[CameraError("unplugged")] * 2, "frame")
    task = asyncio.create_task(acquire(camera, newest(), component))
    await until(lambda: component.state is State.OK)
    await stop(task)
    assert caplog.messages == ["camera front: unplugged; trying again"]


async def test_a_source_at_its_end_ends_quietly(component: Component) -> None:
    camera = ScriptedCamera("frame", "frame", CameraEndedError("the recording is at its end"))
    frames = newest()
    await acquire(camera, frames, component)
    await until(lambda: component.state is State.ENDED)
    assert component.counters["frames"] == 2
    assert camera.calls == ["open", "close"]
    assert [f.sequence for f in await frames.take(wake_for_each=False)] == [2]


async def test_every_frame_is_counted_also_when_it_ends_between_two_reports(component: Component) -> None:
    came = threading.Event()

    class Counting:
        frames = 0

        def put(self, frame: Frame, wait: bool) -> None:
            self.frames += 1
            came.set()

        def close(self) -> None:
            pass

    sink = Counting()
    task = asyncio.create_task(acquire(ScriptedCamera("frame"), sink, component))
    assert await asyncio.to_thread(came.wait, 5)
    assert "frames" not in component.counters, "reported already: nothing is shown by this test"
    await stop(task)
    assert component.counters["frames"] == sink.frames


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
    monkeypatch.setattr(acquiring, "_LOG_REPEAT_S", 0.05)
    frames = ["frame"] * 50
    camera = ScriptedCamera(*frames, CameraLostError("unplugged"), *frames, CameraLostError("unplugged"))
    task = asyncio.create_task(acquire(camera, newest(), component))
    await until(lambda: component.counters.get("failures") == 2 and component.state is State.OK)
    await stop(task)
    assert caplog.messages == ["camera front: lost: unplugged; trying again"] * 2


async def test_a_camera_is_heard_of_while_it_fails_and_not_once_nobody_looks_after_it(
    component: Component,
) -> None:
    task = asyncio.create_task(acquire(ScriptedCamera(*[CameraError("unplugged")] * 50), newest(), component))
    await until(lambda: component.state is State.FAILED)
    heard_ns = component.heard_ns
    await until(lambda: component.heard_ns > heard_ns + 500_000_000)
    await stop(task)
    # by its clock, without waiting: what it said last is true no more
    later_ns = component.clock.monotonic_ns() + 5_000_000_000
    assert component.silent_s(later_ns) is not None
    assert component.silent_s(later_ns - 4_900_000_000) is None
