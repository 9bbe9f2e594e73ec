"""Serial line to a Grbl controller: bytes out, replies in; other input is counted and dropped."""

from __future__ import annotations

import termios
import time
from collections import deque
from pathlib import Path

from altd.devices.grbl.protocol import Reply, parse
from altd.ports import StageLostError, StageNotFoundError
from altd.serial_line.opening import LineSettings, close_serial, open_serial

_READ_TIMEOUT_S = 0.02
_WRITE_TIMEOUT_S = 2.0
_MAX_UNFINISHED_BYTES = 4096
"""Maximum length without the end of a line; more bytes cannot become a reply."""


class GrblPort:
    """One open port, used from one thread at a time."""

    def __init__(self, device: Path, baud: int) -> None:
        """Open the port; raises StageNotFoundError with the reason."""
        self._device = device
        self._rest = b""
        self._replies: deque[Reply] = deque()
        self.noise = 0
        """Number of lines that are not replies."""
        try:
            self._port = open_serial(
                device, LineSettings(baud), read_timeout_s=_READ_TIMEOUT_S, write_timeout_s=_WRITE_TIMEOUT_S
            )
        except OSError as error:
            raise StageNotFoundError(f"{device}: {error.strerror}") from error

    def close(self) -> None:
        """Release the port."""
        close_serial(self._port)

    def send(self, data: bytes) -> None:
        """Write all of ``data``; raises StageLostError."""
        try:
            self._port.write(data)
        except (OSError, termios.error) as error:  # pyserial's errors are OSErrors
            raise self._lost() from error

    def receive(self, timeout_s: float) -> Reply | None:
        """Return the next reply, or None on timeout; raises StageLostError."""
        deadline = time.monotonic() + timeout_s
        while not self._replies:
            try:
                waiting = self._port.in_waiting
                data = self._port.read(max(1, waiting)) if waiting or timeout_s > 0 else b""
            except (OSError, termios.error, TypeError) as error:  # TypeError: closed by another thread
                raise self._lost() from error
            self._take(data)
            if not data and time.monotonic() >= deadline:
                break
        return self._replies.popleft() if self._replies else None

    def _take(self, data: bytes) -> None:
        *lines, self._rest = (self._rest + data).split(b"\n")
        if len(self._rest) > _MAX_UNFINISHED_BYTES:
            self._rest = b""
            self.noise += 1
        for raw in lines:
            text = raw.strip(b"\r \0").decode("ascii", errors="replace")
            reply = parse(text)
            if reply is not None:
                self._replies.append(reply)
            elif text:
                self.noise += 1

    def _lost(self) -> StageLostError:
        return StageLostError(f"{self._device}: the port is gone")
