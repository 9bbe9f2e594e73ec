"""Modbus RTU inclinometers: a sensor is described by a table of registers."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from altd.devices.settings import SERIAL, DeviceTable, Driver
from altd.files.table import Device
from altd.ports import Inclinometer


class InclinometerSettings(DeviceTable):
    """The inclinometer that measures roll, by Modbus RTU on a serial port of its own.

    Roll is sign_roll · angle + offset_roll_deg, within ±180°. Direction and offset inside the sensor must be
    0. Without the table roll is *not available*. Wiring, and what is shown when it fails: `inclinometer.md`.
    """

    about: ClassVar[Driver | None] = SERIAL
    driver: Literal["balluff_bsi_r11a0", "witmotion_wt901c485"]
    """Balluff BSI R11A0-…-CXP360 (one axis) or WitMotion WT901C485 (two axes)."""
    device: Device
    """Serial device, as in `[[serial]]`."""
    baud: Literal[4800, 9600, 19200, 38400, 57600, 115200] | None = None
    """Bits per second; default: 19200 (Balluff), 9600 (WitMotion)."""
    parity: Literal["none", "even", "odd"] = "none"
    stop_bits: Literal[1, 2] = 1
    address: Annotated[int, Field(ge=1, le=247)] | None = None
    """Modbus address; default: 1 (Balluff), 80 (WitMotion)."""
    interval_s: Annotated[float, Field(ge=0.05, le=10)] = 0.15
    """Time between readings, s."""
    max_age_s: Annotated[float, Field(ge=0.2, le=60)] = 0.8
    """Maximum age of a reading that is shown, s."""
    frozen_after_s: Annotated[float, Field(ge=0.2, le=600)] = 0.5
    """A reading that stays equal to the last digit for this time, s, is ``frozen``."""
    max_noise_deg: Annotated[float, Field(gt=0, le=10)] = 0.3
    """Readings with a larger standard deviation, degrees, are ``noisy``."""
    max_roll_deg: Annotated[float, Field(gt=0, le=90)] = 45.0
    """Roll beyond ± this angle, degrees, is out of range."""
    sign_roll: Literal[-1, 1] = 1
    """Sign of the angle. Roll is positive clockwise as seen along the beam; -1 reverses it."""
    offset_roll_deg: Annotated[float, Field(ge=-180, le=180)] = 0.0
    """Offset of roll, degrees, added after the sign."""
    sign_pitch: Literal[-1, 1] = 1
    """Sign of the second axis. Pitch is positive when the unit's rear end rises."""
    offset_pitch_deg: Annotated[float, Field(ge=-180, le=180)] = 0.0
    """Offset of pitch, degrees, added after the sign."""
    max_divergence_deg: Annotated[float, Field(gt=0, le=10)] = 0.5
    """Two axes: limit of a slow change between the beam's pitch and gravity's, degrees."""

    def inclinometer(self) -> Inclinometer:
        """Return the inclinometer."""
        from altd.devices.inclinometer.driver import ModbusInclinometer

        return ModbusInclinometer(self)
