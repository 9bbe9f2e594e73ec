"""An xy table under a Grbl controller: its moves in simulated time, limits, homing, hold and alarms."""

import math
from dataclasses import dataclass, field

from hw_sim.gcode import Block, GrblError
from hw_sim.grbl_motion import Move, Planner, Xy

SETTINGS = {
    0: "10", 1: "25", 2: "0", 3: "0", 4: "0", 5: "0", 6: "0", 10: "1", 11: "0.010", 12: "0.002", 13: "0",
    20: "0", 21: "0", 22: "0", 23: "0", 24: "25.000", 25: "500.000", 26: "250", 27: "1.000", 30: "1000",
    31: "0", 32: "0", 100: "250.000", 101: "250.000", 102: "250.000", 110: "500.000", 111: "500.000",
    112: "500.000", 120: "10.000", 121: "10.000", 122: "10.000", 130: "200.000", 131: "200.000",
    132: "200.000",
}  # fmt: skip
"""Grbl's factory settings, as ``$$`` lists them: mm, mm/min, mm/s²."""

STEPS_PER_MM, SOFT_LIMITS, HARD_LIMITS, HOMING = 100, 20, 21, 22
SEEK_MM_PER_MIN, PULL_OFF_MM, RATE_MM_PER_MIN, ACCELERATION, TRAVEL_MM = 25, 27, 110, 120, 130
"""Numbers of Grbl's settings."""

HARD_LIMIT_ALARM, SOFT_LIMIT_ALARM, RESET_WHILE_MOVING, RESET_WHILE_HOMING = 1, 2, 3, 6

START_DELAY_S = 0.03
"""Delay from ``ok`` to the start of the steppers; a report meanwhile shows ``Idle``, as Grbl's does."""


