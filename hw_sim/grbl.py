"""A controller for Grbl 1.1: bytes in, bytes out, and a machine that it moves in simulated time.

Its responses were compared with Grbl 1.1h itself (``tests/unit/hw_sim/test_grbl.py``). It supports the
functions that a stage needs: straight moves, work coordinates, homing, soft and hard limits, hold and reset.
It stops between moves (Grbl blends them), has no overrides, arcs, probe or spindle, and its z does not move.
"""

import re
from collections import deque
from dataclasses import dataclass, field, replace

from hw_sim.gcode import INCH_MM, GrblError, Modes, read_block
from hw_sim.grbl_machine import HOMING, SOFT_LIMIT_ALARM, SOFT_LIMITS, Machine

WELCOME_MESSAGE = "Grbl 1.1h ['$' for help]"

REPORT_WORK, INCHES = 10, 13
"""Numbers of Grbl's settings."""

PLANNER_BLOCKS = 15
MAX_LINE_LENGTH = 80
OFFSET_EVERY_REPORTS = 30


@dataclass(slots=True)
class Controller:
    """A controller and its machine. The caller supplies the time, in s, which must not decrease."""

    machine: Machine = field(default_factory=Machine)
    _modes: Modes = field(default_factory=Modes)
    _line: str = ""
    _waiting: deque[str] = field(default_factory=deque)
    _is_dwelling: bool = False
    _reports: int = 0
    _reports_to_offset: int = 0
    _out: list[str] = field(default_factory=list)

    def cut_power(self, t_s: float) -> None:
        """Stop abruptly; the position is lost."""
        self._advance(t_s)
        self.machine.stop_dead(t_s)

    def power_on(self) -> str:
        """Return the text sent at power-on; position and modes are reset, other state is kept."""
        self.machine.start_up()
        self._restart()
        return self._take_out()

    def receive(self, data: bytes, t_s: float) -> str:
        """Process bytes from the line; return the immediate response."""
        self._advance(t_s)
        for byte in data:
            self._take_byte(byte, t_s)
        self._execute_waiting(t_s)
        return self._take_out()

    def tick(self, t_s: float) -> str:
        """Advance the time; return the text sent meanwhile."""
        self._advance(t_s)
        self._execute_waiting(t_s)
        return self._take_out()

    def hit_limit(self, t_s: float) -> str:
        """Close a limit switch, regardless of the table's position."""
        self._advance(t_s)
        self.machine.hit_limit_switch(t_s)
        return self._take_out()

    def _take_out(self) -> str:
        self._collect_messages()
        sent = "".join(f"{line}\r\n" for line in self._out)
        self._out.clear()
        return sent

    def _collect_messages(self) -> None:
        self._out += self.machine.messages
        self.machine.messages.clear()

    def _advance(self, t_s: float) -> None:
        """Advance the machine to ``t_s``; homing and a dwell get their ``ok`` when they end."""
        was_homing = self.machine.is_homing
        self.machine.advance(t_s)
        self._collect_messages()
        if was_homing and not self.machine.is_homing:
            self._out.append("ok")
        if self._is_dwelling and not self.machine.planner.moves:
            self._is_dwelling = False
            self._out.append("ok")

    def _take_byte(self, byte: int, t_s: float) -> None:
        """Process a byte: real-time bytes act at once, ahead of waiting lines; the others form lines."""
        character = chr(byte)
        if byte == 0x18:
            self._reset(t_s)
        elif character == "?":
            if self.machine.alarm is None and self.machine.state != "Home":
                self._report(t_s)
        elif character == "!":
            self.machine.hold(t_s)
        elif character == "~":
            self.machine.resume(t_s)
        elif byte >= 0x80:
            pass  # overrides, which are not supported
        elif character in "\r\n":
            if character == "\n" or self._line:
                self._waiting.append(self._line)
            self._line = ""
        else:
            self._line += character

    def _execute_waiting(self, t_s: float) -> None:
        """Execute waiting lines while the planner has room."""
        machine = self.machine
        while self._waiting and machine.alarm is None and not machine.is_homing and not self._is_dwelling:
            if len(machine.planner.moves) >= PLANNER_BLOCKS or machine.state == "Hold":
                return
            line = self._waiting.popleft().split("(")[0].split(";")[0].replace(" ", "").upper()
            try:
                if len(line) > MAX_LINE_LENGTH:
                    raise GrblError(11)
                if self._execute(line, t_s) and machine.alarm is None:
                    self._out.append("ok")
            except GrblError as error:
                self._out.append(f"error:{error.code}")

    def _execute(self, line: str, t_s: float) -> bool:
        """Execute one line; return whether ``ok`` is due now."""
        if line.startswith("$"):
            return self._execute_system(line, t_s)
        if self.machine.state == "Alarm" and line:
            raise GrblError(9)
        return self._execute_block(line, t_s)

    def _execute_system(self, line: str, t_s: float) -> bool:
        """Execute a line that begins with ``$``."""
        machine, modes = self.machine, self._modes
        if line == "$$":
            self._out += [f"${number}={value}" for number, value in machine.settings.items()]
        elif line == "$#":
            zero = self._axes(0.0, 0.0)
            self._out.append(f"[G54:{self._axes(*machine.work_zero_mm)}]")
            self._out += [
                f"[{name}:{zero}]" for name in ("G55", "G56", "G57", "G58", "G59", "G28", "G30", "G92")
            ]
            self._out += [f"[TLO:{zero.split(',')[0]}]", f"[PRB:{zero}:0]"]
        elif line == "$X":
            if machine.state == "Alarm":
                self._out.append("[MSG:Caution: Unlocked]")
                machine.state = "Idle"
        elif line == "$H":
            machine.home(t_s)
            return False
        elif line == "$G":
            words = f"G{modes.motion} G54 G17 G{20 if modes.inches else 21} G{91 if modes.relative else 90}"
            self._out.append(f"[GC:{words} G94 M5 M9 T0 F{modes.feed_mm_per_min:g} S0]")
        elif setting := re.fullmatch(r"\$(\d+)=(-?\d+\.?\d*)", line):
            self._change_setting(int(setting[1]), setting[2])
        else:
            raise GrblError(2)
        return True

    def _change_setting(self, number: int, value: str) -> None:
        if number not in self.machine.settings:
            raise GrblError(3)
        if float(value) < 0:
            raise GrblError(4)
        if number == SOFT_LIMITS and float(value) and not self.machine.is_set(HOMING):
            raise GrblError(10)
        self.machine.settings[number] = value
        if number == INCHES:
            self._reports_to_offset = 0

    def _execute_block(self, line: str, t_s: float) -> bool:
        block = read_block(line, self._modes)
        if block.is_dwell and not block.sets_work_zero:
            self._modes = replace(block.modes, motion=self._modes.motion)
            self._is_dwelling = bool(self.machine.planner.moves)
            return not self._is_dwelling
        if block.sets_work_zero:
            self.machine.set_work_zero(block)
            self._reports_to_offset = 0
        elif block.axes_mm:
            if block.modes.motion == 1 and block.modes.feed_mm_per_min <= 0:
                raise GrblError(22)
            self.machine.move(block, t_s)
        self._modes = block.modes
        return True

    def _reset(self, t_s: float) -> None:
        """Stop and restart; the line that left the travel only now gets its ``ok``."""
        ok_pending = self.machine.alarm == SOFT_LIMIT_ALARM
        self._collect_messages()
        self.machine.reset(t_s)
        if ok_pending and not self.machine.messages:
            self._out.append("ok")
        self._collect_messages()
        self._restart()

    def _restart(self) -> None:
        self._modes = Modes()
        self._line = ""
        self._waiting.clear()
        self._is_dwelling = False
        self._reports = self._reports_to_offset = 0
        self._out.append(WELCOME_MESSAGE)
        if self.machine.state == "Alarm":
            self._out.append("[MSG:'$H'|'$X' to unlock]")

    def _report(self, t_s: float) -> None:
        machine = self.machine
        x_mm, y_mm = machine.planner.at(t_s)
        zero_x, zero_y = machine.work_zero_mm
        state = machine.state
        if state == "Hold":
            state += ":1" if machine.is_braking(t_s) else ":0"
        elif state == "Run" and not machine.planner.started(t_s):
            state = "Idle"
        in_machine = machine.settings[REPORT_WORK] in ("1", "3")
        at = (x_mm, y_mm) if in_machine else (x_mm - zero_x, y_mm - zero_y)
        report = f"<{state}|{'MPos' if in_machine else 'WPos'}:{self._axes(*at)}|FS:0,0"
        if self._reports_to_offset == 0:
            report += f"|WCO:{self._axes(zero_x, zero_y)}"
            self._reports_to_offset = OFFSET_EVERY_REPORTS
        elif self._reports == 1:
            report += "|Ov:100,100,100"
        self._reports_to_offset -= 1
        self._reports += 1
        self._out.append(report + ">")

    def _axes(self, x_mm: float, y_mm: float) -> str:
        if self.machine.is_set(INCHES):
            return f"{x_mm / INCH_MM:.4f},{y_mm / INCH_MM:.4f},0.0000"
        return f"{x_mm:.3f},{y_mm:.3f},0.000"
