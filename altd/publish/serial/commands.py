"""The commands of the console: each takes words and returns text.

``*IDN? *STB? *TST?`` have the form of IEEE 488.2-1992, 10, for programs; each answer is one line. The port
echoes and has a prompt, as for a person: a program reads the line after its own.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from textwrap import fill
from typing import NamedTuple

from altd.errors import shown_in
from altd.publish.serial.parts_text import (
    SPANS_S,
    Past,
    calibration_text,
    health_text,
    history_text,
    log_text,
    spots_text,
)
from altd.publish.serial.words import WIDTH, measurement_text, status_text, watch_head, watch_line
from altd.reasons import Signal
from altd.records import utc_text
from altd.selfcheck.records import Verdict
from altd.status.services import SelfCheckReport
from altd.status.unit import PublishedUnit, UnitFacts, UnitView

_MAKER = "altd"
_SUMMARY_BIT = 6
_NOT_VALID_BIT = 7
_BIT_OF_SIGNAL = {
    Signal.MAINTENANCE_REQUIRED: 0,
    Signal.OUT_OF_SPECIFICATION: 1,
    Signal.CHECK_FUNCTION: 2,
    Signal.FAILURE: 3,
}


class Row(NamedTuple):
    """A number and its meaning."""

    number: int
    means: str


STATUS_BITS = (
    *(Row(bit, f"a cause of `{signal}` is present") for signal, bit in _BIT_OF_SIGNAL.items()),
    Row(4, "always 0: no answer is queued (MAV)"),
    Row(5, "always 0: there is no event register (ESB)"),
    Row(_SUMMARY_BIT, "any of the others (MSS)"),
    Row(_NOT_VALID_BIT, "no valid measurement"),
)
"""Bits of the status byte. IEEE 488.2, 11.2: the standard defines bits 4 to 6, the device the others."""

TEST_RESULTS = {Verdict.GOOD: 0, Verdict.SUSPECT: 1, Verdict.BAD: 2, Verdict.UNKNOWN: 3}
"""Results by the verdict of the last self-check."""
NO_TEST = 4
"""Result if there was no self-check since the start, or the unit cannot check itself."""


def identification(facts: UnitFacts) -> str:
    """Maker, kind, serial number and version, separated by commas (10.14)."""
    return ",".join(map(_field, (_MAKER, facts.product, facts.serial or "0", facts.version or "0")))


def status_byte(view: UnitView) -> int:
    """Status byte (10.36) from the currently shown causes and the latest measurement."""
    byte = sum({1 << _BIT_OF_SIGNAL[shown.signal] for shown in view.causes if shown.signal in _BIT_OF_SIGNAL})
    if view.measurement is None or not view.measurement.valid:
        byte |= 1 << _NOT_VALID_BIT
    return byte | bool(byte) << _SUMMARY_BIT


def test_result(report: SelfCheckReport | None) -> int:
    """Verdict of the last self-check as a number (10.38); starts none, because that is requested by hand."""
    return NO_TEST if report is None else TEST_RESULTS[report.check.verdict]


def _field(text: str) -> str:
    """ASCII text in which separators of fields and answers are replaced."""
    fits = (letter.isascii() and letter.isprintable() and letter not in ",;" for letter in text)
    return "".join(letter if fit else "_" for letter, fit in zip(text, fits, strict=True))


WATCH_INTERVAL_LIMITS_S = (0.1, 3600.0)
"""Shortest and longest interval of ``watch``."""
SELF_CHECK_TIMEOUT_S = 15.0


@dataclass(frozen=True, slots=True)
class Sources:
    """The unit that commands describe, and its past."""

    unit: PublishedUnit
    past: Past | None = None


@dataclass(frozen=True, slots=True)
class Watch:
    """The answer continues: after ``text`` follows a line every ``interval_s``, until a key."""

    text: str
    interval_s: float


@dataclass(frozen=True, slots=True)
class Question:
    """A question before a change, which is made only after a ``y``."""

    text: str
    do: Callable[[], str | Later]


@dataclass(frozen=True, slots=True)
class Later:
    """An answer that has to be looked up first."""

    find: Callable[[], Awaitable[str]]


Answer = str | Watch | Question | Later


class UsageError(Exception):
    """A line that is not a command; the message is for the person who typed it."""


@dataclass(frozen=True, slots=True)
class Command:
    """One command; ``argument`` describes what may follow its name."""

    name: str
    argument: str
    does: str
    run: Callable[..., Answer]

    @property
    def usage(self) -> str:
        """The command as it is typed."""
        return f"{self.name} {self.argument}".rstrip()


def answer_to(sources: Sources, name: str, arguments: list[str]) -> Answer:
    """Return the output of a command; raises UsageError."""
    command = _BY_NAME.get(name.lower())
    if command is None:
        raise UsageError(f"no command {name[:24]!r}; type help for the commands")
    if len(arguments) > bool(command.argument):
        raise UsageError(f"too many arguments for {name}; usage: {command.usage}")
    return command.run(sources, *arguments)


def _help(_: Sources) -> str:
    return "\n".join(f"{command.usage:<20}{command.does}" for command in COMMANDS.values())


def _status(sources: Sources, whole: str = "") -> str:
    if whole.lower() not in ("", "all"):
        raise UsageError(f"usage: status [all], not {whole[:24]!r}")
    return status_text(sources.unit.view(), whole=bool(whole))


def _measure(sources: Sources) -> str:
    return measurement_text(sources.unit.board.read(), sources.unit.board.age_s())


def _spots(sources: Sources) -> str:
    return spots_text(sources.unit.view())


def _health(sources: Sources) -> str:
    return health_text(sources.unit.view())


def _calibration(sources: Sources) -> str:
    return calibration_text(sources.unit.view())


def _version(sources: Sources) -> str:
    facts = sources.unit.facts
    return f"altd {facts.version or 'of unknown version'}, unit {facts.serial or 'not known'}"


def _self_check(sources: Sources, now: str = "") -> str | Question:
    service = sources.unit.self_check
    if now.lower() not in ("", "now"):
        raise UsageError(f"usage: selfcheck [now], not {now[:24]!r}")
    if service.unavailable:
        return _none(service.unavailable)
    if now:
        return Question("The frame LEDs will light briefly. Start?", lambda: _ask(sources))
    if service.latest is None:
        return "no self-check since the unit started"
    return _result(service.latest)


def _ask(sources: Sources) -> str | Later:
    service = sources.unit.self_check
    if service.unavailable:  # it may have become unavailable meanwhile
        return _none(service.unavailable)
    number = service.ask("console")

    async def result() -> str:
        try:
            async with asyncio.timeout(SELF_CHECK_TIMEOUT_S):
                return _result(await service.report(number))
        except TimeoutError:
            return f"not finished within {SELF_CHECK_TIMEOUT_S:g} s; see status, then type selfcheck"

    return Later(result)


def _result(report: SelfCheckReport) -> str:
    time = "" if report.time is None else f"{utc_text(report.time)}: "
    return fill(shown_in("ascii", f"{time}{report.check.sentence}"), WIDTH, subsequent_indent="  ")


def _none(why: str) -> str:
    return fill(f"no self-check: {why}", WIDTH, subsequent_indent="  ")


def _history(sources: Sources, span: str = "hour") -> str | Later:
    span, past = span.lower(), sources.past
    if span not in SPANS_S:
        raise UsageError(f"usage: history [{'|'.join(SPANS_S)}], not {span[:24]!r}")
    if past is None:
        return _NO_PAST
    return Later(lambda: history_text(past, sources.unit.board.quantities, span))


def _log(sources: Sources) -> str:
    return _NO_PAST if sources.past is None else log_text(sources.past)


def _leave(_: Sources) -> str:
    return (
        "No session to end: no login is needed, and the unit continues to measure.\n"
        "Close your terminal: picocom Ctrl-A Ctrl-X, minicom Ctrl-A X, screen Ctrl-A K"
    )


def _watch(sources: Sources, seconds: str = "1") -> Watch:
    shortest, longest = WATCH_INTERVAL_LIMITS_S
    try:
        interval_s = float(seconds)
    except ValueError:
        interval_s = -1.0
    if not shortest <= interval_s <= longest:
        raise UsageError(f"watch needs seconds from {shortest:g} to {longest:g}, not {seconds!r}")
    lines = [
        "any key ends it",
        watch_head(sources.unit.board.quantities),
        watch_line(sources.unit.board.read()),
    ]
    return Watch("\n".join(lines), interval_s)


def _identification(sources: Sources) -> str:
    return identification(sources.unit.facts)


def _status_byte(sources: Sources) -> str:
    return str(status_byte(sources.unit.view()))


def _test(sources: Sources) -> str:
    return str(test_result(sources.unit.self_check.latest))


_NO_PAST = "this daemon stores no history"

COMMANDS = {
    command.name: command
    for command in (
        Command("help", "", "list the commands", _help),
        Command("status", "[all]", "state of the unit, causes and remedies; all: more", _status),
        Command("measure", "", "the latest measurement with its sigma then and now", _measure),
        Command("watch", "[SECONDS]", "a measurement every second, or every SECONDS, until a key", _watch),
        Command("spots", "", "positions of the laser spots, and the cameras", _spots),
        Command("health", "", "the parts of the unit, with their messages and counters", _health),
        Command("selfcheck", "[now]", "result of the last self-check; now: check again", _self_check),
        Command("calibration", "", "date and origin, expected sigma, valid area", _calibration),
        Command("history", "[day|month]", "the means of the last hour, day or month", _history),
        Command("log", "", "events of the unit, the newest first", _log),
        Command("version", "", "the software's version and the unit's serial number", _version),
        Command("exit", "", "how to close your terminal program", _leave),
        Command("quit", "", "the same", _leave),
        Command("?", "", "the same as help", _help),
        Command("*IDN?", "", "for programs: maker, kind, serial number, version", _identification),
        Command("*STB?", "", "for programs: the status byte as a number", _status_byte),
        Command("*TST?", "", "for programs: the last self-check as a number, 0 is good", _test),
    )
}
_BY_NAME = {name.lower(): command for name, command in COMMANDS.items()}
