"""Reads a thermometer at intervals in a separate thread: a sensor on a slow bus may hang."""

from __future__ import annotations

from altd.ports import (
    CameraError,
    CameraRefusedError,
    Clock,
    TemperatureCamera,
    Thermometer,
    ThermometerError,
)
from altd.runtime.supervision import Limits, Works, complaint_of, keep
from altd.runtime.threads import DeviceThread
from altd.status.health import Component, State

READ_INTERVAL_S = 1.5
"""Time between two readings, shorter than the maximum age of a figure of health."""

_ANSWER_TIMEOUT_S = 0.4
_HEARTBEAT_S = 10.0
_NONE = "none is reported"
_POSSIBLE_CELSIUS = (-60.0, 150.0)
"""Limits of a plausible temperature; a value outside means a broken wire."""


class CameraThermometer:
    """Thermometer inside a camera; a camera without a sensor or a missing camera is not its failure."""

    def __init__(self, camera: TemperatureCamera) -> None:
        self.name = f"camera {camera.name}"
        """Name of the thermometer, unique: names of thermometers in the config have no space."""
        self._camera = camera

    def celsius(self) -> float | None:
        """Return the temperature now, °C; raises ThermometerError if the camera refuses the request."""
        try:
            return self._camera.celsius()
        except CameraRefusedError as error:
            raise ThermometerError(str(error)) from error
        except CameraError:
            return None  # its own component reports it


async def watch_temperature(thermometer: Thermometer, component: Component, clock: Clock) -> None:
    """Keep a component's figure ``celsius`` up to date until cancelled; failures are reported there."""
    component.expect(_HEARTBEAT_S)
    thread = DeviceThread(component.name)
    lowest, highest = _POSSIBLE_CELSIUS

    async def read_on(works: Works) -> None:
        while True:
            celsius = await thread.call(thermometer.celsius, within_s=_ANSWER_TIMEOUT_S)
            if celsius is not None and not lowest <= celsius <= highest:
                raise ThermometerError(f"{celsius:.1f} C cannot be")
            works()
            component.observe({"celsius": None if celsius is None else round(celsius, 1)})
            component.set_state(State.OK, _NONE if celsius is None else "")
            await clock.sleep(READ_INTERVAL_S)

    def failed(error: Exception, _: int) -> str:
        sentence = complaint_of(
            error, ThermometerError, f"the sensor does not answer within {_ANSWER_TIMEOUT_S:g} s"
        )
        component.observe({"celsius": None})
        component.set_state(State.FAILED, sentence)
        return sentence

    try:
        await keep(component.name, read_on, failed, Limits(READ_INTERVAL_S, READ_INTERVAL_S), clock)
    finally:
        await thread.end(lambda: None, _ANSWER_TIMEOUT_S)
