"""A Grbl 1.1 controller on a serial port: commands and responses, reports, feed hold and reset.

One line is sent at a time, and its ``ok`` awaited (Grbl's "simple send-response"). ``ok`` only means that a
movement was planned. Grbl has no checksum: a line corrupted by noise is usually rejected, and sent again.
"""

from __future__ import annotations

import contextlib
import threading
import time
from dataclasses import dataclass

from altd.devices.grbl import GrblStageSettings
from altd.devices.grbl.line import GrblPort
from altd.devices.grbl.protocol import (
    HOLD,
    HOMING_OFF,
    LOCKED,
    RESET,
    STATUS,
    Alarm,
    GrblSetting,
    Ok,
    Point,
    Refusal,
    Reply,
    StatusReport,
    Welcome,
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

POLL_INTERVAL_S = 0.1
"""Time between two reports while the stage moves; Grbl allows at most 10 per second."""
STUCK_TIMEOUT_S = 3.0
"""Maximum time without movement while the stage is not at its target."""
MAX_TRIES = 3

_MAX_REPORT_TRIES = 4
_REPORT_TIMEOUT_S = 0.5
_WAKE_TIMEOUT_S = 1.0
_MAX_WAKE_TRIES = 6
"""Maximum number of resets on opening: an Arduino that is reset by opening its port takes two seconds to
start."""
_SILENCE_TIMEOUT_S = 0.25
_BRAKE_TIMEOUT_S = 3.0
_MAX_REPORTS_WITHOUT_OFFSET = 40
"""Maximum number of reports to wait for the offset of the work coordinates: Grbl sends it in the first
report, and then in every 30th at least."""
_INCHES_SETTING = 13
_MIN_VERSION = (1, 1)


@dataclass(slots=True)
class _Session:
    """State of the controller between opening and closing. ``offset_mm``: machine minus work coordinates."""

    line: GrblPort
    offset_mm: Point | None = None
    is_homing: bool = False


class GrblController:
    """Client of a Grbl controller, used from one thread, except for ``stop``.

    All methods but ``close``, ``stop`` and ``halt`` raise subclasses of StageError: for an alarm
    StageAlarmError, for an unrequested restart StageLostError, after ``stop`` StageStoppedError.
    """

    def __init__(self, settings: GrblStageSettings) -> None:
        self._settings = settings
        self._session: _Session | None = None
        self._stopping = threading.Event()

    def open(self) -> None:
        """Open the port, let a movement finish and reset the controller, which keeps its position."""
        self._session = _Session(GrblPort(self._settings.device, self._settings.baud))
        try:
            self._let_finish()
            self._reset()
            settings = {s.number: s.value for s in self.command("$$") if isinstance(s, GrblSetting)}
            if settings.get(_INCHES_SETTING):
                raise StageRefusedError("the stage's controller reports in inches: set $13=0 in it")
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close the port."""
        if self._session is not None:
            self._session.line.close()
            self._session = None

    def stop(self) -> None:
        """Request a feed hold, which loses no steps, and a reset to end the movement. From any thread."""
        self._stopping.set()

    def home(self) -> None:
        """Run to the limit switches; returns when the stage is at rest there."""
        self._open_session.is_homing = True
        self.command("$H", self._settings.home_within_s, tries=1)
        self._open_session.is_homing = False

    def command(self, line: str, timeout_s: float | None = None, tries: int = MAX_TRIES) -> list[Reply]:
        """Send a line until it is accepted; return the replies before its ``ok``."""
        timeout_s = timeout_s or self._settings.answer_within_s
        failure: StageError = StageTimeoutError("")
        for _ in range(tries):
            self._drop_late_replies()
            self.send(line.encode("ascii") + b"\n")
            replies: list[Reply] = []
            deadline = time.monotonic() + timeout_s
            while (left_s := deadline - time.monotonic()) > 0:
                reply = self._next_reply(min(left_s, POLL_INTERVAL_S))
                if isinstance(reply, Ok):
                    return replies
                if isinstance(reply, Refusal):
                    failure = _refusal_error(line, reply)
                    break
                if reply is not None:
                    replies.append(reply)
            else:
                failure = StageTimeoutError(f"the stage's controller does not answer to {line!r}")
        raise failure

    def send(self, data: bytes) -> None:
        """Write raw bytes without waiting for a reply."""
        self._open_session.line.send(data)

    def status(self) -> StatusReport:
        """Request a report and return it."""
        for _ in range(_MAX_REPORT_TRIES):
            self.send(STATUS)
            deadline = time.monotonic() + _REPORT_TIMEOUT_S
            while (left_s := deadline - time.monotonic()) > 0:
                reply = self._next_reply(left_s)
                if isinstance(reply, StatusReport):
                    return reply
        raise StageTimeoutError("the stage's controller does not report its position")

    def position_mm(self, status: StatusReport | None = None) -> Point:
        """Return the position in the configured coordinates, from ``status`` or from a new report.

        Repeats the request until the offset of the work coordinates is known.
        """
        status = status or self.status()
        in_machine = self._settings.coordinates == "machine"
        for _ in range(_MAX_REPORTS_WITHOUT_OFFSET):
            known, other = (
                (status.machine_mm, status.work_mm) if in_machine else (status.work_mm, status.machine_mm)
            )
            if known is not None:
                return known
            offset_mm = self._open_session.offset_mm
            if offset_mm is not None and other is not None:
                sign = 1 if in_machine else -1
                return other[0] + sign * offset_mm[0], other[1] + sign * offset_mm[1]
            status = self.status()
        raise StageRefusedError("the stage's controller does not report the offset of its work coordinates")

    def pause(self) -> None:
        """Wait until the next report is due."""
        self._stopping.wait(POLL_INTERVAL_S)
        self._check_stop()

    def halt(self) -> None:
        """Brake (``!``), wait until the stage is at rest, and reset: a reset in motion loses the position.

        Homing neither brakes nor replies, and has no position to lose. Failures are ignored.
        """
        with contextlib.suppress(StageError):
            if not self._open_session.is_homing:
                self._brake()
            self.send(RESET)
            self._await_welcome(_WAKE_TIMEOUT_S)

    def _let_finish(self) -> None:
        """Wait for a movement that a killed program left under way: a reset now would lose steps."""
        last, since = None, time.monotonic()
        while time.monotonic() - since < STUCK_TIMEOUT_S:
            self._check_stop()
            self.send(STATUS)
            reply = self._receive(_REPORT_TIMEOUT_S)
            if not isinstance(reply, StatusReport) or reply.state not in ("Run", "Jog"):
                return
            if reply != last:
                last, since = reply, time.monotonic()
            self.pause()

    def _reset(self) -> None:
        """Reset the controller; wait for its welcome message and then for silence."""
        for _ in range(_MAX_WAKE_TRIES):
            self._check_stop()
            self.send(RESET)
            welcome = self._await_welcome(_WAKE_TIMEOUT_S)
            if welcome is not None:
                break
        else:
            raise StageNotFoundError(
                f"{self._settings.device}: no Grbl controller answers at {self._settings.baud} baud"
            )
        if welcome.version < _MIN_VERSION:
            raise StageRefusedError(f"the stage's controller is too old: {welcome.text}")
        while self._receive(_SILENCE_TIMEOUT_S) is not None:
            pass

    def _await_welcome(self, timeout_s: float) -> Welcome | None:
        deadline = time.monotonic() + timeout_s
        while (left_s := deadline - time.monotonic()) > 0:
            reply = self._receive(left_s)
            if isinstance(reply, Welcome):
                return reply
        return None

    def _brake(self) -> None:
        self.send(HOLD)
        deadline = time.monotonic() + _BRAKE_TIMEOUT_S
        last = None
        while time.monotonic() < deadline:
            self.send(STATUS)
            reply = self._receive(POLL_INTERVAL_S)
            if isinstance(reply, Alarm):
                return
            if isinstance(reply, StatusReport):
                if reply.state != "Run" and reply == last:
                    return
                last = reply
                time.sleep(POLL_INTERVAL_S / 2)

    def _drop_late_replies(self) -> None:
        """Drop late replies, which would be taken for those of the next line."""
        while self._next_reply(0.0) is not None:
            pass

    def _next_reply(self, timeout_s: float) -> Reply | None:
        """Return the next reply, or None on timeout; raises for an alarm, a restart, or our own ``stop``."""
        self._check_stop()
        reply = self._receive(timeout_s)
        if isinstance(reply, Alarm):
            raise StageAlarmError(f"the stage's controller is locked: {reply}")
        if isinstance(reply, Welcome):
            raise StageLostError("the stage's controller restarted (power?): its position is lost")
        return reply

    def _receive(self, timeout_s: float) -> Reply | None:
        session = self._open_session
        reply = session.line.receive(timeout_s)
        if isinstance(reply, StatusReport) and reply.offset_mm is not None:
            session.offset_mm = reply.offset_mm
        return reply

    def _check_stop(self) -> None:
        if self._stopping.is_set():
            self.halt()
            raise StageStoppedError("the stage was stopped on request")

    @property
    def _open_session(self) -> _Session:
        if self._session is None:
            raise StageLostError("the stage is not open")
        return self._session


def _refusal_error(line: str, refusal: Refusal) -> StageError:
    if refusal.code == LOCKED:
        return StageAlarmError("the stage's controller is locked: it must be homed")
    if refusal.code == HOMING_OFF:
        return StageRefusedError(
            f'{refusal}: switch it on, or set the stage\'s zero by hand and stage.start = "unlock"'
        )
    return StageRefusedError(f"the stage's controller refuses {line!r}: {refusal}")
