"""An inclinometer on a serial port, by the register table of its type.

A Modbus RTU response does not identify its request: a late one would be taken for that of the next request, a
temperature for an angle. After each failure the sensor's settings are therefore read again before any
measurement. They have another function or length, or their values are checked, and a sensor answers in order:
once they have arrived, no earlier response is pending. A line that repeats each response causes no failure,
so the settings are also read again every few readings.
"""

from __future__ import annotations

import os
import termios
import time
from collections.abc import Iterable
from itertools import islice

from altd.devices.inclinometer import InclinometerSettings
from altd.devices.inclinometer.registers import Meaning, Question, Register, Sensor
from altd.ports import (
    InclinometerAccuracy,
    InclinometerNotFoundError,
    InclinometerReading,
    InclinometerRefusedError,
    InclinometerWrongError,
)
from altd.records.sensors import within_half_turn
from altd.serial_line.opening import LineSettings, close_serial, open_serial

_READ_TIMEOUT_S = 0.01
_ANSWER_TIMEOUT_S = 0.2
"""Time from the end of the request to the first byte of the response; the sensors state cycles of 20 to
180 ms."""
_GAP_TIMEOUT_S = 0.03
"""Maximum gap within a response: longer than USB adapters hold bytes back (16 ms)."""
_LEAST_VALUE, _MAX_VALUE = 1e-9, 360.0
"""Limits of an angle or temperature but 0: others are other numbers, such as with swapped words."""
_BITS_PER_CHARACTER = 11
_MAX_BYTES = 300
"""Maximum number of bytes received, more than any response has: a sender of more, or for longer, does not
stop."""


class Line:
    """One open port with one sensor on it, used from one thread."""

    def __init__(self, settings: InclinometerSettings, baud: int, address: int) -> None:
        """Open the port; raises InclinometerNotFoundError with the reason."""
        self._device = settings.device
        self._baud = baud
        self._address = address
        try:
            self._port = open_serial(
                settings.device,
                LineSettings(baud, settings.parity, settings.stop_bits),
                read_timeout_s=_READ_TIMEOUT_S,
            )
        except OSError as error:
            raise InclinometerNotFoundError(f"{settings.device}: {error.strerror}") from error

    def close(self) -> None:
        """Release the port."""
        close_serial(self._port)

    def ask(self, function: int, first: int, count: int) -> list[int]:
        """Read ``count`` registers from ``first`` on; raises InclinometerError of the kind of the failure."""
        question = Question(self._address, function, first, count)
        place = f"address {self._address} on {self._device}, {self._baud} baud"
        return question.registers(self._exchange(question), place)

    def _exchange(self, question: Question) -> bytes:
        """Send a request; return the bytes after it until the line is silent. Earlier bytes are dropped."""
        frame = question.frame
        try:
            self._port.reset_input_buffer()
            self._send(frame)
            begun = time.monotonic()
            deadline = begun + self._seconds(len(frame)) + _ANSWER_TIMEOUT_S
            limit = begun + self._seconds(len(frame) + _MAX_BYTES) + _ANSWER_TIMEOUT_S
            heard: bytes = b""
            while len(heard) < _MAX_BYTES and time.monotonic() < limit:
                is_late = time.monotonic() >= deadline  # before reading: a busy machine is not a silent line
                if data := self._port.read(max(1, self._port.in_waiting)):
                    heard += data
                    is_echo = heard == frame[: len(heard)]
                    rest_s = self._seconds(len(frame)) + _ANSWER_TIMEOUT_S if is_echo else _GAP_TIMEOUT_S
                    deadline = time.monotonic() + rest_s
                elif is_late:
                    break
            heard += self._port.read(min(self._port.in_waiting, _MAX_BYTES))  # received while it slept
        except BlockingIOError as error:
            raise InclinometerNotFoundError(f"{self._device}: the port accepts no request") from error
        except (OSError, termios.error, TypeError) as error:  # pyserial's errors; TypeError: port is gone
            raise InclinometerNotFoundError(f"{self._device}: the port is gone: unplugged?") from error
        return heard

    def _send(self, frame: bytes) -> None:
        """Write a request as a whole; pyserial's write would time out if the process slept after it."""
        if os.write(self._port.fileno(), frame) < len(frame):
            raise BlockingIOError

    def _seconds(self, length: int) -> float:
        return length * _BITS_PER_CHARACTER / self._baud


MAX_READINGS_UNCHECKED = 7
"""Number of readings after which the settings are read again: fewer than the ten for which a jump, such as
from the angle to the temperature, counts as noise (``altd.acquisition.inclination.judging``)."""