@dataclass(slots=True)
class Machine:
    """A table and its controller's state. The caller supplies the time, in s, which must not decrease.

    ``limit_switches_mm`` are their positions, (lowest x, highest x, lowest y, highest y) in machine
    coordinates; None: no switches. ``state`` is that of Grbl's reports. ``alarm`` is the alarm after which no
    command is accepted until a reset. ``messages`` collects unsolicited output.
    """

    settings: dict[int, str] = field(default_factory=lambda: dict(SETTINGS))
    planner: Planner = field(default_factory=lambda: Planner((0.0, 0.0)))
    work_zero_mm: Xy = (0.0, 0.0)
    limit_switches_mm: tuple[float, float, float, float] | None = None
    state: str = "Idle"
    alarm: int | None = None
    messages: list[str] = field(default_factory=list)
    _home_until_s: float | None = None

    @property
    def is_homing(self) -> bool:
        """Whether the table searches its switches."""
        return self._home_until_s is not None

    def is_set(self, setting: int) -> bool:
        """Whether a setting is not 0."""
        return float(self.settings[setting]) != 0

    def is_braking(self, t_s: float) -> bool:
        """Whether the table is still moving after a hold."""
        return self.planner.held is not None and self.planner.moving(t_s)

    def start_up(self) -> None:
        """Power on: the position is lost, the settings are kept."""
        self.planner = Planner((0.0, 0.0))
        self._unlock_or_lock(self.is_set(HOMING))

    def stop_dead(self, t_s: float) -> None:
        """Stop without braking; planned moves are discarded."""
        self.planner.stop_dead(t_s)

    def reset(self, t_s: float) -> None:
        """Stop and restart; a moving table loses steps, a table at rest on a hold does not."""
        moving, homing = self.planner.moving(t_s), self.state == "Home"
        locked = self.state == "Alarm" or moving or homing
        if moving:
            self.messages.append(f"ALARM:{RESET_WHILE_MOVING}")
        elif homing:
            self.messages.append(f"ALARM:{RESET_WHILE_HOMING}")
        self.planner.stop_dead(t_s)
        self._unlock_or_lock(locked)

    def advance(self, t_s: float) -> None:
        """Advance moves, homing and switches to ``t_s``."""
        if self._home_until_s is not None and t_s >= self._home_until_s:
            self._end_homing()
        if self.state == "Run":
            self._check_limit_switches(t_s)
            self.planner.advance(t_s)
            if self.state == "Run" and not self.planner.moves:
                self.state = "Idle"

    def move(self, block: Block, t_s: float) -> None:
        """Plan the move of a block in whole steps; a target outside the travel is a soft-limit alarm."""
        target = self._target_mm(block)
        travel = [float(self.settings[TRAVEL_MM + axis]) for axis in (0, 1)]
        outside = any(not -length <= value <= 0.0 for value, length in zip(target, travel, strict=True))
        if self.is_set(SOFT_LIMITS) and outside:
            self._raise_alarm(SOFT_LIMIT_ALARM)
            return
        start = self.planner.target_mm
        steps = [float(self.settings[STEPS_PER_MM + axis]) for axis in (0, 1)]
        end = tuple(round(value * step) / step for value, step in zip(target, steps, strict=True))
        if end == start:
            return
        feed_mm_per_min = block.modes.feed_mm_per_min if block.modes.motion else math.inf
        move = Move(
            start,
            (end[0], end[1]),
            self._limited(start, end, RATE_MM_PER_MIN, feed_mm_per_min) / 60.0,
            self._limited(start, end, ACCELERATION, math.inf),
        )
        self.planner.add(move, t_s + START_DELAY_S)
        self.state = "Run"

    def set_work_zero(self, block: Block) -> None:
        """Set the work zero (G10 L2) or the work position (G10 L20, and G92, which is permanent here)."""
        if not block.axes_mm:
            raise GrblError(26)
        here, zero = self.planner.target_mm, list(self.work_zero_mm)
        for index, axis in enumerate("XY"):
            if axis in block.axes_mm:
                value = block.axes_mm[axis]
                zero[index] = value if block.sets_offset else here[index] - value
        self.work_zero_mm = zero[0], zero[1]

    def home(self, t_s: float) -> None:
        """Search the switches; raises GrblError if homing is disabled."""
        if not self.is_set(HOMING):
            raise GrblError(5)
        away = max(abs(value) for value in self.planner.place_mm)
        self.state = "Home"
        self._home_until_s = t_s + 60.0 * away / float(self.settings[SEEK_MM_PER_MIN]) + 0.1

    def hold(self, t_s: float) -> None:
        """Brake to rest."""
        if self.state in ("Run", "Idle"):
            self.planner.hold(t_s)
            self.state = "Hold"

    def resume(self, t_s: float) -> None:
        """Continue after a hold."""
        if self.state == "Hold" and not self.is_braking(t_s):
            self.planner.resume(t_s)
            self.state = "Run" if self.planner.moves else "Idle"

    def hit_limit_switch(self, t_s: float) -> None:
        """Close a limit switch, regardless of the table's position."""
        if self.is_set(HARD_LIMITS):
            self.planner.stop_dead(t_s)
            self._raise_alarm(HARD_LIMIT_ALARM)

    def _target_mm(self, block: Block) -> Xy:
        target = []
        for index, axis in enumerate("XY"):
            start = self.planner.target_mm[index]
            if axis not in block.axes_mm:
                target.append(start)
            elif block.modes.relative:
                target.append(start + block.axes_mm[axis])
            else:
                target.append(block.axes_mm[axis] + (0.0 if block.in_machine else self.work_zero_mm[index]))
        return target[0], target[1]

    def _limited(self, start: Xy, end: tuple[float, ...], setting: int, most: float) -> float:
        """Largest value along the path at which no axis exceeds its limit."""
        length = math.dist(start, end)
        for axis in (0, 1):
            share = abs(end[axis] - start[axis]) / length
            if share > 0:
                most = min(most, float(self.settings[setting + axis]) / share)
        return most

    def _check_limit_switches(self, t_s: float) -> None:
        if self.limit_switches_mm is None or not self.is_set(HARD_LIMITS):
            return
        x, y = self.planner.at(t_s)
        low_x, high_x, low_y, high_y = self.limit_switches_mm
        if not (low_x <= x <= high_x and low_y <= y <= high_y):
            self.hit_limit_switch(t_s)

    def _raise_alarm(self, code: int) -> None:
        self.messages += [f"ALARM:{code}", "[MSG:Reset to continue]"]
        self.state = "Alarm"
        self.alarm = code

    def _end_homing(self) -> None:
        """End homing: the table is at the switches at the upper ends, less the pull-off."""
        place = -float(self.settings[PULL_OFF_MM])
        self.planner = Planner((place, place))
        self._home_until_s = None
        self.state = "Idle"

    def _unlock_or_lock(self, locked: bool) -> None:
        self._home_until_s = None
        self.alarm = None
        self.state = "Alarm" if locked else "Idle"
