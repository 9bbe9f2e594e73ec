"""Temperatures of the kernel's hwmon: files under /sys/class/hwmon (Documentation/hwmon/sysfs-interface)."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from altd.devices.settings import DeviceTable
from altd.files.table import Celsius, Name
from altd.ports import Thermometer, ThermometerError

_ROOT = Path("/sys/class/hwmon")
_MAX_BYTES = 64
"""Maximum number of bytes read from a file: its content is a short name or a number."""


class HwmonThermometerSettings(DeviceTable):
    """A temperature of the kernel's hwmon. One table a temperature: `reasons.md`."""

    driver: Literal["hwmon"]
    name: Name
    """Name in all outputs."""
    chip: Annotated[str, Field(min_length=1, max_length=64)]
    """Content of the chip's file `name`, as in `/sys/class/hwmon/hwmon0/name`."""
    channel: Annotated[int, Field(ge=1, le=99)] = 1
    """Number of the channel, as in `temp1_input`."""
    min_celsius: Celsius = -10.0
    """Temperature below which the unit is out of specification, °C."""
    max_celsius: Celsius = 60.0
    """Temperature above which the unit is out of specification, °C. A processor may be allowed more."""

    def thermometer(self) -> Thermometer:
        """Return the thermometer."""
        return HwmonThermometer(self)


class HwmonThermometer:
    """One temperature. Its chip is found by name at each reading, because the chips' numbers may change."""

    def __init__(self, settings: HwmonThermometerSettings, root: Path = _ROOT) -> None:
        self.name = settings.name
        self._settings = settings
        self._root = root

    def celsius(self) -> float:
        """Return the current temperature, °C; blocks. Raises ThermometerError."""
        chip, channel = self._settings.chip, self._settings.channel
        found = [folder for folder in self._folders() if _read(folder / "name") == chip]
        if not found:
            raise ThermometerError(f"not found: no hwmon chip {chip!r}")
        if len(found) > 1:
            raise ThermometerError(f"{len(found)} hwmon chips have the name {chip!r}")
        (folder,) = found
        if _read(folder / f"temp{channel}_fault") == "1":
            raise ThermometerError(f"{chip} temp{channel}: the chip reports a broken sensor")
        text = _read(folder / f"temp{channel}_input")
        if text is None:
            raise ThermometerError(f"{chip} temp{channel}: cannot be read")
        if not text.removeprefix("-").isdecimal():
            raise ThermometerError(f"{chip} temp{channel}: {text[:20]!r} is not a temperature")
        return int(text) * 1e-3

    def _folders(self) -> list[Path]:
        try:
            return sorted(self._root.iterdir())
        except OSError:
            return []


def _read(path: Path) -> str | None:
    """Content of a file; None when it is missing or cannot be read."""
    try:
        with path.open("rb") as file:
            return file.read(_MAX_BYTES).decode("ascii", "replace").strip()
    except OSError:
        return None
