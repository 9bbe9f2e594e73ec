"""Modbus RTU inclinometers: a sensor is described by a table of registers."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator

from altd.devices.settings import SERIAL, DeviceTable, Driver
from altd.files.table import Celsius, Device, Table, complaint
from altd.ports import Inclinometer

if TYPE_CHECKING:
    from altd.devices.inclinometer.registers import Sensor

_ADDRESS, _BAUD = 1, 19200
_FULL_TURN_DEG = 180.0
_ADDRESS, _BAUD = 1, 19200
_LimitDegrees = Annotated[float, Field(ge=0, le=10)]


class RegisterSettings(Table):
    """A number of an inclinometer with `driver = "modbus"`."""

    use: Literal["roll", "pitch", "temperature", "live", "identity"]
    """Use of the number; `live`: its last digits show that the sensor measures; `identity`: the constant
    ``must_be``, by which the sensor is recognised, such as its type or serial number."""
    address: Annotated[int, Field(ge=0, le=65535)]
    """Address in the request, from 0 on: that of the first register, where the number has two."""
    function: Literal[3, 4] = 4
    """3: holding register, 4: input register."""
    type: Literal["u16", "s16", "u32", "s32", "f32", "u32_swapped", "s32_swapped", "f32_swapped"] = "s16"
    """Number format; one of 32 bits has the high word first, or last with `_swapped`."""
    scale: Annotated[float, Field(ge=-1000, le=1000)] = 1.0
    """Degrees, or °C, for each count; negative: the number counts against the unit's sense."""
    must_be: Annotated[int, Field(ge=0, le=0xFFFFFFFF)] | None = None
    """Required bits of an `identity`."""

    @model_validator(mode="after")
    def _check_identity(self) -> Self:
        if (self.use == "identity") != (self.must_be is not None):
            raise complaint((("must_be",), 'belongs to use = "identity"; possible: both, or none'))
        if self.scale == 0.0:
            raise complaint((("scale",), "0 would make every angle 0; possible: any other number"))
        return self


class SensorSettings(Table):
    """An inclinometer that altd does not know, with `driver = "modbus"`: its data sheet."""

    name: Annotated[str, Field(min_length=1, max_length=64)]
    """Maker and type, for people."""
    limit_deg: Annotated[float, Field(gt=0, le=10)]
    """Limit of error of an angle, ±, degrees, between ``from_c`` and ``to_c``."""
    from_c: Celsius
    to_c: Celsius
    limit_elsewhere_deg: _LimitDegrees
    """The same at other temperatures."""
    deg_per_k: _LimitDegrees
    """Limit of the change of its zero, ± degrees per kelvin from the levelling, or from 20 °C."""
    cross_axis_deg: _LimitDegrees = 0.0
    """Limit of error from a tilt about the other axis, ±, degrees, if it is not part of ``limit_deg``."""
    range_deg: Annotated[float, Field(gt=0, le=180)]
    """Measuring range, ±, degrees; 180: a full turn."""
    roll_is: Literal["rotation", "inclination"]
    """`rotation` about the unit's axis, as of a sensor of 360°, or `inclination` of the sensor's axis, as of
    most with a range below 90°: at a pitch of 14° and a roll of 5° they differ by 0.15°."""
    sampling_s: Annotated[float, Field(gt=0, le=10)] = 0.1
    """Maximum age of a value when it is read, s."""
    registers: Annotated[tuple[RegisterSettings, ...], Field(min_length=3, max_length=32)]
    """Its numbers, a table ``[[inclinometer.sensor.registers]]`` each: one roll, one temperature, one or more
    identities, at most one pitch."""

    @model_validator(mode="after")
    def _check_registers(self) -> Self:
        numbers = {"roll": (1, 1), "temperature": (1, 1), "identity": (1, 30), "pitch": (0, 1)}
        for use, (least, most) in numbers.items():
            count = sum(of.use == use for of in self.registers)
            if not least <= count <= most:
                wanted = str(least) if least == most else f"{least} to {most}"
                text = f'{count} with use = "{use}"; possible: {wanted}'
                raise complaint((("registers",), text))
        if self.from_c >= self.to_c:
            raise complaint((("to_c",), f"{self.to_c:g} is not above from_c = {self.from_c:g}"))
        return self

    def sensor(self) -> Sensor:
        """Return the type of sensor that it describes."""
        from altd.devices.inclinometer.registers import Kind, Meaning, Register, Sensor
        from altd.ports import InclinometerAccuracy

        angles = [of for of in self.registers if of.use in ("roll", "pitch")]
        return Sensor(
            self.name,
            _ADDRESS,
            _BAUD,
            self.sampling_s,
            InclinometerAccuracy(
                self.limit_deg,
                self.from_c,
                self.to_c,
                self.limit_elsewhere_deg,
                self.cross_axis_deg,
                max((abs(of.scale) for of in angles if not of.type.startswith("f")), default=0.0),
                self.deg_per_k,
                self.range_deg if self.range_deg < _FULL_TURN_DEG else math.inf,
                self.roll_is == "inclination",
            ),
            tuple(
                Register(
                    of.address,
                    of.function,
                    Kind(of.type),
                    of.scale,
                    Meaning(of.use),
                    of.use,
                    must_be=of.must_be,
                )
                for of in self.registers
            ),
        )


