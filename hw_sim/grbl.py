"""A controller that speaks Grbl 1.1 and moves an xy table in simulated time: bytes in, bytes out, a place.

What it answers was compared with Grbl 1.1h itself (``tests/hw_sim/test_grbl.py``). It knows what a stage
needs: straight moves, work coordinates, homing, soft and hard limits, hold and reset. It stops between
moves (Grbl blends them), has no overrides, arcs, probe or spindle, and its z stays where it is.
"""

from __future__ import annotations

import math
import re
from collections import deque
from dataclasses import dataclass, field

from hw_sim.grbl_motion import Move, Planner, Xy
from hw_sim.grbl_words import GrblError, words

BANNER = "Grbl 1.1h ['$' for help]"

SETTINGS = {
    0: "10", 1: "25", 2: "0", 3: "0", 4: "0", 5: "0", 6: "0", 10: "1", 11: "0.010", 12: "0.002", 13: "0",
    20: "0", 21: "0", 22: "0", 23: "0", 24: "25.000", 25: "500.000", 26: "250", 27: "1.000", 30: "1000",
    31: "0", 32: "0", 100: "250.000", 101: "250.000", 102: "250.000", 110: "500.000", 111: "500.000",
    112: "500.000", 120: "10.000", 121: "10.000", 122: "10.000", 130: "200.000", 131: "200.000",
    132: "200.000",
}  # fmt: skip
"""``$$`` of a controller as it leaves the factory: mm, mm/min, mm/s²."""

STEPS_PER_MM, REPORT_WORK, INCHES, SOFT_LIMITS, HARD_LIMITS, HOMING = 100, 10, 13, 20, 21, 22
SEEK_MM_PER_MIN, PULL_OFF_MM, RATE_MM_PER_MIN, ACCELERATION, TRAVEL_MM = 25, 27, 110, 120, 130

PLANNER_BLOCKS = 15
LATE_START_S = 0.03
"""After ``ok`` the steppers need a moment to start; a report meanwhile says ``Idle``, as Grbl's does."""
INCH_MM = 25.4
LINE_LIMIT = 80

_MOTION, _UNITS, _DISTANCE = {0, 1}, {20, 21}, {90, 91}
_ACCEPTED = {17, 40, 49, 54, 80, 94}
"""G words that ask for what is the case anyway."""
_AXIS_COMMANDS = {0, 1, 10, 92}


@dataclass(slots=True)
class _Modes:
    """What a reset puts back."""

    motion: int = 0
    inches: bool = False
    relative: bool = False
    feed_mm_per_min: float = 0.0


