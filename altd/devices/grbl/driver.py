"""An xy stage behind a Grbl 1.1 controller on a serial port.

One line is sent at a time, and its ``ok`` awaited (Grbl's "simple send-response"). ``ok`` only says that a
movement was planned, and a report just behind it may still say ``Idle`` at the old place; so a movement is
over when two reports in a row say ``Idle`` at its target. Grbl has no checksum: a line that noise has
changed is found by where the stage then stands, and sent again; targets are absolute, so that is harmless.
"""

from __future__ import annotations

import contextlib
import math
import threading
import time

from altd.config import GrblStageSettings
from altd.devices.grbl.line import Line
from altd.devices.grbl.protocol import (
    HOLD,
    HOMING_OFF,
    LOCKED,
    RESET,
    STATUS,
    Alarm,
    Banner,
    Ok,
    Point,
    Refusal,
    Reply,
    Setting,
    Status,
)
from altd.ports import (
    StageAlarmError,
    StageError,
    StageLostError,
    StageNotFoundError,
    StageRefusedError,
    StageStoppedError,
    StageTimeoutError,
)

POLL_S = 0.1
"""Time between two reports while the stage moves; Grbl asks for 10 a second at most."""

_TRIES = 3
_REPORT_WITHIN_S = 0.5
_WAKE_S = 1.0
_WAKE_TRIES = 6
"""An Arduino that the opening of its port resets takes two seconds to start."""
_SILENCE_S = 0.25
_STUCK_S = 3.0
"""A stage that is not at its target must move; this long it may not."""
_HALT_S = 3.0
_AT_TARGET_MM = 0.02
"""A coarse table's step; what is recorded is the reported position, not the target."""
_REPORTS_UNTIL_OFFSET = 40
"""Grbl tells the offset of the work coordinates in every 30th report at least, and in the first."""
_INCHES = 13
_OLDEST = (1, 1)