class ModbusInclinometer:
    """See ``altd.ports.Inclinometer``."""

    def __init__(self, settings: InclinometerSettings, sensor: Sensor) -> None:
        self._settings = settings
        self._sensor = sensor
        self._address = settings.address or self._sensor.address
        self._baud = settings.baud or self._sensor.baud
        self._latency_s = self._sensor.sampling_s
        self._line: Line | None = None
        self._is_in_step = False
        """Whether the last request was answered."""
        self._unchecked = 0
        """Number of readings since the settings were read."""

    @property
    def name(self) -> str:
        """Type, port, baud rate and address, for people."""
        return f"{self._sensor.name} at {self._settings.device}, {self._baud} baud, address {self._address}"

    @property
    def accuracy(self) -> InclinometerAccuracy:
        """Specification of the maker."""
        return self._sensor.accuracy

    def open(self) -> None:
        """Open the port; check by the settings that it is this sensor with the required set-up."""
        self.close()
        self._line = Line(self._settings, self._baud, self._address)
        try:
            self._identify()
        except BaseException:
            self.close()
            raise

    def read(self) -> InclinometerReading:
        """Return the current reading."""
        if not self._is_in_step or self._unchecked >= MAX_READINGS_UNCHECKED:
            self._identify()
        self._unchecked += 1
        t_ns = time.monotonic_ns() - round(self._latency_s * 1e9)
        rows = list(self._read(self._sensor.blocks(settings=False)))
        values: dict[Meaning, float] = {}
        for row, raw in rows:
            if row.meaning is Meaning.ROLL and raw == self._sensor.invalid_word:
                text = f"register {row.address} says {raw}: a setting of the sensor is invalid"
                raise InclinometerRefusedError(f"{text} (its registers 132 to 136)")
            if row.largest is not None and raw > row.largest:
                raise InclinometerWrongError(f"register {row.address} ({row.about}) says {raw}")
            value = row.value(raw)
            is_possible = value == 0.0 or _LEAST_VALUE <= abs(value) <= _MAX_VALUE  # NaN is not
            if not (row.meaning is Meaning.LIVE or is_possible):
                raise InclinometerWrongError(f"register {row.address} ({row.about}) says {value:g}")
            values[row.meaning] = value
        pitch_deg = values.get(Meaning.PITCH)
        return InclinometerReading(
            t_ns,
            within_half_turn(values[Meaning.ROLL]),
            None if pitch_deg is None else within_half_turn(pitch_deg),
            values[Meaning.TEMPERATURE],
            tuple(raw for _, raw in rows),
        )

    def close(self) -> None:
        """Close the port."""
        line, self._line = self._line, None
        if line is not None:
            line.close()

    def _read(self, blocks: Iterable[tuple[Register, ...]]) -> Iterable[tuple[Register, int]]:
        for block in blocks:
            words = iter(self._ask(block))
            for row in block:
                yield row, row.kind.raw(list(islice(words, row.kind.registers)))

    def _ask(self, block: tuple[Register, ...]) -> list[int]:
        if self._line is None:
            raise InclinometerNotFoundError("the inclinometer is not open")
        self._is_in_step = False
        count = sum(row.kind.registers for row in block)
        words = self._line.ask(block[0].function, block[0].address, count)
        self._is_in_step = True
        return words

    def _identify(self) -> None:
        """Check that it is this sensor, and that no earlier response is pending."""
        for row, raw in self._read(self._sensor.blocks(settings=True)):
            self._check(row, raw)
        self._unchecked = 0

    def _check(self, row: Register, raw: int) -> None:
        """Check a setting of the sensor against its required value; raises InclinometerWrongError."""
        must_be = {
            Meaning.ADDRESS: self._address,
            Meaning.BAUD: self._sensor.code_of_baud(self._baud),
            Meaning.ZERO: 0,
            Meaning.IDENTITY: row.must_be,
        }.get(row.meaning, raw)
        if raw != must_be:
            raise InclinometerWrongError(
                f"register {row.address} ({row.about}) is {raw} and must be {must_be}: "
                "another sensor, or one that is set up otherwise"
            )
        if row.meaning is Meaning.AVERAGE:
            self._latency_s = self._sensor.sampling_s * (raw + 1) / 2
            if self._latency_s + self._settings.interval_s > self._settings.max_age_s:
                raise InclinometerWrongError(
                    f"register {row.address} ({row.about}) is {raw}: its values are {self._latency_s:.1f} s "
                    f"old, more than max_age_s = {self._settings.max_age_s:g} allows"
                )
