"""Commands for programs in the form of IEEE 488.2-1992, 10: ``*IDN? *STB? *TST?``, and no others of it.

Each answer is one line. The port echoes and has a prompt, as for a person: a program reads the line behind
its own.
"""

from __future__ import annotations

from typing import NamedTuple

from altd.reasons import Signal
from altd.records import Measurement
from altd.status.health import Health

_MAKER, _KIND = "altd", "Active Laser Target"
_SUMMARY_BIT = 6
_NOT_VALID_BIT = 7
_BIT_OF_SIGNAL = {
    Signal.MAINTENANCE_REQUIRED: 0,
    Signal.OUT_OF_SPECIFICATION: 1,
    Signal.CHECK_FUNCTION: 2,
    Signal.FAILURE: 3,
}


class Row(NamedTuple):
    """A number and what it means."""

    number: int
    means: str


STATUS_BITS = (
    *(Row(bit, f"a cause of `{signal}` is there") for signal, bit in _BIT_OF_SIGNAL.items()),
    Row(4, "always 0: no answer waits (MAV)"),
    Row(5, "always 0: there is no event register (ESB)"),
    Row(_SUMMARY_BIT, "any of the others (MSS)"),
    Row(_NOT_VALID_BIT, "no valid measurement"),
)
"""IEEE 488.2, 11.2: bits 4 to 6 are the standard's own, the others the device's."""

TEST_RESULTS = {"good": 0, "suspect": 1, "bad": 2, "unknown": 3}
"""By the verdict of the last self-check."""
NO_TEST = 4
"""There was no self-check since the start, or the unit cannot check itself."""


def identification(health: Health) -> str:
    """Maker, kind, serial number and version, with commas between them (10.14)."""
    facts = health.facts
    return ",".join(map(_field, (_MAKER, _KIND, facts.get("serial", "0"), facts.get("version", "0"))))


def status_byte(measurement: Measurement | None, health: Health) -> int:
    """The status byte (10.36) by the causes that are shown now and the latest measurement."""
    report = health.state()
    causes = () if report is None else report.causes
    byte = sum({1 << _BIT_OF_SIGNAL[shown.signal] for shown in causes if shown.signal in _BIT_OF_SIGNAL})
    if measurement is None or not measurement.valid:
        byte |= 1 << _NOT_VALID_BIT
    return byte | bool(byte) << _SUMMARY_BIT


def test_result(health: Health) -> int:
    """The verdict of the last self-check as a number (10.38); none is made, for that is asked for by hand."""
    latest = health.self_check.latest
    if latest is None:
        return NO_TEST
    return TEST_RESULTS.get(str(latest.document.get("verdict")), TEST_RESULTS["unknown"])


def _field(text: str) -> str:
    """ASCII without what separates fields and answers."""
    fits = (letter.isascii() and letter.isprintable() and letter not in ",;" for letter in text)
    return "".join(letter if fit else "_" for letter, fit in zip(text, fits, strict=True))
