"""The serial line to an inclinometer: a question out, and all that comes back until the line falls silent."""

from __future__ import annotations

import termios
import time

from altd.config import InclinometerSettings
from altd.devices.inclinometer.protocol import Question
from altd.ports import InclinometerNotFoundError
from altd.serial_port.opening import LineSettings, close_serial, open_serial

_READ_TIMEOUT_S = 0.01
_WRITE_TIMEOUT_S = 0.3
_ANSWER_TIMEOUT_S = 0.2
"""From the end of the request to the first byte of the answer; the sensors state cycles of 20 to 180 ms."""
_GAP_TIMEOUT_S = 0.03
"""Within an answer: longer than USB adapters hold bytes back (16 ms)."""
_BITS_PER_CHARACTER = 11
_MAX_BYTES = 300
"""More than any answer has: what goes on longer, or takes longer, is somebody who does not stop."""


class Line:
    """One open port with one sensor on it, used from one thread."""

    def __init__(self, settings: InclinometerSettings, baud: int, address: int) -> None:
        """Open the port; raises InclinometerNotFoundError that says why it cannot be used."""
        self._device = settings.device
        self._baud = baud
        self._address = address
        try:
            self._port = open_serial(
                settings.device,
                LineSettings(baud, settings.parity, settings.stop_bits),
                read_timeout_s=_READ_TIMEOUT_S,
                write_timeout_s=_WRITE_TIMEOUT_S,
            )
        except OSError as error:
            raise InclinometerNotFoundError(f"{settings.device}: {error.strerror}") from error

    def close(self) -> None:
        """Let go of the port."""
        close_serial(self._port)

    def ask(self, function: int, first: int, count: int) -> list[int]:
        """``count`` registers from ``first`` on; raises InclinometerError of the kind that it was."""
        question = Question(self._address, function, first, count)
        place = f"address {self._address} on {self._device}, {self._baud} baud"
        return question.registers(self._exchange(question), place)

    def _exchange(self, question: Question) -> bytes:
        """What comes after a question until the line falls silent; what came before it is dropped."""
        frame = question.frame
        try:
            self._port.reset_input_buffer()
            self._port.write(frame)
            begun = time.monotonic()
            deadline = begun + self._seconds(len(frame)) + _ANSWER_TIMEOUT_S
            limit = begun + self._seconds(len(frame) + _MAX_BYTES) + _ANSWER_TIMEOUT_S
            heard = b""
            while time.monotonic() < min(deadline, limit) and len(heard) < _MAX_BYTES:
                if data := self._port.read(max(1, self._port.in_waiting)):
                    heard += data
                    is_echo = heard == frame[: len(heard)]
                    rest_s = self._seconds(len(frame)) + _ANSWER_TIMEOUT_S if is_echo else _GAP_TIMEOUT_S
                    deadline = time.monotonic() + rest_s
        except (OSError, termios.error, TypeError) as error:  # pyserial's errors; TypeError: it is gone
            raise InclinometerNotFoundError(f"{self._device}: the port is gone: unplugged?") from error
        return heard

    def _seconds(self, length: int) -> float:
        return length * _BITS_PER_CHARACTER / self._baud
