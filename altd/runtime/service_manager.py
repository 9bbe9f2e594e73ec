"""What the service manager and the journal are told: ready, alive by progress only, measuring or why not."""

from __future__ import annotations

import logging
import os
import socket
from collections.abc import Sequence

from altd.ports import Clock
from altd.records import Measurement
from altd.status.board import Board

log = logging.getLogger("altd")

_WORD_EVERY_NS = 200_000_000
_LOG_EVERY_NS = 1_000_000_000


class ServiceManager:
    """Speaks when the pipeline has made progress, never otherwise: it feeds the watchdog.

    Ready is said with the first word on the board, again and again until the manager has taken it.
    """

    def __init__(self, board: Board, clock: Clock, unit: str, faces: Sequence[str]) -> None:
        self._board = board
        self._clock = clock
        self._greeting = f"{unit}: {', '.join(faces) or 'no face to the outside'}"
        self._word_ns = -_WORD_EVERY_NS
        self._ready = False
        self._log_ns = 0
        self._logged = ""

    def progress(self) -> None:
        """The pipeline took an exposure, or put something on the board."""
        now_ns = self._clock.monotonic_ns()
        latest = self._board.read()
        if latest is None or now_ns - self._word_ns < _WORD_EVERY_NS:
            return
        self._word_ns = now_ns
        line = status_line(latest)
        ready = [] if self._ready else ["READY=1"]
        self._ready |= notify(*ready, f"STATUS={line}", "WATCHDOG=1")
        self._tell_journal(line, now_ns)

    def _tell_journal(self, line: str, now_ns: int) -> None:
        first = not self._logged
        if line == self._logged or (not first and now_ns - self._log_ns < _LOG_EVERY_NS):
            return
        if first:
            log.info("%s", self._greeting)
        self._logged, self._log_ns = line, now_ns
        log.info("%s", line)


def status_line(measurement: Measurement) -> str:
    """One line for people: measuring, or why not."""
    reasons = ", ".join(str(fault) for fault in measurement.status)
    if measurement.valid:
        return f"measuring ({reasons})" if reasons else "measuring"
    return f"not measuring: {reasons}"


def notify(*assignments: str) -> bool:
    """Send assignments such as ``READY=1`` to $NOTIFY_SOCKET (sd_notify(3)); returns whether they went out.

    A manager that does not read, or is gone, neither holds nor ends the daemon.
    """
    address = os.environ.get("NOTIFY_SOCKET")
    if not address:
        return False
    if address.startswith("@"):
        address = "\0" + address[1:]
    kind = socket.SOCK_DGRAM | socket.SOCK_CLOEXEC | socket.SOCK_NONBLOCK
    with socket.socket(socket.AF_UNIX, kind) as link:
        try:
            link.sendto("\n".join(assignments).encode(), address)
        except OSError:
            return False
    return True
