"""An xy stage behind a Grbl 1.1 controller."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from altd.devices.settings import SERIAL, DeviceTable, Driver
from altd.files.table import Device, StageMillimetres
from altd.ports import Stage


class GrblStageSettings(DeviceTable):
    """The xy stage of `altd scan`: a Grbl 1.1 controller on a serial port.

    Its target coordinates are sign · position + offset. Needed by `altd scan` alone: `calibration.md`.
    """

    about: ClassVar[Driver | None] = SERIAL
    driver: Literal["grbl"]
    """The only driver of this release."""
    device: Device
    """Serial device, as in `[[serial]]`."""
    baud: Literal[9600, 19200, 38400, 57600, 115200, 230400] = 115200
    """Bits per second."""
    start: Literal["home", "unlock"] = "home"
    """``home`` runs to the limit switches (`$H`); ``unlock`` keeps the controller's position (`$X`), for a
    stage without switches."""
    coordinates: Literal["work", "machine"] = "work"
    """Work coordinates (G54) or machine coordinates."""
    sign_x: Literal[-1, 1] = 1
    """-1 if the stage's axis is opposite to the unit's, or the stage carries the unit."""
    sign_y: Literal[-1, 1] = 1
    offset_x_mm: StageMillimetres = 0.0
    """The controller's coordinates where the beam meets (0, 0) of the unit frame, mm."""
    offset_y_mm: StageMillimetres = 0.0
    feed_mm_per_min: Annotated[float, Field(gt=0, le=100_000)] = 1000.0
    """Speed, mm/min, within the controller's limits."""
    answer_within_s: Annotated[float, Field(ge=0.1, le=60)] = 2.0
    """Time limit of a response, s; after it, a command is sent again, twice."""
    home_within_s: Annotated[float, Field(ge=1, le=3600)] = 120.0
    """Longest time of homing, s."""

    def stage(self) -> Stage:
        """Return the stage."""
        from altd.devices.grbl.driver import GrblStage

        return GrblStage(self)