class GrblStage:
    """See ``altd.ports.Stage``."""

    def __init__(self, settings: GrblStageSettings) -> None:
        self._settings = settings
        self._line: Line | None = None
        self._stopping = threading.Event()
        self._offset_mm: Point | None = None
        self._homing = False

    def open(self) -> None:
        """Open the port, let a movement finish and reset the controller, which keeps its position."""
        self._offset_mm = None
        self._homing = False
        self._line = Line(self._settings.device, self._settings.baud)
        try:
            self._let_finish()
            self._reset()
            self._check_settings()
        except BaseException:
            self.close()
            raise

    def home(self) -> None:
        """``$H``, or with ``start = "unlock"`` take the position as it is."""
        if self._settings.start == "home":
            self._homing = True
            self._command("$H", self._settings.home_within_s, tries=1)
            self._homing = False
        elif self._status().state == "Alarm":
            self._command("$X")
        state = self._status().state
        if state == "Alarm":
            raise StageAlarmError("the stage's controller stays locked")
        self._position()

    def move_to(self, x_mm: float, y_mm: float) -> None:
        """Move in a straight line at ``feed_mm_per_min``; returns at standstill at the target."""
        settings = self._settings
        target = (
            settings.sign_x * x_mm + settings.offset_x_mm,
            settings.sign_y * y_mm + settings.offset_y_mm,
        )
        whose = "G53 " if settings.coordinates == "machine" else ""
        line = f"{whose}G21 G90 G94 G1 X{target[0]:.3f} Y{target[1]:.3f} F{settings.feed_mm_per_min:g}"
        try:
            for _ in range(_TRIES):
                self._command(line)
                if self._arrives(target):
                    return
        except (StageAlarmError, StageLostError, StageStoppedError):
            raise
        except StageError:
            self._halt()
            raise
        stands = self._position()
        raise StageRefusedError(
            f"the stage stops at {stands[0]:.3f}, {stands[1]:.3f} instead of {target[0]:.3f}, "
            f"{target[1]:.3f} mm of its own coordinates"
        )

    def position(self) -> tuple[float, float]:
        """Where the controller says that the stage is, in the unit frame, mm."""
        x_mm, y_mm = self._position()
        settings = self._settings
        return (
            settings.sign_x * (x_mm - settings.offset_x_mm) + 0.0,  # -0.0 is nothing to show to people
            settings.sign_y * (y_mm - settings.offset_y_mm) + 0.0,
        )

    def stop(self) -> None:
        """End the movement under way by a feed hold, which loses no steps, and a reset."""
        self._stopping.set()

    def close(self) -> None:
        """Close the port."""
        if self._line is not None:
            self._line.close()
            self._line = None

    def _let_finish(self) -> None:
        """A program that was killed may have left the stage on its way: to reset it now would lose steps."""
        last, since = None, time.monotonic()
        while time.monotonic() - since < _STUCK_S:
            self._check_stop()
            self._send(STATUS)
            reply = self._receive(_REPORT_WITHIN_S)
            if not isinstance(reply, Status) or reply.state not in ("Run", "Jog"):
                return
            if reply != last:
                last, since = reply, time.monotonic()
            self._pause()

    def _reset(self) -> None:
        """Soft reset, and wait for the controller to introduce itself and be silent."""
        for _ in range(_WAKE_TRIES):
            self._check_stop()
            self._send(RESET)
            banner = self._await_banner(_WAKE_S)
            if banner is not None:
                break
        else:
            raise StageNotFoundError(
                f"{self._settings.device}: no Grbl controller answers at {self._settings.baud} baud"
            )
        if banner.version < _OLDEST:
            raise StageRefusedError(f"the stage's controller is too old: {banner.text}")
        while self._receive(_SILENCE_S) is not None:
            pass

    def _await_banner(self, within_s: float) -> Banner | None:
        deadline = time.monotonic() + within_s
        while (left_s := deadline - time.monotonic()) > 0:
            reply = self._receive(left_s)
            if isinstance(reply, Banner):
                return reply
        return None

    def _check_settings(self) -> None:
        settings = {s.number: s.value for s in self._command("$$") if isinstance(s, Setting)}
        if settings.get(_INCHES):
            raise StageRefusedError("the stage's controller reports in inches: set $13=0 in it")

    def _command(self, line: str, within_s: float | None = None, tries: int = _TRIES) -> list[Reply]:
        """Send a line until it is taken; what was said before its ``ok``."""
        within_s = within_s or self._settings.answer_within_s
        complaint: StageError = StageTimeoutError("")
        for _ in range(tries):
            self._drop_old()
            self._send(line.encode("ascii") + b"\n")
            said: list[Reply] = []
            deadline = time.monotonic() + within_s
            while (left_s := deadline - time.monotonic()) > 0:
                reply = self._heard(min(left_s, POLL_S))
                if isinstance(reply, Ok):
                    return said
                if isinstance(reply, Refusal):
                    complaint = self._refused(line, reply)
                    break
                if reply is not None:
                    said.append(reply)
            else:
                complaint = StageTimeoutError(f"the stage's controller does not answer to {line!r}")
        raise complaint

    def _refused(self, line: str, refusal: Refusal) -> StageError:
        if refusal.code == LOCKED:
            return StageAlarmError("the stage's controller is locked: it must be homed")
        if refusal.code == HOMING_OFF:
            return StageRefusedError(
                f'{refusal}: switch it on, or set the stage\'s zero by hand and stage.start = "unlock"'
            )
        return StageRefusedError(f"the stage's controller refuses {line!r}: {refusal}")

    def _arrives(self, target: Point) -> bool:
        """Wait until the stage stands; whether it stands at the target."""
        last: tuple[str, Point] | None = None
        same, since = 1, time.monotonic()
        while True:
            status = self._status()
            if status.state == "Alarm":
                raise StageAlarmError("the stage's controller is locked: it must be homed")
            now = status.state, self._in_use(status)
            same = same + 1 if now == last else 1
            if now != last:
                last, since = now, time.monotonic()
            if status.state == "Idle":
                if math.dist(now[1], target) <= _AT_TARGET_MM:
                    if same >= 2:
                        return True
                elif same > _TRIES:
                    return False
            elif time.monotonic() - since > _STUCK_S:
                raise StageTimeoutError(f"the stage is in state {status.state} and does not move")
            self._pause()

    def _position(self) -> Point:
        return self._in_use(self._status())

    def _in_use(self, status: Status) -> Point:
        """The position in the coordinates that count; asks on until their offset was told."""
        for _ in range(_REPORTS_UNTIL_OFFSET):
            wanted, other = (
                (status.machine_mm, status.work_mm)
                if self._settings.coordinates == "machine"
                else (status.work_mm, status.machine_mm)
            )
            if wanted is not None:
                return wanted
            if self._offset_mm is not None and other is not None:
                sign = 1 if self._settings.coordinates == "machine" else -1
                return other[0] + sign * self._offset_mm[0], other[1] + sign * self._offset_mm[1]
            status = self._status()
        raise StageRefusedError("the stage's controller does not tell the offset of its work coordinates")

    def _status(self, tries: int = 4) -> Status:
        for _ in range(tries):
            self._send(STATUS)
            deadline = time.monotonic() + _REPORT_WITHIN_S
            while (left_s := deadline - time.monotonic()) > 0:
                reply = self._heard(left_s)
                if isinstance(reply, Status):
                    return reply
        raise StageTimeoutError("the stage's controller does not report its position")

    def _drop_old(self) -> None:
        """Answers that came too late would be taken for those of the next line."""
        while self._heard(0.0) is not None:
            pass

    def _heard(self, within_s: float) -> Reply | None:
        """The next reply; raises what nobody asked for: an alarm, a restart, or our own ``stop``."""
        self._check_stop()
        reply = self._receive(within_s)
        if isinstance(reply, Alarm):
            raise StageAlarmError(f"the stage's controller is locked: {reply}")
        if isinstance(reply, Banner):
            raise StageLostError("the stage's controller started anew (power?): its position is lost")
        return reply

    def _receive(self, within_s: float) -> Reply | None:
        reply = self._open_line.receive(within_s)
        if isinstance(reply, Status) and reply.offset_mm is not None:
            self._offset_mm = reply.offset_mm
        return reply

    def _pause(self) -> None:
        self._stopping.wait(POLL_S)
        self._check_stop()

    def _check_stop(self) -> None:
        if self._stopping.is_set():
            self._halt()
            raise StageStoppedError("the stage was told to stop")

    def _halt(self) -> None:
        """Brake (``!``), wait until it stands, and reset: what is reset while it moves loses its position.

        Homing neither brakes nor answers, and has no position to lose.
        """
        with contextlib.suppress(StageError):
            if not self._homing:
                self._brake()
            self._send(RESET)
            self._await_banner(_WAKE_S)

    def _brake(self) -> None:
        self._send(HOLD)
        deadline = time.monotonic() + _HALT_S
        last = None
        while time.monotonic() < deadline:
            self._send(STATUS)
            reply = self._receive(POLL_S)
            if isinstance(reply, Alarm):
                return
            if isinstance(reply, Status):
                if reply.state != "Run" and reply == last:
                    return
                last = reply
                time.sleep(POLL_S / 2)

    def _send(self, data: bytes) -> None:
        self._open_line.send(data)

    @property
    def _open_line(self) -> Line:
        if self._line is None:
            raise StageLostError("the stage is not open")
        return self._line
