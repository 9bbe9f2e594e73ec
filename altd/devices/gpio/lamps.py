"""Frame LEDs and indicators on GPIO lines."""

from __future__ import annotations

from altd.config import GpiodLampsSettings, IndicatorsSettings
from altd.devices.gpio.lines import OutputLines
from altd.ports import Indicator


class GpioFrameLamps:
    """See ``altd.ports.Lamps``: the lines of one chip, switched in one call."""

    def __init__(self, settings: GpiodLampsSettings) -> None:
        self._names = settings.lines
        self._lines = OutputLines(settings.chip, settings.lines, settings.active_low)

    def open(self) -> None:
        """Get hold of the lines, dark; raises LampsError."""
        self._lines.open()

    def switch(self, on: bool) -> None:
        """Light or darken all LEDs; raises LampsError."""
        self._lines.set(self._names if on else ())

    def close(self) -> None:
        """Darken the LEDs and let go of the lines."""
        self._lines.close()


class GpioIndicators:
    """See ``altd.ports.Indicators``; an indicator without a line is left out."""

    def __init__(self, settings: IndicatorsSettings) -> None:
        self._names = {Indicator(key): line for key, line in settings.lines.items()}
        self._lines = OutputLines(settings.chip, tuple(self._names.values()), settings.active_low)

    def open(self) -> None:
        """Get hold of the lines, dark; raises LampsError."""
        self._lines.open()

    def show(self, lit: frozenset[Indicator]) -> None:
        """Light these and darken the others; raises LampsError."""
        self._lines.set([line for indicator, line in self._names.items() if indicator in lit])

    def close(self) -> None:
        """Darken the lamps and let go of the lines."""
        self._lines.close()
