"""The inclinometer that measures roll."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from altd.config.table import Device, Table


class InclinometerSettings(Table):
    """The inclinometer that measures roll, by Modbus RTU on a serial port of its own.

    Roll is sign_roll · angle + offset_roll_deg, brought to ±180°; the direction and offset that the sensor
    itself can be set to must be 0.
    """

    driver: Literal["balluff_bsi_r11a0", "witmotion_wt901c485"]
    """The sensor: Balluff BSI R11A0-…-CXP360 (one axis) or WitMotion WT901C485 (two axes)."""
    device: Device
    """The port, best by its stable name, such as /dev/serial/by-id/…"""
    baud: Literal[4800, 9600, 19200, 38400, 57600, 115200] | None = None
    """Bits per second; without it the sensor's default: 19200 (Balluff), 9600 (WitMotion)."""
    parity: Literal["none", "even", "odd"] = "none"
    stop_bits: Literal[1, 2] = 1
    address: Annotated[int, Field(ge=1, le=247)] | None = None
    """Modbus address; without it the sensor's default: 1 (Balluff), 80 (WitMotion)."""
    interval_s: Annotated[float, Field(ge=0.05, le=10)] = 0.15
    """Time from one reading to the next."""
    max_age_s: Annotated[float, Field(ge=0.2, le=60)] = 0.8
    """An older reading is not shown any more."""
    frozen_after_s: Annotated[float, Field(ge=0.2, le=600)] = 0.5
    """When all that is read stays the same to the last digit for so long, the sensor no longer measures."""
    max_noise_deg: Annotated[float, Field(gt=0, le=10)] = 0.3
    """A larger scatter of the readings (standard deviation) is no measurement."""
    max_roll_deg: Annotated[float, Field(gt=0, le=90)] = 45.0
    """Roll beyond ± this is out of range."""
    sign_roll: Literal[-1, 1] = 1
    """-1 where the sensor counts against the unit: roll is positive clockwise as seen along the beam."""
    offset_roll_deg: Annotated[float, Field(ge=-180, le=180)] = 0.0
    """Added after the sign, for how the sensor is mounted."""
    sign_pitch: Literal[-1, 1] = 1
    """The same of the second axis, where there is one; positive when the unit's rear end rises."""
    offset_pitch_deg: Annotated[float, Field(ge=-180, le=180)] = 0.0
    max_divergence_deg: Annotated[float, Field(gt=0, le=10)] = 0.5
    """With two axes: a slow change of the beam's inclination against gravity by more is warned of."""
