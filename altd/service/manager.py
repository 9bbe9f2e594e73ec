"""What the service manager and the journal are told: ready, alive by progress only, measuring or why not."""

from __future__ import annotations

import logging
import os
import socket
from collections.abc import Sequence

from altd.ports import Clock
from altd.records import Measurement
from altd.service.board import Board

log = logging.getLogger("altd")

_WORD_EVERY_NS = 200_000_000
_LOG_EVERY_NS = 1_000_000_000


class ServiceManager:
    """Speaks when the pipeline has put something on the board, never otherwise: it feeds the watchdog."""

    def __init__(self, board: Board, clock: Clock, unit: str, faces: Sequence[str]) -> None:
        self._board = board
        self._clock = clock
        self._greeting = f"{unit}: {', '.join(faces) or 'no face to the outside'}"
        self._word_ns: int | None = None
        self._log_ns = 0
        self._logged = ""

    def progress(self) -> None:
        """The pipeline put something on the board; the first time, the daemon is ready."""
        now_ns = self._clock.monotonic_ns()
        first = self._word_ns is None
        if self._word_ns is not None and now_ns - self._word_ns < _WORD_EVERY_NS:
            return
        self._word_ns = now_ns
        line = status_line(self._board.read())
        notify(*(["READY=1"] if first else []), f"STATUS={line}", "WATCHDOG=1")
        if first:
            log.info("%s", self._greeting)
        if line != self._logged and (first or now_ns - self._log_ns >= _LOG_EVERY_NS):
            self._logged, self._log_ns = line, now_ns
            log.info("%s", line)


def status_line(measurement: Measurement | None) -> str:
    """One line for people: measuring, or why not."""
    if measurement is None:
        return "starting"
    reasons = ", ".join(str(fault) for fault in measurement.status)
    if measurement.valid:
        return f"measuring ({reasons})" if reasons else "measuring"
    return f"not measuring: {reasons}"


def notify(*assignments: str) -> None:
    """Send assignments such as ``READY=1`` to $NOTIFY_SOCKET (sd_notify(3)); without one nothing happens."""
    address = os.environ.get("NOTIFY_SOCKET")
    if not address:
        return
    if address.startswith("@"):
        address = "\0" + address[1:]
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as link:
        link.sendto("\n".join(assignments).encode(), address)
