"""Frames whose time cannot be true: what is refused, and what the camera's health says of it."""

import asyncio
import itertools

import pytest
from support.clock import FakeClock
from support.frames import Blob, frame, light
from support.scripted_camera import AllFrames, LyingCamera, ScriptedCamera

from altd.acquisition.acquiring import StampCheck, acquire
from altd.acquisition.auto_exposure.control import ExposureControl
from altd.config import ExposureSettings
from altd.ports import CameraMistimedError, ExposureRange
from altd.records import Frame
from altd.status.health import Component, State


@pytest.mark.parametrize(
    ("off_s", "why"),
    [
        (3600.0, "stamped 3"),
        (-10.0, " s old"),
        (-1.0, " s before the one before it"),
    ],
)
async def test_a_frame_whose_time_cannot_be_true_is_counted_said_and_left_out(
    component: Component, off_s: float, why: str, clock: FakeClock
) -> None:
    camera = LyingCamera(clock, 0.0, 0.0, off_s)
    frames = AllFrames()
    task = asyncio.create_task(acquire(camera, frames, component))
    taken: list[Frame] = []
    while component.counters.get("mistimed", 0) < 1 or len(taken) < 5:
        taken += await frames.take(clock)
    assert all(earlier.t_ns < later.t_ns for earlier, later in itertools.pairwise(taken))
    assert max(frame.t_ns for frame in taken) <= clock.now_ns
    assert component.counters["mistimed"] == 1
    assert component.state is State.DEGRADED
    assert component.message.startswith("not measured: exposure 3 is ")
    assert why in component.message
    await clock.stop(task)


class SettableLyingCamera(LyingCamera):
    exposure_range = ExposureRange(0.1, 10.0, 0.0, 0.0)


async def test_a_mark_of_a_change_outlives_a_frame_whose_time_cannot_be_true(
    component: Component, clock: FakeClock
) -> None:
    camera = SettableLyingCamera(clock, 3600.0)
    exposure = ExposureControl(ExposureSettings(exposure_ms=3.0), 20.0, 20)
    frames = AllFrames()
    task = asyncio.create_task(acquire(camera, frames, component, exposure))
    (first,) = await frames.take(clock)
    assert first.changing
    await clock.until(lambda: component.counters.get("mistimed") == 1)
    await clock.stop(task)


async def test_a_frame_of_which_nobody_knows_the_time_is_counted_and_said_and_is_not_lost(
    component: Component, clock: FakeClock
) -> None:
    """Exposure 2 came and was left out; the camera stays open."""
    camera = ScriptedCamera(clock, "frame", CameraMistimedError(2, "exposure 2 came late"), 1, *["frame"] * 9)
    frames = AllFrames()
    task = asyncio.create_task(acquire(camera, frames, component))
    taken: list[Frame] = []
    while len(taken) < 5:
        taken += await frames.take(clock)
    await clock.until(lambda: component.counters.get("mistimed") == 1)
    assert "lost" not in component.counters
    assert component.message == "not measured: exposure 2 came late"
    await clock.stop(task)
    assert camera.calls.count("open") == 1


async def test_a_source_that_waits_has_a_clock_of_its_own(component: Component, clock: FakeClock) -> None:
    camera = LyingCamera(clock, *[3600.0] * 20)
    camera.waits = True
    frames = AllFrames()
    task = asyncio.create_task(acquire(camera, frames, component))
    assert len(await frames.take(clock)) == 1
    assert "mistimed" not in component.counters
    await clock.stop(task)


PIXELS = frame(light(Blob(300, 200))).pixels
S = 1_000_000_000
MS = 1_000_000
NOW = 500_000 * S


def shot(t_ns: int, sequence: int = 7) -> Frame:
    return Frame("front", sequence, t_ns, PIXELS)


@pytest.mark.parametrize("age_ns", [-99 * MS, 0, 30 * MS, 1_900 * MS])
def test_a_frame_that_was_exposed_lately_is_taken(age_ns: int) -> None:
    assert StampCheck().refusal(shot(NOW - age_ns), NOW) == ""


@pytest.mark.parametrize(
    ("t_ns", "why"),
    [
        (NOW + 3600 * S, "exposure 7 is stamped 3600.000 s ahead of the clock"),
        (NOW + 101 * MS, "exposure 7 is stamped 0.101 s ahead of the clock"),
        (NOW - 10 * S, "exposure 7 is 10.000 s old"),
        (0, "exposure 7 is 500000.000 s old"),
    ],
)
def test_a_frame_of_the_future_or_of_long_ago_is_refused_and_costs_no_other(t_ns: int, why: str) -> None:
    check = StampCheck()
    assert check.refusal(shot(NOW - 50 * MS), NOW) == ""
    assert check.refusal(shot(t_ns), NOW) == why
    assert check.refusal(shot(NOW), NOW) == ""


@pytest.mark.parametrize("back_ms", [0, 1, 200])
def test_times_that_stand_or_fall_are_refused_until_they_rise_again(back_ms: int) -> None:
    check = StampCheck()
    assert check.refusal(shot(NOW), NOW) == ""
    said = check.refusal(shot(NOW - back_ms * MS), NOW + 50 * MS)
    assert said == f"exposure 7 is stamped {back_ms / 1000:.3f} s before the one before it"
    assert check.refusal(shot(NOW + 50 * MS), NOW + 50 * MS) == ""
