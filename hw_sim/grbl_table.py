"""An xy table with a Grbl controller on a pseudo-terminal; it moves the laser of a simulated unit.

The controller has its own position count. The true position differs from it by the positioning error of
``hw_sim.stage`` and, after a loss of power or of steps, by the lost distance, until homing.
"""

import os
import select
import threading
import time
from bisect import bisect_right
from collections import deque
from typing import Self

import numpy as np

from hw_sim.beam import BeamPose
from hw_sim.grbl import Controller
from hw_sim.grbl_machine import Machine
from hw_sim.plugged_port import PluggedPort
from hw_sim.stage import Stage
from hw_sim.unit import Unit

TICK_S = 0.002
MAX_POSES = 4000
"""Maximum number of stored poses, one for each tick: a frame is rendered after its exposure."""

MIDDLE_MM = (-100.0, -100.0)
"""Middle of the targets relative to the switches, which are at the upper ends of a travel of 200 mm. The
table is there when the simulation begins, and the work zero is set there."""

FAST_SETTINGS = {110: "30000", 111: "30000", 120: "3000", 121: "3000", 25: "20000"}
"""Settings of a fast table, so that people and tests need not wait: 0.5 m/s, 3 m/s²."""
SWITCH_SETTINGS = {20: "1", 21: "1", 22: "1"}
"""Settings of a table with limit switches."""

LOST_STEPS_MM = 0.4
"""Distance that is lost when the table stops abruptly."""


class GrblTable:
    """``with GrblTable(unit) as table``: the controller responds on ``table.device``.

    ``noise`` is the share of bytes, in each direction, that the line corrupts. Without ``switches`` the table
    cannot be homed; it was powered on in the middle.
    """

    def __init__(
        self, unit: Unit | None = None, rng: np.random.Generator | None = None, *, switches: bool = True
    ) -> None:
        self.machine = Machine(work_zero_mm=MIDDLE_MM if switches else (0.0, 0.0))
        self.machine.settings |= FAST_SETTINGS | (SWITCH_SETTINGS if switches else {})
        self.controller = Controller(self.machine)
        self.controller.power_on()
        self.noise = 0.0
        self.changed_bytes = 0
        self._rng = rng or np.random.default_rng(0)
        self._stage = Stage(self._rng)
        self._displacement_mm = MIDDLE_MM
        self._power = self._answers = True
        self._lock = threading.RLock()
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._serve, name="grbl-table", daemon=True)
        self._port = PluggedPort()
        self.device = self._port.device
        self._times_ns: deque[int] = deque(maxlen=MAX_POSES)
        self._poses: deque[BeamPose] = deque(maxlen=MAX_POSES)
        self._target_mm = self.machine.planner.target_mm
        self._error = self._stage.place(0.0, 0.0)
        self._record_pose(time.monotonic_ns())
        if unit is not None:
            unit.follow(self.beam)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ending.set()
        self._thread.join()
        self.unplug()

    def beam(self, t_ns: int) -> BeamPose:
        """Beam at an instant of the last seconds."""
        with self._lock:
            index = bisect_right(self._times_ns, t_ns) - 1
            return self._poses[max(index, 0)]

    def unplug(self) -> None:
        """Unplug the cable: the port disappears."""
        with self._lock:
            self._port.unplug()

    def stop_answering(self) -> None:
        """Stop the controller's responses; a move in progress is finished."""
        with self._lock:
            self._answers = False

    def lose_power(self) -> None:
        """Stop immediately and do not respond; the table stays in its position."""
        with self._lock:
            self.controller.cut_power(_now_s())
            self._power = False

    def power_on(self) -> None:
        """Restore power: the controller assumes its zero, regardless of the table's position."""
        with self._lock:
            self.displace(*self.machine.planner.place_mm)
            sent = self.controller.power_on()
            self._power = self._answers = True
            self._send(sent)

    def hit_limit(self) -> None:
        """Press a limit switch."""
        with self._lock:
            self._send(self.controller.hit_limit(_now_s()))

    def displace(self, x_mm: float, y_mm: float) -> None:
        """Displace the table without its controller noticing."""
        with self._lock:
            self._displacement_mm = self._displacement_mm[0] + x_mm, self._displacement_mm[1] + y_mm

    def zero_by_hand(self, x_mm: float, y_mm: float) -> None:
        """Move the table by hand to a position of the unit frame, which becomes the controller's zero."""
        with self._lock:
            self.machine.planner.place_mm = (0.0, 0.0)
            self._displacement_mm = MIDDLE_MM[0] + x_mm, MIDDLE_MM[1] + y_mm

    def _serve(self) -> None:
        while not self._ending.is_set():
            with self._lock:
                if self._port.terminal < 0:
                    return
                self._exchange()
            self._ending.wait(TICK_S)

    def _exchange(self) -> None:
        now_ns = time.monotonic_ns()
        data = b""
        if select.select([self._port.terminal], [], [], 0)[0]:
            data = self._with_line_noise(os.read(self._port.terminal, 4096))
        if self._power:
            if self._answers:
                homing = self.machine.state == "Home"
                self._send(self.controller.receive(data, now_ns * 1e-9))
                if homing and self.machine.state == "Idle":
                    self._displacement_mm = 0.0, 0.0
            else:
                self.controller.tick(now_ns * 1e-9)
        self._record_pose(now_ns)

    def _send(self, text: str) -> None:
        if "ALARM:1" in text or "ALARM:3" in text:
            self.displace(LOST_STEPS_MM, -LOST_STEPS_MM)
        if text and self._port.terminal >= 0:
            os.write(self._port.terminal, self._with_line_noise(text.encode("ascii")))

    def _with_line_noise(self, data: bytes) -> bytes:
        if self.noise == 0 or not data:
            return data
        changed = np.frombuffer(data, np.uint8).copy()
        hit = self._rng.random(len(changed)) < self.noise
        self.changed_bytes += int(hit.sum())
        changed[hit] = self._rng.integers(1, 256, int(hit.sum()))
        return changed.tobytes()

    def _record_pose(self, t_ns: int) -> None:
        if self.machine.planner.target_mm != self._target_mm:
            self._target_mm = self.machine.planner.target_mm
            self._error = self._stage.place(0.0, 0.0)
        x_mm, y_mm = self.machine.planner.at(t_ns * 1e-9)
        self._times_ns.append(t_ns)
        self._poses.append(
            BeamPose(
                x_mm + self._displacement_mm[0] + self._error.x_mm - MIDDLE_MM[0],
                y_mm + self._displacement_mm[1] + self._error.y_mm - MIDDLE_MM[1],
            )
        )


def _now_s() -> float:
    return time.monotonic_ns() * 1e-9
