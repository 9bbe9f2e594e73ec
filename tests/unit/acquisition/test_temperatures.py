"""A thermometer that hangs, errs or breaks is reported in health, and its last value is not kept."""

import asyncio
import threading
from collections.abc import Callable
from unittest.mock import Mock

import pytest
from support.clock import stop

from altd.acquisition.temperatures import READ_INTERVAL_S, CameraThermometer, watch_temperature
from altd.ports import CameraError, CameraLostError, CameraRefusedError, TemperatureCamera, ThermometerError
from altd.runtime.clock import SystemClock
from altd.status.health import FIGURE_AGE_S, Component, Health, State


class Given:
    """A thermometer that does what the test says."""

    name = "housing"

    def __init__(self, read: Callable[[], float | None]) -> None:
        self.celsius = read


async def after_one_reading(read: Callable[[], float | None], before: float | None = None) -> Component:
    component = Health(SystemClock()).component("temperature housing")
    if before is not None:
        component.observe({"celsius": before})
    task = asyncio.create_task(watch_temperature(Given(read), component, component.clock))
    async with asyncio.timeout(60):
        while component.state is State.STARTING:  # noqa: ASYNC110  a component has no event
            await asyncio.sleep(0.01)
    await stop(task)
    return component


async def test_a_temperature_is_a_figure_of_its_component() -> None:
    component = await after_one_reading(lambda: 23.456)
    assert (component.state, component.figures) == (State.OK, {"celsius": 23.5})


async def test_a_sensor_that_fails_says_why_and_its_old_value_is_gone(
    caplog: pytest.LogCaptureFixture,
) -> None:
    def broken() -> float:
        raise ThermometerError("not found: no hwmon chip 'tmp102'")

    component = await after_one_reading(broken, before=20.0)
    assert (component.state, component.message) == (State.FAILED, "not found: no hwmon chip 'tmp102'")
    assert caplog.messages == ["temperature housing: not found: no hwmon chip 'tmp102'; trying again"]
    assert component.figures == {"celsius": None}


async def test_what_cannot_be_is_no_temperature_of_a_sensor_nor_of_a_camera() -> None:
    refused = of_camera(CameraRefusedError("DeviceTemperature: not readable"))
    cannot_be = (-273.0, 850.0, float("nan"))
    for read in (*(lambda celsius=each: celsius for each in cannot_be), of_camera(-274.0), refused):  # type: ignore[misc]
        component = await after_one_reading(read)
        assert component.state is State.FAILED
        assert component.figures == {"celsius": None}


def of_camera(answer: float | CameraError | None) -> Callable[[], float | None]:
    """The thermometer's reading of a camera with these answers."""
    camera = Mock(spec=TemperatureCamera)
    camera.name = "front"
    camera.celsius.side_effect = [answer]
    return CameraThermometer(camera).celsius


async def test_a_camera_without_a_temperature_or_that_is_away_is_no_fault_of_a_thermometer() -> None:
    assert (await after_one_reading(of_camera(41.0))).figures == {"celsius": 41.0}
    for none in (None, CameraLostError("the camera is not open")):
        component = await after_one_reading(of_camera(none), before=20.0)
        assert (component.state, component.message) == (State.OK, "none is reported")
        assert component.figures == {"celsius": None}


async def test_a_sensor_that_hangs_holds_nothing() -> None:
    released = threading.Event()

    def hangs() -> float:
        released.wait(60)
        return 20.0

    component = await after_one_reading(hangs)
    assert component.state is State.FAILED
    assert component.message.startswith("the sensor does not answer")
    released.set()


def test_a_reading_is_followed_by_the_next_before_it_is_too_old() -> None:
    assert READ_INTERVAL_S + 0.5 < FIGURE_AGE_S
