import asyncio
import re
import threading

import pytest
from support.clock import FakeClock
from support.scripted_camera import PERIOD_S, AllFrames, ScriptedCamera

from altd.acquisition.acquiring import acquire
from altd.ports import CameraLostError, CameraTimeoutError
from altd.records import Frame
from altd.status.health import CameraTrouble, Component, State


async def test_a_camera_that_times_out_stays_open_and_is_said_to(
    component: Component, clock: FakeClock
) -> None:
    camera = ScriptedCamera(clock, "frame", CameraTimeoutError("late"), "hang")
    task = asyncio.create_task(acquire(camera, AllFrames(), component))
    await clock.until(lambda: component.state is State.DEGRADED)
    clock.release(camera.hang)
    await clock.until(lambda: component.state is State.OK)
    assert camera.calls == ["open"]
    await clock.stop(task)


@pytest.mark.parametrize(
    ("script", "why"),
    [
        (("frame", "frame", *[CameraTimeoutError("late")] * 3, "hang"), ""),
        (("frame", "frame", "hang"), "the driver does not return; "),
        (("frame", "frame", CameraLostError("unplugged"), CameraTimeoutError("late"), "hang"), ""),
    ],
)
async def test_the_time_without_a_frame_counts_from_the_last_frame_on(
    script: tuple[Exception | str, ...], why: str, component: Component, clock: FakeClock
) -> None:
    """Whatever happens between: time-outs, a held driver, another opening."""
    frame_ns = clock.now_ns + 2 * round(PERIOD_S * 1e9)
    camera = ScriptedCamera(clock, *script)
    task = asyncio.create_task(acquire(camera, AllFrames(), component))
    await clock.until(lambda: component.counters.get("frames") == 2)
    await clock.until(lambda: not camera.script)
    await clock.advance(0.9 - (clock.now_ns - frame_ns) * 1e-9)
    assert component.message == f"{why}no frame for 0.9 s"
    assert component.trouble is (CameraTrouble.DRIVER_HANGS if why else CameraTrouble.NO_FRAMES)
    await clock.advance(5.1)
    assert component.message.endswith("no frame for 6.0 s")
    await clock.advance(54.0)
    assert component.message.endswith("no frame for 1 min")
    clock.release(camera.hang)
    await clock.until(lambda: component.state is State.OK)
    assert component.message == ""
    await clock.stop(task)


async def test_a_camera_that_never_delivered_counts_from_when_it_was_wanted(
    component: Component, clock: FakeClock
) -> None:
    camera = ScriptedCamera(clock, CameraTimeoutError("late"), "hang")
    task = asyncio.create_task(acquire(camera, AllFrames(), component))
    await clock.until(lambda: component.state is State.DEGRADED)
    await clock.advance(12.0)
    assert component.message.endswith("no frame for 12 s")
    clock.release(camera.hang)
    await clock.stop(task)


async def test_a_camera_that_is_back_but_delivers_nothing_is_no_longer_said_to_have_failed(
    component: Component, clock: FakeClock
) -> None:
    camera = ScriptedCamera(clock, "frame", CameraLostError("unplugged"), CameraTimeoutError("late"), "hang")
    task = asyncio.create_task(acquire(camera, AllFrames(), component))
    await clock.until(lambda: component.state is State.FAILED)
    await clock.until(lambda: component.state is State.DEGRADED)
    assert re.fullmatch(r"no frame for \d\.\d s", component.message)
    clock.release(camera.hang)
    await clock.until(lambda: component.state is State.OK)
    await clock.stop(task)


async def test_a_source_whose_frames_nobody_takes_is_well(component: Component, clock: FakeClock) -> None:
    class Full:
        def __init__(self) -> None:
            self.has_room = threading.Event()

        def put(self, frame: Frame, wait: bool) -> None:
            if frame.sequence == 2:
                clock.hold(self.has_room)

        def close(self) -> None:
            clock.release(self.has_room)

    camera = ScriptedCamera(clock)
    camera.waits = True
    task = asyncio.create_task(acquire(camera, Full(), component))
    await clock.until(lambda: component.counters.get("frames") == 2)
    await clock.advance(60.0)
    assert component.state is State.OK
    await clock.stop(task)


async def test_lost_frames_are_counted_and_spoken_of_for_a_second(
    component: Component, clock: FakeClock
) -> None:
    camera = ScriptedCamera(clock, "frame", 2, "frame", 1, "frame")
    task = asyncio.create_task(acquire(camera, AllFrames(), component))
    await clock.until(lambda: component.counters.get("frames", 0) >= 5)
    assert component.state is State.DEGRADED
    assert component.message == "3 frames lost in the last second"
    assert component.counters["lost"] == 3
    await clock.until(lambda: component.state is State.OK)
    assert component.message == ""
    assert component.counters["lost"] == 3
    await clock.stop(task)


async def test_losses_are_forgotten_even_when_no_frame_follows(
    component: Component, clock: FakeClock
) -> None:
    camera = ScriptedCamera(clock, "frame", 2, *[CameraTimeoutError("late")] * 2, "frame", "hang")
    task = asyncio.create_task(acquire(camera, AllFrames(), component))
    await clock.until(lambda: component.counters.get("lost") == 2)
    await clock.until(lambda: component.message.startswith("the driver does not return; no frame for "))
    clock.release(camera.hang)
    await clock.until(lambda: component.state is State.OK)
    await clock.stop(task)


async def test_a_camera_that_starts_to_count_anew_has_lost_nothing(
    component: Component, clock: FakeClock
) -> None:
    camera = ScriptedCamera(clock, "frame", -500, "frame", CameraLostError("unplugged"), 700, "frame")
    task = asyncio.create_task(acquire(camera, AllFrames(), component))
    await clock.until(lambda: component.counters.get("frames", 0) >= 6)
    assert "lost" not in component.counters
    await clock.stop(task)
