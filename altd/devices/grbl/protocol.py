"""Lines of a Grbl 1.1 controller, parsed into records; no input or output.

Source: ``doc/markdown/interface.md`` and ``doc/csv`` of Grbl 1.1h.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

RESET = b"\x18"
STATUS = b"?"
HOLD = b"!"
"""Real-time commands: single bytes outside of lines, without an ``ok``."""

LOCKED = 9
HOMING_OFF = 5

ERRORS: Mapping[int, str] = MappingProxyType(
    {
        1: "a letter was expected",
        2: "a number is not readable",
        3: "no such $ command",
        4: "a value may not be negative",
        5: "homing is switched off in the controller ($22=0)",
        6: "the step pulse is too short",
        7: "its settings memory cannot be read, defaults are in force",
        8: "not while it moves",
        9: "it is locked (alarm or jog)",
        10: "soft limits need homing",
        11: "the line is too long",
        12: "the step rate is too high",
        13: "the safety door is open",
        14: "the start line is too long",
        15: "the jog leaves the travel",
        16: "no such jog",
        17: "laser mode needs a PWM output",
        20: "a command that it does not know",
        21: "two commands of one group",
        22: "no feed rate",
        23: "a whole number was expected",
        24: "two commands use the axes",
        25: "a word is repeated",
        26: "the axes are missing",
        27: "the line number is wrong",
        28: "a value is missing",
        29: "no such work coordinates",
        30: "G53 requires G0 or G1",
        31: "unused axes",
        32: "an arc without its axes",
        33: "the target is not possible",
        34: "the arc's radius is wrong",
        35: "an arc without its offsets",
        36: "unused values",
        37: "a tool offset for a wrong axis",
        38: "no such tool",
    }
)
"""Meanings of ``error:N``: the command was not executed."""

ALARMS: Mapping[int, str] = MappingProxyType(
    {
        1: "a limit switch was hit; its position is not certain any more",
        2: "the target is outside of the stage's travel (soft limit)",
        3: "it was reset while it moved; its position is not certain any more",
        4: "the probe is not in its initial state",
        5: "the probe touched nothing",
        6: "homing was interrupted",
        7: "the safety door was opened while it was homing",
        8: "homing did not get off a limit switch",
        9: "homing found no limit switch",
        10: "homing found only one of two limit switches",
    }
)
"""Meanings of ``ALARM:N``: the controller is locked until it is reset, then homed or unlocked."""


@dataclass(frozen=True, slots=True)
class Ok:
    """``ok``: the last line was accepted; a movement in it may still be under way."""


@dataclass(frozen=True, slots=True)
class Refusal:
    """``error:N``: a line was rejected."""

    code: int

    def __str__(self) -> str:
        return f"error:{self.code}, {ERRORS.get(self.code, 'unknown to this program')}"


@dataclass(frozen=True, slots=True)
class Alarm:
    """``ALARM:N``: the controller is locked."""

    code: int

    def __str__(self) -> str:
        return f"ALARM:{self.code}, {ALARMS.get(self.code, 'unknown to this program')}"


@dataclass(frozen=True, slots=True)
class Welcome:
    """Welcome message: the controller (re)started; ``version`` such as (1, 1)."""

    version: tuple[int, int]
    text: str


@dataclass(frozen=True, slots=True)
class GrblSetting:
    """One line of the response to ``$$``."""

    number: int
    value: float


@dataclass(frozen=True, slots=True)
class Message:
    """``[…]`` or the echo of a start line: text for people."""

    text: str


Point = tuple[float, float]


@dataclass(frozen=True, slots=True)
class StatusReport:
    """``<State|…>``: status report, with the positions x, y in mm that it contains.

    A report has the machine or the work position, and occasionally the offset: work = machine − offset.
    """

    state: str
    machine_mm: Point | None = None
    work_mm: Point | None = None
    offset_mm: Point | None = None


Reply = Ok | Refusal | Alarm | Welcome | GrblSetting | Message | StatusReport

_CODE = re.compile(r"(error|ALARM):(\d{1,3})")
_NUMBER = r"-?\d{1,9}\.\d{1,6}"  # up to nine digits of mm: longer numbers are noise, and might not be finite
_WELCOME = re.compile(r"Grbl(?:HAL)? (\d{1,3})\.(\d{1,3})\w* .*\[?.*help\]")
_SETTING = re.compile(r"\$(\d{1,3})=(-?\d{1,9}(?:\.\d{1,6})?)")
_STATUS = re.compile(
    r"<(Idle|Run|Hold|Jog|Alarm|Door|Check|Home|Sleep)(?::\d)?((?:\|[A-Za-z]+:[-+\w.,:]*)*)>"
)
_AXES = re.compile(rf"({_NUMBER}),({_NUMBER})(?:,{_NUMBER})*")


def parse(line: str) -> Reply | None:
    """Parse one line without its end; None if Grbl does not send it: noise, or a line corrupted by noise."""
    if line == "ok":
        return Ok()
    if coded := _CODE.fullmatch(line):
        code = int(coded[2])
        return Refusal(code) if coded[1] == "error" else Alarm(code)
    if line.startswith("<"):
        return _status(line)
    if welcome := _WELCOME.fullmatch(line):
        return Welcome((int(welcome[1]), int(welcome[2])), line)
    if setting := _SETTING.fullmatch(line):
        return GrblSetting(int(setting[1]), float(setting[2]))
    if (line.startswith("[") and line.endswith("]")) or line.startswith(">"):
        return Message(line)
    return None


def _status(line: str) -> StatusReport | None:
    report = _STATUS.fullmatch(line)
    if report is None:
        return None
    points: dict[str, Point] = {}
    for field in report[2].split("|")[1:]:
        name, _, value = field.partition(":")
        if name in ("MPos", "WPos", "WCO"):
            axes = _AXES.fullmatch(value)
            if axes is None:
                return None
            points[name] = float(axes[1]), float(axes[2])
    if ("MPos" in points) == ("WPos" in points):  # a report has exactly one of them
        return None
    return StatusReport(report[1], points.get("MPos"), points.get("WPos"), points.get("WCO"))