@dataclass(slots=True)
class Controller:
    """One controller. The caller tells the time, in s; it never runs back.

    ``walls_mm`` are where the limit switches of the table sit, (lowest x, highest x, lowest y, highest y) in
    machine coordinates; None: nowhere.
    """

    settings: dict[int, str] = field(default_factory=lambda: dict(SETTINGS))
    planner: Planner = field(default_factory=lambda: Planner((0.0, 0.0)))
    work_zero_mm: Xy = (0.0, 0.0)
    walls_mm: tuple[float, float, float, float] | None = None
    state: str = "Idle"
    _modes: _Modes = field(default_factory=_Modes)
    _line: str = ""
    _waiting: deque[str] = field(default_factory=deque)
    _sync: bool = False
    _home_until_s: float | None = None
    _blocked: bool = False
    _owes_ok: bool = False
    _reports: int = 0
    _offset_in: int = 0
    _out: list[str] = field(default_factory=list)

    def cut_power(self, t_s: float) -> None:
        """Stop dead; nothing is known any more."""
        self._advance(t_s)
        self.planner.stand(t_s)

    def power_on(self) -> str:
        """What it says when it gets power: position and modes are forgotten, the rest is not."""
        self.planner = Planner((0.0, 0.0))
        self._restart(locked=self._flag(HOMING))
        return self._said()

    def receive(self, data: bytes, t_s: float) -> str:
        """Take bytes from the line; what is answered at once."""
        self._advance(t_s)
        for byte in data:
            self._take(byte, t_s)
        self._work(t_s)
        return self._said()

    def tick(self, t_s: float) -> str:
        """Let time pass; what is said meanwhile."""
        self._advance(t_s)
        self._work(t_s)
        return self._said()

    def hit_limit(self, t_s: float) -> str:
        """A limit switch closes, wherever the table is."""
        self._advance(t_s)
        self._hard_limit(t_s)
        return self._said()

    def _said(self) -> str:
        said = "".join(f"{line}\r\n" for line in self._out)
        self._out.clear()
        return said

    def _flag(self, number: int) -> bool:
        return float(self.settings[number]) != 0

    def _take(self, byte: int, t_s: float) -> None:
        """Real-time bytes act at once, whatever else waits; the others make lines."""
        character = chr(byte)
        if byte == 0x18:
            self._reset(t_s)
        elif character == "?":
            if not self._blocked and self.state != "Home":
                self._report(t_s)
        elif character == "!":
            self._hold(t_s)
        elif character == "~":
            self._resume(t_s)
        elif byte >= 0x80:
            pass  # overrides, which it does not have
        elif character in "\r\n":
            if character == "\n" or self._line:
                self._waiting.append(self._line)
            self._line = ""
        else:
            self._line += character

    def _work(self, t_s: float) -> None:
        """Execute waiting lines while the planner has room."""
        while self._waiting and not self._blocked and self._home_until_s is None and not self._sync:
            if len(self.planner.moves) >= PLANNER_BLOCKS or self.state == "Hold":
                return
            line = self._waiting.popleft().split("(")[0].split(";")[0].replace(" ", "").upper()
            try:
                if len(line) > LINE_LIMIT:
                    raise GrblError(11)
                if self._execute(line, t_s) and not self._blocked:
                    self._out.append("ok")
            except GrblError as error:
                self._out.append(f"error:{error.code}")

    def _execute(self, line: str, t_s: float) -> bool:
        """Execute one line; whether ``ok`` is due now."""
        if line.startswith("$"):
            return self._system(line, t_s)
        if self.state == "Alarm" and line:
            raise GrblError(9)
        return self._block(line, t_s)

    def _system(self, line: str, t_s: float) -> bool:
        modes = self._modes
        if line == "$$":
            self._out += [f"${number}={value}" for number, value in self.settings.items()]
        elif line == "$#":
            zero = self._axes(0.0, 0.0)
            self._out.append(f"[G54:{self._axes(*self.work_zero_mm)}]")
            self._out += [
                f"[{name}:{zero}]" for name in ("G55", "G56", "G57", "G58", "G59", "G28", "G30", "G92")
            ]
            self._out += [f"[TLO:{zero.split(',')[0]}]", f"[PRB:{zero}:0]"]
        elif line == "$X":
            if self.state == "Alarm":
                self._out.append("[MSG:Caution: Unlocked]")
                self.state = "Idle"
        elif line == "$H":
            return self._home(t_s)
        elif line == "$G":
            words = f"G{modes.motion} G54 G17 G{20 if modes.inches else 21} G{91 if modes.relative else 90}"
            self._out.append(f"[GC:{words} G94 M5 M9 T0 F{modes.feed_mm_per_min:g} S0]")
        elif setting := re.fullmatch(r"\$(\d+)=(-?\d+\.?\d*)", line):
            self._set(int(setting[1]), setting[2])
        else:
            raise GrblError(2)
        return True

    def _set(self, number: int, value: str) -> None:
        if number not in self.settings:
            raise GrblError(3)
        if float(value) < 0:
            raise GrblError(4)
        if number == SOFT_LIMITS and float(value) and not self._flag(HOMING):
            raise GrblError(10)
        self.settings[number] = value
        if number == INCHES:
            self._offset_in = 0

    def _block(self, line: str, t_s: float) -> bool:
        """One line of G-code; only what a stage needs, the rest is error:20."""
        modes = self._modes
        codes, values = words(line)
        machine = 53 in codes
        if not codes <= _MOTION | _UNITS | _DISTANCE | _ACCEPTED | {4, 10, 53, 92}:
            raise GrblError(20)
        if len(codes & _AXIS_COMMANDS) > 1:
            raise GrblError(24)
        if len(codes & _UNITS) > 1 or len(codes & _DISTANCE) > 1:
            raise GrblError(21)
        inches = modes.inches if not codes & _UNITS else 20 in codes
        relative = modes.relative if not codes & _DISTANCE else 91 in codes
        scale = INCH_MM if inches else 1.0
        feed = values["F"] * scale if "F" in values else modes.feed_mm_per_min
        motion = next(iter(codes & _MOTION), modes.motion)
        axes = {axis: values[axis] * scale for axis in "XYZ" if axis in values}
        if 4 in codes and "P" not in values:
            raise GrblError(28)
        if codes & {10, 92}:
            self._shift(10 in codes, values, axes)
        elif 4 in codes:
            modes.inches, modes.relative, modes.feed_mm_per_min = inches, relative, feed
            self._sync = bool(self.planner.moves)
            return not self._sync
        elif axes:
            if motion == 1 and feed <= 0:
                raise GrblError(22)
            target = self._target(axes, relative, machine)
            modes.motion, modes.inches, modes.relative, modes.feed_mm_per_min = motion, inches, relative, feed
            self._plan(target, feed if motion else math.inf, t_s)
            return True
        modes.motion, modes.inches, modes.relative, modes.feed_mm_per_min = motion, inches, relative, feed
        return True

    def _shift(self, by_g10: bool, values: dict[str, float], axes: dict[str, float]) -> None:
        """G10 L2 sets the work zero, G10 L20 and (here for good) G92 the position in work coordinates."""
        if not axes:
            raise GrblError(26)
        here, zero = self.planner.target_mm, list(self.work_zero_mm)
        for index, axis in enumerate("XY"):
            if axis in axes:
                absolute = by_g10 and values.get("L") == 2
                zero[index] = axes[axis] if absolute else here[index] - axes[axis]
        self.work_zero_mm = zero[0], zero[1]
        self._offset_in = 0

    def _target(self, axes: dict[str, float], relative: bool, machine: bool) -> Xy:
        """In machine coordinates, on a whole step."""
        target = []
        for index, axis in enumerate("XY"):
            start = self.planner.target_mm[index]
            if axis not in axes:
                target.append(start)
            elif relative:
                target.append(start + axes[axis])
            else:
                target.append(axes[axis] + (0.0 if machine else self.work_zero_mm[index]))
        return target[0], target[1]

    def _plan(self, target: Xy, feed_mm_per_min: float, t_s: float) -> None:
        travel = [float(self.settings[TRAVEL_MM + axis]) for axis in (0, 1)]
        outside = any(not -length <= value <= 0.0 for value, length in zip(target, travel, strict=True))
        if self._flag(SOFT_LIMITS) and outside:
            self._alarm(2)
            return
        start = self.planner.target_mm
        steps = [float(self.settings[STEPS_PER_MM + axis]) for axis in (0, 1)]
        end = tuple(round(value * step) / step for value, step in zip(target, steps, strict=True))
        if end == start:
            return
        move = Move(
            start,
            (end[0], end[1]),
            self._limit(start, end, RATE_MM_PER_MIN, feed_mm_per_min) / 60.0,
            self._limit(start, end, ACCELERATION, math.inf),
        )
        self.planner.add(move, t_s + LATE_START_S)
        self.state = "Run"

    def _limit(self, start: Xy, end: tuple[float, ...], setting: int, most: float) -> float:
        """The largest value along the way that no axis exceeds."""
        length = math.dist(start, end)
        for axis in (0, 1):
            share = abs(end[axis] - start[axis]) / length
            if share > 0:
                most = min(most, float(self.settings[setting + axis]) / share)
        return most

    def _advance(self, t_s: float) -> None:
        """Bring moves, homing and switches up to ``t_s``."""
        if self._home_until_s is not None and t_s >= self._home_until_s:
            self._end_homing()
        if self.state == "Run":
            self._meet_walls(t_s)
            self.planner.advance(t_s)
            if self.state == "Run" and not self.planner.moves:
                self.state = "Idle"
        if self._sync and not self.planner.moves:
            self._sync = False
            self._out.append("ok")

    def _meet_walls(self, t_s: float) -> None:
        if self.walls_mm is None or not self._flag(HARD_LIMITS):
            return
        x, y = self.planner.at(t_s)
        low_x, high_x, low_y, high_y = self.walls_mm
        if not (low_x <= x <= high_x and low_y <= y <= high_y):
            self._hard_limit(t_s)

    def _hard_limit(self, t_s: float) -> None:
        if self._flag(HARD_LIMITS):
            self.planner.stand(t_s)
            self._alarm(1)

    def _alarm(self, code: int) -> None:
        """Locked until a reset; the line that was at fault gets its ``ok`` only then."""
        self._out += [f"ALARM:{code}", "[MSG:Reset to continue]"]
        self.state = "Alarm"
        self._blocked = True
        self._owes_ok = code == 2

    def _home(self, t_s: float) -> bool:
        if not self._flag(HOMING):
            raise GrblError(5)
        away = max(abs(value) for value in self.planner.place_mm)
        self.state = "Home"
        self._home_until_s = t_s + 60.0 * away / float(self.settings[SEEK_MM_PER_MIN]) + 0.1
        return False

    def _end_homing(self) -> None:
        """The table has found its switches at the upper ends and stands off them by the pull-off."""
        place = -float(self.settings[PULL_OFF_MM])
        self.planner = Planner((place, place))
        self._home_until_s = None
        self.state = "Idle"
        self._out.append("ok")

    def _hold(self, t_s: float) -> None:
        if self.state in ("Run", "Idle"):
            self.planner.hold(t_s)
            self.state = "Hold"

    def _resume(self, t_s: float) -> None:
        if self.state == "Hold" and not self._braking(t_s):
            self.planner.resume(t_s)
            self.state = "Run" if self.planner.moves else "Idle"

    def _braking(self, t_s: float) -> bool:
        return self.planner.held is not None and self.planner.moving(t_s)

    def _reset(self, t_s: float) -> None:
        """What is reset while it moves has lost steps; a hold that has ended has not."""
        moving = self.planner.moving(t_s)
        homing = self.state == "Home"
        locked = self.state == "Alarm" or moving or homing
        if moving:
            self._out.append("ALARM:3")
        elif homing:
            self._out.append("ALARM:6")
        elif self._owes_ok:
            self._out.append("ok")
        self.planner.stand(t_s)
        self._restart(locked)

    def _restart(self, locked: bool) -> None:
        self._modes = _Modes()
        self._line = ""
        self._waiting.clear()
        self._sync = self._blocked = self._owes_ok = False
        self._home_until_s = None
        self._reports = self._offset_in = 0
        self.state = "Alarm" if locked else "Idle"
        self._out.append(BANNER)
        if locked:
            self._out.append("[MSG:'$H'|'$X' to unlock]")

    def _report(self, t_s: float) -> None:
        x_mm, y_mm = self.planner.at(t_s)
        zero_x, zero_y = self.work_zero_mm
        state = self.state
        if state == "Hold":
            state += ":1" if self._braking(t_s) else ":0"
        elif state == "Run" and not self.planner.started(t_s):
            state = "Idle"
        in_machine = self.settings[REPORT_WORK] in ("1", "3")
        at = (x_mm, y_mm) if in_machine else (x_mm - zero_x, y_mm - zero_y)
        report = f"<{state}|{'MPos' if in_machine else 'WPos'}:{self._axes(*at)}|FS:0,0"
        if self._offset_in == 0:
            report += f"|WCO:{self._axes(zero_x, zero_y)}"
            self._offset_in = 30
        elif self._reports == 1:
            report += "|Ov:100,100,100"
        self._offset_in -= 1
        self._reports += 1
        self._out.append(report + ">")

    def _axes(self, x_mm: float, y_mm: float) -> str:
        if self._flag(INCHES):
            return f"{x_mm / INCH_MM:.4f},{y_mm / INCH_MM:.4f},0.0000"
        return f"{x_mm:.3f},{y_mm:.3f},0.000"
