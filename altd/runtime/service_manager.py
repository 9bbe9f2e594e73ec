"""Reports to the service manager and the journal: ready, progress (watchdog), and measuring or why not."""

from __future__ import annotations

import logging
import os
import socket
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from altd.errors import one_line
from altd.ports import Clock
from altd.records import Measurement
from altd.status.board import Board

log = logging.getLogger("altd")

_NOTIFY_INTERVAL_NS = 200_000_000
_LOG_INTERVAL_NS = 1_000_000_000


class ServiceManager:
    """Notifies the manager only when the pipeline has made progress: that feeds the watchdog.

    Ready is sent with the first measurement on the board, and repeated until the manager has received it.
    """

    def __init__(self, board: Board, clock: Clock, unit: str, interfaces: Sequence[str]) -> None:
        self._board = board
        self._clock = clock
        self._start_line = f"{unit}: {', '.join(interfaces) or 'no interface to the outside'}"
        self._notified_ns = -_NOTIFY_INTERVAL_NS
        self._ready = False
        self._log_ns = 0
        self._logged = ""

    def progress(self) -> None:
        """Note that the pipeline processed a frame set or published a measurement; notify the manager."""
        now_ns = self._clock.monotonic_ns()
        latest = self._board.read()
        if latest is None or now_ns - self._notified_ns < _NOTIFY_INTERVAL_NS:
            return
        self._notified_ns = now_ns
        line = status_line(latest)
        ready = [] if self._ready else ["READY=1"]
        self._ready |= notify(*ready, f"STATUS={line}", "WATCHDOG=1")
        self._log_status(line, now_ns)

    @contextmanager
    def reloading(self) -> Iterator[None]:
        """Report a reload during the context; the next progress reports ready (systemd.service(5))."""
        notify("RELOADING=1", f"MONOTONIC_USEC={self._clock.monotonic_ns() // 1000}")
        try:
            yield
        finally:
            self._ready = False

    def _log_status(self, line: str, now_ns: int) -> None:
        first = not self._logged
        if line == self._logged or (not first and now_ns - self._log_ns < _LOG_INTERVAL_NS):
            return
        if first:
            log.info("%s", self._start_line)
        self._logged, self._log_ns = line, now_ns
        log.info("%s", line)


def status_line(measurement: Measurement) -> str:
    """Return one line of text: measuring, or why not."""
    reasons = ", ".join(str(fault) for fault in measurement.status)
    if measurement.valid:
        return f"measuring ({reasons})" if reasons else "measuring"
    return f"not measuring: {reasons}"


def state_folder() -> Path | None:
    """Return the folder for persistent data, $STATE_DIRECTORY (systemd.exec(5)); None: not set."""
    return _first_folder("STATE_DIRECTORY")


def runtime_folder() -> Path | None:
    """Return the folder for data of one run, $RUNTIME_DIRECTORY; None: not set."""
    return _first_folder("RUNTIME_DIRECTORY")


def _first_folder(variable: str) -> Path | None:
    first = os.environ.get(variable, "").partition(":")[0]
    return Path(first) if first else None


def notify(*assignments: str) -> bool:
    """Send assignments such as ``READY=1`` to $NOTIFY_SOCKET (sd_notify(3)); return whether they were sent.

    A manager that does not read or has ended neither blocks nor ends the daemon.
    """
    address = os.environ.get("NOTIFY_SOCKET")
    if not address:
        return False
    if address.startswith("@"):
        address = "\0" + address[1:]
    kind = socket.SOCK_DGRAM | socket.SOCK_CLOEXEC | socket.SOCK_NONBLOCK
    with socket.socket(socket.AF_UNIX, kind) as link:
        try:
            link.sendto("\n".join(map(one_line, assignments)).encode(), address)
        except OSError:
            return False
    return True