class InclinometerSettings(DeviceTable):
    """The inclinometer that measures roll, by Modbus RTU on a serial port of its own.

    Without ``level``, roll is sign_roll · angle + offset_roll_deg, within ±180°. Direction and offset inside
    the sensor must be 0. Without the table roll is *not available*. Wiring, levelling, and what is shown when
    it fails: `inclinometer.md`.
    """

    about: ClassVar[Driver | None] = SERIAL
    driver: Literal["balluff_bsi_r11a0", "witmotion_wt901c485", "modbus"]
    """Balluff BSI R11A0-…-CXP360 (one axis), WitMotion WT901C485 (two axes), or one that ``sensor``
    describes."""
    sensor: SensorSettings | None = None
    """The sensor's data sheet, with `driver = "modbus"`: a table ``[inclinometer.sensor]``."""
    device: Device
    """Serial device, as in `[[serial]]`."""
    baud: Literal[4800, 9600, 19200, 38400, 57600, 115200] | None = None
    """Bits per second; default: 19200 (Balluff, modbus), 9600 (WitMotion)."""
    parity: Literal["none", "even", "odd"] = "none"
    stop_bits: Literal[1, 2] = 1
    address: Annotated[int, Field(ge=1, le=247)] | None = None
    """Modbus address; default: 1 (Balluff, modbus), 80 (WitMotion)."""
    interval_s: Annotated[float, Field(ge=0.05, le=10)] = 0.15
    """Time between readings, s."""
    max_age_s: Annotated[float, Field(ge=0.2, le=60)] = 0.8
    """Maximum age of a reading that is shown, s."""
    frozen_after_s: Annotated[float, Field(ge=0.2, le=600)] = 0.5
    """A reading that stays equal to the last digit for this time, s, is ``frozen``."""
    max_noise_deg: Annotated[float, Field(gt=0, le=10)] = 0.3
    """Readings with a larger standard deviation, degrees, are ``noisy``."""
    max_roll_deg: Annotated[float, Field(gt=0, le=90)] = 14.04
    """Roll beyond ± this angle, degrees, is out of range; by default the specified 250 mm/m, atan 0.25."""
    sign_roll: Literal[-1, 1] = 1
    """Sign of the angle. Roll is positive clockwise as seen along the beam; -1 reverses it."""
    offset_roll_deg: Annotated[float, Field(ge=-180, le=180)] = 0.0
    """Offset of roll, degrees, added after the sign."""
    sign_pitch: Literal[-1, 1] = 1
    """Sign of the second axis. Pitch is positive when the unit's rear end rises."""
    offset_pitch_deg: Annotated[float, Field(ge=-180, le=180)] = 0.0
    """Offset of pitch, degrees, added after the sign."""
    offset_sigma_deg: Annotated[float, Field(ge=0, le=10)] = 0.05
    """Standard uncertainty of both offsets, degrees; the default is that of a spirit level of 1 mm/m."""
    level: Path | None = None
    """File of `altd level`: zeros and directions of the axes, with their uncertainty, instead of offsets."""
    divergence_sigmas: Annotated[float, Field(ge=1, le=10)] = 3.0
    """Two axes: difference of the beam's inclination against gravity, in its combined standard uncertainties,
    that is reported."""
    divergence: Literal["invalid", "warning"] = "warning"
    """Effect of such a difference on a measurement: a warning, or no numbers."""

    @model_validator(mode="after")
    def _check_sensor(self) -> Self:
        if self.driver == "modbus" and self.sensor is None:
            raise complaint((("driver",), '"modbus" needs the table [inclinometer.sensor]'))
        if self.driver != "modbus" and self.sensor is not None:
            raise complaint((("sensor",), 'is for driver = "modbus"; possible: with it, or no table'))
        if self.level is not None and (self.offset_roll_deg or self.offset_pitch_deg):
            raise complaint((("level",), "contains the zeros; possible: with both offsets 0"))
        return self

    @property
    def type_name(self) -> str:
        """Type of the sensor: its driver, or the name in its data sheet."""
        return self.driver if self.sensor is None else self.sensor.name

    def inclinometer(self) -> Inclinometer:
        """Return the inclinometer."""
        from altd.devices.inclinometer.driver import ModbusInclinometer
        from altd.devices.inclinometer.registers import SENSORS

        sensor = SENSORS[self.driver] if self.sensor is None else self.sensor.sensor()
        return ModbusInclinometer(self, sensor)
