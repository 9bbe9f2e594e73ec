"""Lamps on the lines of a GPIO chip, through the kernel's character device."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator

from altd.devices.settings import DeviceTable, Driver, Visits
from altd.files.table import GpioLineName, complaint
from altd.ports import Camera, Indicators, Lamps, Switches
from altd.process.machine import Finding, said


def _library(needed: bool) -> Finding:
    try:
        import_module("gpiod")
    except Exception as error:  # an incomplete library can raise anything
        remedy = "docs/install.md   # install the release again: the package is incomplete"
        return Finding.error("library gpiod", said(error), remedy)
    return Finding.good("library gpiod", "installed")


class GpiodTable(DeviceTable):
    """Keys of all tables with lines of a GPIO chip."""

    about: ClassVar[Driver | None] = Driver(
        "altd.devices.gpio.find_chips",
        "GPIO chips: [lamps], [indicators]",
        ("gpio", "/dev/gpiochip*"),
        _library,
    )
    chip: Annotated[str, Field(min_length=1, max_length=64)]
    """Label, name or path of the chip, as in `[lamps]`."""


class GpiodLampsSettings(GpiodTable):
    """Frame LEDs on lines of a GPIO chip. Without the table: none."""

    driver: Literal["gpiod"]
    chip: Annotated[str, Field(min_length=1, max_length=64)]
    """Label, name or path of the chip (`altd devices`)."""
    lines: Annotated[tuple[GpioLineName, ...], Field(min_length=1)]
    """Names or numbers of the lines; all are switched together."""
    active_low: bool = False
    """The LEDs are lit when the line is low."""

    def lamps(self, cameras: Mapping[str, Camera], place: Path, alone: bool = False) -> Lamps:
        """Return the lamps."""
        from altd.devices.gpio.lamps import GpioFrameLamps

        return GpioFrameLamps(self)


class GpiodSwitchesSettings(GpiodTable, Visits):
    """Voltage of the glasses, switched by lines of a GPIO chip.

    With `instrument = "chain"` alone, where cameras are live: `chain.md`.
    """

    driver: Literal["gpiod"]
    lines: Annotated[tuple[GpioLineName, ...], Field(min_length=1)]
    """One line per switched target, in their order; active: the glass has voltage and is clear."""
    active_low: bool = False
    """A glass has voltage when its line is low."""

    def switches(self, camera_of: Mapping[str, str], cameras: Mapping[str, Camera], place: Path) -> Switches:
        """Return the switches of these targets."""
        from altd.devices.gpio.lamps import GpioSwitches

        return GpioSwitches(self, list(camera_of))


class IndicatorsSettings(GpiodTable):
    """The four lamps on the housing, on lines of a GPIO chip. Lamps without a line are not used.

    Without the table: none.
    """

    driver: Literal["gpiod"]
    data: GpioLineName | None = None
    """Data lamp: flashes when a client gets data."""
    error: GpioLineName | None = None
    """Error lamp, lit: nothing valid; blinking: valid, but a part has failed or needs maintenance."""
    power: GpioLineName | None = None
    """Power lamp: lit while the daemon runs."""
    ok: GpioLineName | None = None
    """OK lamp, lit: valid; blinking: warming up, or valid with a warning."""
    active_low: bool = False
    """The lamps are lit when the line is low."""

    @property
    def lines(self) -> dict[str, str]:
        """Lines of the lamps that have one, by the lamp's key."""
        named = {"data": self.data, "error": self.error, "power": self.power, "ok": self.ok}
        return {lamp: line for lamp, line in named.items() if line is not None}

    @model_validator(mode="after")
    def _has_a_line(self) -> Self:
        if not self.lines:
            raise complaint(((), "no lamp has a line; possible: data, error, power, ok, or no table at all"))
        return self

    def indicators(self) -> Indicators:
        """Return the indicators."""
        from altd.devices.gpio.lamps import GpioIndicators

        return GpioIndicators(self)


def places(table: GpiodTable) -> dict[tuple[str | int, ...], str]:
    """Return the names of the lines, by their keys in the table."""
    if isinstance(table, GpiodLampsSettings | GpiodSwitchesSettings):
        return {("lines", number): line for number, line in enumerate(table.lines)}
    assert isinstance(table, IndicatorsSettings)  # noqa: S101  there are no others
    return {(lamp,): line for lamp, line in table.lines.items()}
