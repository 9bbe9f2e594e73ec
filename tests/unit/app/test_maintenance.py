"""The daemon's watches for maintenance, put together as its config says."""

import asyncio
from collections.abc import Mapping
from dataclasses import replace
from unittest.mock import Mock

import pytest
from support import evidence
from support.located import located

from altd.app.maintenance import MaintenanceWatches
from altd.config import Config
from altd.ports import Camera, CameraLostError, TemperatureCamera
from altd.runtime.clock import SystemClock
from altd.status.health import Health
from altd.vision.dust import DustCount


def config(**of_front: object) -> Config:
    """A GigE Vision camera at the front, and one of the kernel's at the rear."""
    return Config.model_validate(
        {
            "unit": {"serial": "TEST-1", "calibration": "unused.json"},
            "targets": [
                {"name": "front", "camera": "left", "z_mm": 0.0},
                {"name": "rear", "camera": "right", "z_mm": 280.0},
            ],
            "cameras": {
                "left": {"driver": "aravis", "device": "192.0.2.1", **of_front},
                "right": {"driver": "v4l2", "device": "/dev/video0"},
            },
        }
    )


def cameras(*celsius: float | Exception | None) -> Mapping[str, Camera]:
    left = Mock(spec=TemperatureCamera)
    left.name = "left"
    left.celsius.side_effect = celsius
    return {"left": left, "right": Mock(spec=Camera)}


async def told(settings: Config, celsius: float | Exception | None) -> tuple[Health, list[str]]:
    """The components, and the causes once the temperatures were read."""
    health = Health(SystemClock())
    watches = MaintenanceWatches(settings, evidence.calibration(), cameras(celsius), health, SystemClock())
    async with asyncio.TaskGroup() as tasks:
        running = tasks.create_task(started(watches))
        async with asyncio.timeout(60):
            while any(component.state == "starting" for component in health) or not list(health):  # noqa: ASYNC110
                await asyncio.sleep(0.01)
        causes = [f"{one.kind} {one.of} {one.detail}" for watch in watches.watches for one in watch(0)]
        running.cancel()
    return health, [cause for cause in causes if cause.startswith("too_")]


async def started(watches: MaintenanceWatches) -> None:
    async with asyncio.TaskGroup() as tasks:
        watches.start(tasks)


@pytest.mark.parametrize(
    ("celsius", "limits", "causes"),
    [
        (60.0, {}, []),
        (60.4, {}, ["too_hot camera left 60.4 C"]),
        (-10.6, {}, ["too_cold camera left -10.6 C"]),
        (60.4, {"max_celsius": 75.0}, []),
        (4.0, {"min_celsius": 5.0}, ["too_cold camera left 4.0 C"]),
    ],
)
async def test_a_cameras_own_temperature_has_its_limits(
    celsius: float, limits: dict[str, float], causes: list[str]
) -> None:
    health, said = await told(config(**limits), celsius)
    assert said == causes
    assert [component.name for component in health] == ["temperature camera left"]
    assert health.component("temperature camera left").figures == {"celsius": celsius}


@pytest.mark.parametrize("answer", [None, CameraLostError("the camera is not open")])
async def test_a_camera_without_a_temperature_or_that_is_away_is_no_cause(answer: Exception | None) -> None:
    health, said = await told(config(), answer)
    assert said == []
    component = health.component("temperature camera left")
    assert (component.state, component.figures) == ("ok", {"celsius": None})


def test_the_thermometer_of_the_frame_is_the_named_one() -> None:
    named = {"driver": "hwmon", "name": "frame", "chip": "tmp102"}
    settings = config().model_dump() | {"thermometers": [named], "installation": {"thermometer": "frame"}}
    health = Health(SystemClock())
    parts = evidence.calibration(), cameras(), health, SystemClock()
    watches = MaintenanceWatches(Config.model_validate(settings), *parts)
    assert watches.frame_celsius() is None, "not read yet"
    health.component("temperature frame").observe({"celsius": 31.5})
    assert watches.frame_celsius() == 31.5
    assert MaintenanceWatches(config(), *parts).frame_celsius() is None


def test_dust_under_the_spots_of_a_camera_is_told_of_its_target() -> None:
    health = Health(SystemClock())
    watches = MaintenanceWatches(config(), evidence.calibration(), cameras(), health, SystemClock())
    for number in range(60):
        watches.trends.add(replace(located("left", number, number * 5 * 10**9), dust=DustCount(0, 1000)))
        watches.trends.add(replace(located("right", number, number * 5 * 10**9), dust=DustCount(1, 1000)))
    causes = [(str(cause.kind), cause.of) for watch in watches.watches for cause in watch(0)]
    assert ("dusty", "rear") in causes
    assert ("dusty", "front") not in causes
