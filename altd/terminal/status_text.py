"""``altd status``: one unit on one screen, as plain text that a pipe takes."""

from __future__ import annotations

from collections.abc import Iterator

from altd.records import counted
from altd.status.health import duration
from altd.terminal.documents import Reading, SelfCheckDocument, StatusDocument
from altd.terminal.lines import (
    WIDTH,
    availability_text,
    cause_text,
    hanging,
    number_text,
    self_check_text,
    state_text,
    verdict_text,
)

_INDENT = 13
_MAX_NAME = 40
_FINE = ("good", "maintenance_required")
"""States in which the numbers may be used: those of the unit's own table that ask for nothing now."""


def is_fine(reading: Reading | None, status: StatusDocument) -> bool:
    """Whether the unit measures and its state is good or asks for no more than maintenance."""
    return reading is not None and reading.valid and status.state.signal in _FINE


def status_text(reading: Reading | None, status: StatusDocument, check: SelfCheckDocument) -> str:
    """The unit, its state with causes and remedies, the numbers, availability, self-check, components."""
    return "\n".join([*_unit(status), *_measured(reading), *_further(status, check), *_components(status)])


def _unit(status: StatusDocument) -> Iterator[str]:
    unit = f"{status.serial}, altd {status.version}, calibration {status.calibration}"
    yield from hanging("unit", unit, WIDTH, _INDENT)
    state = status.state
    yield from hanging("state", f"{state_text(state.signal)} for {duration(state.for_s)}", WIDTH, _INDENT)
    for cause in state.causes:
        yield from hanging("  -", cause_text(cause), WIDTH, 4)


def _measured(reading: Reading | None) -> Iterator[str]:
    yield ""
    if reading is None:
        yield from hanging("measuring", "NO: nothing was measured so far", WIDTH, _INDENT)
        return
    age = "of unknown age" if reading.age_s is None else f"{reading.age_s:.2f} s old"
    said = f"{age}, mean of {counted(reading.frames, 'exposure')}, number {reading.sequence}"
    text = ", ".join(filter(None, [verdict_text(reading), said, reading.time]))
    yield from hanging("measuring", text, WIDTH, _INDENT)
    yield from (f"  {number_text(number, reading.valid)}" for number in reading.numbers)


def _further(status: StatusDocument, check: SelfCheckDocument) -> Iterator[str]:
    yield ""
    yield from hanging("available", availability_text(status), WIDTH, _INDENT)
    yield from hanging("self-check", self_check_text(check), WIDTH, _INDENT)


def _components(status: StatusDocument) -> Iterator[str]:
    if not status.components:
        return
    column = min(max(map(len, status.components)), _MAX_NAME) + 2
    yield ""
    yield f"{'component':<{column}}{'state':<10}for"
    for name, component in status.components.items():
        yield f"{name[:_MAX_NAME]:<{column}}{component.state[:9]:<10}{duration(component.for_s)}"
        if component.state not in ("ok", "starting") and component.message:
            yield from hanging("", component.message, WIDTH, 4)
