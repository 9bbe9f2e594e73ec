from __future__ import annotations

import asyncio
import re
import time

import pytest
from support.clock import FakeClock, stop
from support.scripted_camera import ScriptedCamera, newest, until

from altd.acquisition import camera_report
from altd.acquisition.acquiring import acquire
from altd.ports import CameraLostError, CameraTimeoutError
from altd.status.health import Component, Health, State

SLOW_MACHINE_S = 0.5


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


async def test_a_single_lost_frame_is_one(component: Component) -> None:
    camera = ScriptedCamera("frame", 1, "frame")
    task = asyncio.create_task(acquire(camera, newest(), component))
    await until(lambda: component.counters.get("lost") == 1 and component.state is State.DEGRADED)
    assert component.message == "1 frame lost in the last second"
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
