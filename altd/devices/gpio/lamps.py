"""Frame LEDs, glasses and indicators on GPIO lines."""

from __future__ import annotations

import contextlib
import errno
from collections.abc import Collection, Sequence

import gpiod
from gpiod.line import Direction, Value

from altd.devices.gpio import GpiodLampsSettings, GpiodSwitchesSettings, IndicatorsSettings
from altd.devices.gpio.find_chips import find_chip, find_line
from altd.ports import Indicator, LampsError

CONSUMER = "altd"
"""Consumer name that the kernel reports for our lines to other programs."""


class OutputLines:
    """Lines that only altd can switch while they are open. ``active_low``: the low level is lit."""

    def __init__(self, chip: str, lines: Sequence[str], active_low: bool) -> None:
        self._chip = chip
        self._names = tuple(lines)
        self._active_low = active_low
        self._place = f"GPIO chip {chip!r}"
        self._offsets: dict[str, int] = {}
        self._request: gpiod.LineRequest | None = None

    def open(self) -> None:
        """Request the lines, all dark; raises LampsError that names chip and line."""
        self.close()
        chip = find_chip(self._chip)
        self._place = str(chip)
        self._offsets = {name: find_line(chip, name).offset for name in self._names}
        if len(set(self._offsets.values())) < len(self._names):
            raise LampsError(f"{chip}: two of the lines {', '.join(map(repr, self._names))} are the same")
        dark = gpiod.LineSettings(
            direction=Direction.OUTPUT, active_low=self._active_low, output_value=Value.INACTIVE
        )
        try:
            self._request = gpiod.request_lines(
                str(chip.path), consumer=CONSUMER, config={tuple(self._offsets.values()): dark}
            )
        except OSError as error:
            raise LampsError(self._refusal(error)) from error

    def set(self, lit: Collection[str]) -> None:
        """Light these and darken the others; raises LampsError."""
        if self._request is None:
            raise LampsError(f"{self._place}: its lines are not open")
        values: dict[int | str, Value] = {
            offset: Value.ACTIVE if name in lit else Value.INACTIVE for name, offset in self._offsets.items()
        }
        try:
            self._request.set_values(values)
        except OSError as error:
            why = " is gone" if error.errno == errno.ENODEV else f": {error.strerror or error}"
            raise LampsError(f"{self._place}{why}") from error

    def close(self) -> None:
        """Darken and release the lines; no effect when they are not open."""
        if self._request is None:
            return
        with contextlib.suppress(LampsError):  # a removed chip cannot be switched
            self.set(())
        request, self._request = self._request, None
        request.release()

    def _refusal(self, error: OSError) -> str:
        names = ", ".join(map(repr, self._names))
        if error.errno != errno.EBUSY:
            return f"{self._place}: {names} cannot be used as outputs: {error.strerror or error}"
        chip = find_chip(self._chip)
        taken: dict[str, list[str]] = {}
        for name in self._names:
            if (holder := find_line(chip, name).used_by) is not None:
                taken.setdefault(holder, []).append(repr(name))
        if not taken:
            return f"{chip}: one of {names} was taken by another program"
        each = (f"{', '.join(lines)} taken by {_holder_name(holder)}" for holder, lines in taken.items())
        return f"{chip}: {'; '.join(each)}"


def _holder_name(holder: str) -> str:
    return f"{holder!r}, the daemon or one of its commands" if holder == CONSUMER else repr(holder)


class GpioFrameLamps(OutputLines):
    """See ``altd.ports.Lamps``: the lines of one chip, switched in one call."""

    def __init__(self, settings: GpiodLampsSettings) -> None:
        super().__init__(settings.chip, settings.lines, settings.active_low)

    def switch(self, on: bool) -> None:
        """Light or darken all LEDs; raises LampsError."""
        self.set(self._names if on else ())


class GpioSwitches(OutputLines):
    """See ``altd.ports.Switches``: one line for each glass; active means that it has voltage."""

    def __init__(self, settings: GpiodSwitchesSettings, targets: Sequence[str]) -> None:
        self._line_of = dict(zip(targets, settings.lines, strict=True))
        super().__init__(settings.chip, settings.lines, settings.active_low)

    def show(self, opaque: str) -> None:
        """Apply voltage to all glasses but this one; empty: to none. Raises LampsError."""
        self.set([line for target, line in self._line_of.items() if opaque and target != opaque])


class GpioIndicators(OutputLines):
    """See ``altd.ports.Indicators``; an indicator without a line is ignored."""

    def __init__(self, settings: IndicatorsSettings) -> None:
        self._line_of = {Indicator(key): line for key, line in settings.lines.items()}
        super().__init__(settings.chip, tuple(self._line_of.values()), settings.active_low)

    def show(self, lit: frozenset[Indicator]) -> None:
        """Light these and darken the others; raises LampsError."""
        self.set([line for indicator, line in self._line_of.items() if indicator in lit])
