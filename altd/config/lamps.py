"""The frame LEDs and the lamps on the housing."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from altd.config.complaints import complaint
from altd.config.table import GpioLineName, Name, Table


class GpiodLampsSettings(Table):
    """The frame LEDs on lines of a GPIO chip."""

    driver: Literal["gpiod"]
    chip: Annotated[str, Field(min_length=1, max_length=64)]
    """The chip's label (or its name or path), as `altd devices` shows it."""
    lines: Annotated[tuple[GpioLineName, ...], Field(min_length=1)]
    """The lines by name, or by number where the chip has no names; all are switched together."""
    active_low: bool = False
    """The LEDs are lit when the line is low."""


class CameraLampsSettings(Table):
    """The frame LEDs on an output line of the cameras (GenICam LineSelector, UserOutputValue)."""

    driver: Literal["camera"]
    cameras: Annotated[tuple[Name, ...], Field(min_length=1)]
    """The cameras, names under ``[cameras]``, whose output switches LEDs; all are switched together."""
    line: Annotated[str, Field(min_length=1, max_length=64)] = "Line1"
    """The camera's own name of the output line."""


AnyLampsSettings = Annotated[GpiodLampsSettings | CameraLampsSettings, Field(discriminator="driver")]


class IndicatorsSettings(Table):
    """The four lamps on the housing, on lines of a GPIO chip. A lamp without a line is left out."""

    driver: Literal["gpiod"]
    chip: Annotated[str, Field(min_length=1, max_length=64)]
    """The chip's label (or its name or path), as `altd devices` shows it."""
    data: GpioLineName | None = None
    """The line of the lamp that flashes when data was given to whoever asked for it."""
    error: GpioLineName | None = None
    """Lit while nothing valid is measured; blinks while it is and a part has failed or wants maintenance."""
    power: GpioLineName | None = None
    """Lit while the daemon runs."""
    ok: GpioLineName | None = None
    """Lit while the measurement is valid; blinks while it warms up, or is valid with a warning."""
    active_low: bool = False
    """The lamps are lit when the line is low."""

    @property
    def lines(self) -> dict[str, str]:
        """The lines of the lamps that have one, by the lamp's key."""
        named = {"data": self.data, "error": self.error, "power": self.power, "ok": self.ok}
        return {lamp: line for lamp, line in named.items() if line is not None}

    @model_validator(mode="after")
    def _has_a_line(self) -> Self:
        if not self.lines:
            raise complaint(((), "no lamp has a line; possible: data, error, power, ok, or no table at all"))
        return self
