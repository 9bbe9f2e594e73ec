"""When the unit asks for maintenance, and the thermometers that it reads."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from altd.config.table import Celsius, Name, Table


class Maintenance(Table):
    """When the unit asks for maintenance."""

    calibration_due_days: Annotated[float, Field(gt=0, le=36500)] = 365.0
    """A calibration that is older than this is due."""
    min_light_share: Annotated[float, Field(ge=0, lt=1)] = 0.5
    """A spot with less than this share of its reference's light, for equal exposure and gain, has a weak
    laser or a dirty window. The reference is the first half hour since the daemon started; 0 switches this
    off."""
    max_dust_share: Annotated[float, Field(gt=0, le=1)] = 0.0005
    """How much of the area under a spot dust may cover that was not there at the calibration."""
    max_residual_share: Annotated[float, Field(gt=0, le=1)] = 0.5
    """How near to what makes a spot `distorted` the residuals of its fit may come."""


class HwmonThermometerSettings(Table):
    """A temperature that the kernel's hwmon tells."""

    driver: Literal["hwmon"]
    name: Name
    """The name in all outputs; small letters, digits and _."""
    chip: Annotated[str, Field(min_length=1, max_length=64)]
    """What the file `name` of the chip says, as in `/sys/class/hwmon/hwmon0/name`."""
    channel: Annotated[int, Field(ge=1, le=99)] = 1
    """The number in `temp1_input`."""
    min_celsius: Celsius = -10.0
    """Below this the unit is out of its specification; App. A.1.5 for the air around it."""
    max_celsius: Celsius = 60.0
    """Above this, likewise. A processor's own temperature may be allowed more."""
