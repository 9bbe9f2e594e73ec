"""Modbus RTU on a serial port, alone or as one of many units on an RS485 bus.

"Serial" is the Modbus over Serial Line Specification V1.02, "Application" the Modbus Application Protocol
V1.1b3. A frame begins after a silence, and its CRC determines its end (Serial 2.5.1). The end of another
unit's response can equal a request to this unit, including a valid CRC. So bytes since a silence are first
parsed as a sequence of whole frames, considering the response that is awaited on the bus. Only if that fails,
after noise, is a request searched for at their end.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Self

from altd.config import ModbusRtuPortSettings
from altd.publish.modbus.responder import (
    DIAGNOSTICS,
    ExceptionCode,
    LineCounters,
    Responder,
    serial_response,
)
from altd.serial_line.modbus_crc import START, TABLE, register_after, with_crc
from altd.serial_port.port import Port, describe, opened, seconds_on_line
from altd.status.health import Component, State
from altd.status.unit import PublishedUnit

MAX_FRAME_BYTES = 256
"""Maximum length of a frame (Serial 2.5.1)."""

MIN_FRAME_BYTES = 4
"""Minimum length of a frame: unit id, function and CRC."""

MAX_UNIT_ID = 247
"""Largest unit id; 0 is a broadcast (Serial 2.2)."""

_MAX_FRAGMENTS = 16
"""Maximum number of fragments of a frame from an adapter. More are noise; each adds a check per fragment."""
FRAGMENT_TIMEOUT_S = 0.1
"""Silence after which no frame continues. The specification requires 1.5 characters (Serial 2.5.1.1), but
USB adapters deliver received bytes every 16 ms."""

RESPONSE_TIMEOUT_S = 1.0
"""Time for which another unit's response is awaited (Serial 2.4.1: "from 1 s to several seconds")."""

_BIT_READS, _REGISTER_READS, _SINGLE_WRITES, _MULTIPLE_WRITES = {1, 2}, {3, 4}, {5, 6}, {15, 16}
"""Functions, grouped by the lengths of their frames (Application 6.1 to 6.6, 6.11, 6.12)."""

_EXCEPTION_BIT = 0x80

_GLITCHES = (b"", b"\x00", b"\xff")
"""Bytes that may follow a read: on many two-wire lines a driver leaves one as it is switched off. A zero
leaves the CRC correct."""

_REQUESTS_AFTER_NOISE = ((8, bytes([2])), (8, bytes([3])), (8, bytes([4])), (7, bytes([43, 14])))
"""Length of each request that is searched for after noise, and its first bytes after the unit id."""


@dataclass(frozen=True, slots=True)
class _AwaitedResponse:
    """Response expected from another unit."""

    unit_id: int
    function: int
    length: int
    until_s: float

    @classmethod
    def after(cls, frame: bytes, now_s: float) -> Self | None:
        """Return the response expected after a frame; None without one, or if its length is not known."""
        unit_id, function = frame[0], frame[1]
        count = int.from_bytes(frame[4:6], "big")
        if function in _MULTIPLE_WRITES and len(frame) > 8:
            length = 8
        elif len(frame) != 8 or unit_id == 0:
            return None
        elif function in _SINGLE_WRITES:
            length = 8
        elif function in _BIT_READS:
            length = 5 + (count + 7) // 8
        elif function in _REGISTER_READS:
            length = 5 + 2 * count
        else:
            return None
        return cls(unit_id, function, length, now_s + RESPONSE_TIMEOUT_S)

    def is_begun_by(self, received: bytes) -> bool:
        """Whether these bytes can be the start of the response, or a damaged response."""
        return received[0] == self.unit_id and received[1:2] in (b"", bytes([self.function]))


class Bus:
    """Tracks the frames on one line for one unit."""

    def __init__(self, unit_id: int) -> None:
        self._unit_id = unit_id
        self.counters = LineCounters()
        self._fragments: list[bytes] = []
        self._received_s = float("-inf")
        self._awaited: _AwaitedResponse | None = None

    def receive(self, received: bytes, now_s: float) -> bytes | None:
        """Take the bytes up to a silence; returns a request to this unit at their end, without id and CRC."""
        if now_s - self._received_s > FRAGMENT_TIMEOUT_S and self._fragments:
            self.counters.errors += 1
            self._fragments.clear()
        self._received_s = now_s
        if self._awaited is not None and now_s > self._awaited.until_s:
            self._awaited = None
        self._fragments.append(received)
        while len(self._fragments) > 1 and (
            sum(map(len, self._fragments)) > MAX_FRAME_BYTES or len(self._fragments) > _MAX_FRAGMENTS
        ):
            self.counters.errors += 1
            del self._fragments[0]
        for first in range(len(self._fragments)):
            whole = b"".join(self._fragments[first:])
            frames = frames_of(whole, self._unit_id)
            if frames is not None:
                return self._take(frames, now_s)
            if first == 0 and self._awaited is not None and self._awaited.is_begun_by(whole):
                if len(whole) < self._awaited.length:
                    return None  # the rest follows
                if len(whole) == self._awaited.length:
                    self.counters.errors += 1
                    self.reset()  # damaged in transit
                    return None
        request = request_after_noise(received, self._unit_id)
        if request is not None:
            self.counters.errors += 1
            self.counters.messages += 1
            self.reset()
        return request

    def reset(self) -> None:
        """Discard the bytes received so far, and await no response."""
        self._fragments.clear()
        self._awaited = None

    def _take(self, frames: list[bytes], now_s: float) -> bytes | None:
        awaited, last = self._awaited, frames[-1]
        self.reset()
        self.counters.messages += len(frames)
        if last[0] == self._unit_id:
            if last[1] in _BIT_READS | _REGISTER_READS and len(last) == 9 and last[-1] == 0:
                return last[1:6]  # see _GLITCHES
            return last[1:-2]
        is_answer = awaited is not None and awaited.is_begun_by(last) and len(last) == awaited.length
        if not (is_answer and len(frames) == 1):
            self._awaited = _AwaitedResponse.after(last, now_s)
        return None


def frames_of(received: bytes, unit_id: int) -> list[bytes] | None:
    """Return ``received`` as a sequence of whole frames; None if it is something else.

    A frame of another unit has a length that its function allows; one to ``unit_id`` may be malformed.
    """
    begun_at: dict[int, int] = {}  # the end of a frame, and the start of the first one with that end
    begins = [0]
    while begins:
        begin = begins.pop()
        for end in _ends_of_frames(received, begin):
            frame = received[begin:end]
            is_frame = frame[0] == unit_id or (frame[0] <= MAX_UNIT_ID and _has_its_length(frame))
            if is_frame and end not in begun_at:
                begun_at[end] = begin
                begins.append(end)
    frames, end = list[bytes](), len(received)
    while end > 0:
        if end not in begun_at:
            return None
        frames.append(received[begun_at[end] : end])
        end = begun_at[end]
    return frames[::-1]


def request_after_noise(received: bytes, unit_id: int) -> bytes | None:
    """Return the request to this unit, without id and CRC, at the end of bytes that are not frames."""
    for glitch in _GLITCHES:
        for length, head in _REQUESTS_AFTER_NOISE:
            frame = received.removesuffix(glitch)[-length:]
            is_request = frame.startswith(bytes([unit_id]) + head) and len(frame) == length
            if is_request and register_after(frame) == 0:
                return frame[1:-2]
    return None


def _ends_of_frames(received: bytes, begin: int) -> list[int]:
    """Return the possible ends of a frame that starts at ``begin``, by a correct CRC, the last first."""
    register, ends = START, []
    for place in range(begin, min(len(received), begin + MAX_FRAME_BYTES)):
        register = (register >> 8) ^ TABLE[(register ^ received[place]) & 0xFF]
        if register == 0 and place + 1 - begin >= MIN_FRAME_BYTES:
            ends.append(place + 1)
    return ends[::-1]


def _has_its_length(frame: bytes) -> bool:
    """Whether a request or response of its function can have this length; True for other functions."""
    function, length = frame[1], len(frame)
    if function & _EXCEPTION_BIT:
        return length == 5
    if function in _BIT_READS | _REGISTER_READS:
        return length in (8, 5 + frame[2])
    if function in _SINGLE_WRITES:
        return length == 8
    if function in _MULTIPLE_WRITES:
        return length == 8 or (length > 8 and length == 9 + frame[6])
    return True


MAX_UNCLEAR_LOOPBACKS = 16
"""Maximum number of loopbacks in a row that are answered before it is known whether the line echoes."""


class EchoDetector:
    """Tells the echo of an answer, which a two-wire adapter may receive, from a request with equal bytes.

    An answer that differs from its request is no request of a master: if it comes back, the line echoes. If
    another request follows an answer directly, the line does not. Until then, equal bytes are unclear.
    """

    def __init__(self) -> None:
        self._line_echoes: bool | None = None
        self._answer = b""
        self._until_s = 0.0
        self._is_own = False
        """Whether no master sends these bytes."""
        self._is_disturbed = False
        self._unclear = 0

    def answered(self, request: bytes, answer: bytes, until_s: float) -> None:
        """Note the last answer, with id and CRC as its request; ``until_s``: the latest end of an echo."""
        self._answer, self._until_s, self._is_own = answer, until_s, answer != request
        self._is_disturbed = False

    def disturbed(self) -> None:
        """Note bytes that are no request: one of them may be a damaged echo."""
        self._is_disturbed = True

    def is_request(self, received: bytes, frame: bytes, now_s: float) -> bool | None:
        """Whether ``frame`` at the end of the received bytes is a request; False: an echo; None: unclear."""
        answer, self._answer = self._answer, b""  # an echo comes once
        if frame == answer and self._is_own:
            self._line_echoes = True
            return False
        if frame == answer and now_s < self._until_s:
            if self._line_echoes is None:
                self._unclear += 1
                is_loopback = frame[1] == DIAGNOSTICS  # a command must not run again for its echo
                return True if is_loopback and self._unclear < MAX_UNCLEAR_LOOPBACKS else None
            return not self._line_echoes
        self._unclear = 0
        if answer and received == frame != answer and not self._is_disturbed:
            self._line_echoes = False
        return True


BITS_PER_CHARACTER = 11

MAX_BUFFERED_BYTES = 1024
"""Maximum number of stored bytes without a silence: a busy computer receives several frames at once."""


def silence_s(baud: int) -> float:
    """Return the silence that ends a frame: 3.5 characters, above 19200 baud 1.75 ms (Serial 2.5.1.1)."""
    return 1.75e-3 if baud > 19200 else 3.5 * BITS_PER_CHARACTER / baud


class ModbusRtuPublisher:
    """Serves the unit over Modbus RTU; answers only requests to its own unit id."""

    def __init__(self, settings: ModbusRtuPortSettings, unit: PublishedUnit, component: Component) -> None:
        self._settings = settings
        self._responder = Responder(settings, unit, component)
        self._component = component
        self._unit = unit

    async def run(self, ready: Callable[[], None]) -> None:
        """Serve until cancelled; raises OSError if the port is not available or is lost."""
        async with opened(self._settings, limit=MAX_FRAME_BYTES, fresh=True) as port:
            ready()
            unit = f"unit id {self._settings.unit_id} on {describe(self._settings)}"
            self._component.set_state(State.OK, f"Modbus RTU, {unit}")
            await self._serve(port)

    async def _serve(self, port: Port) -> None:
        clock = asyncio.get_running_loop().time
        bus, echo = Bus(self._settings.unit_id), EchoDetector()
        while True:
            received = await port.read() + await self._until_silence(port)
            request = bus.receive(received[-MAX_BUFFERED_BYTES:], clock())
            if request is None:
                echo.disturbed()
                continue
            frame = self._framed(request)
            if (is_request := echo.is_request(received, frame, clock())) is False:
                continue
            if is_request:
                answer = self._framed(self._response(request, bus.counters))
            else:  # no master sends this answer, so the next bytes show whether the line echoes
                answer = self._framed(bytes([request[0] | _EXCEPTION_BIT, ExceptionCode.DEVICE_BUSY]))
                bus.counters.exceptions += 1
            if not port.write(answer):  # the controller is not receiving; it repeats the request
                self._component.count("answers_dropped")
                bus.counters.unanswered += 1
                continue
            on_line_s = seconds_on_line(self._settings, len(answer))
            echo.answered(frame, answer, clock() + on_line_s + FRAGMENT_TIMEOUT_S)

    def _response(self, request: bytes, counters: LineCounters) -> bytes:
        counters.requests += 1
        response = serial_response(request, counters, self._unit.facts) or self._responder.answer(request)
        counters.exceptions += response[0] >= _EXCEPTION_BIT
        return response

    async def _until_silence(self, port: Port) -> bytes:
        """Return the bytes received before the line falls silent."""
        received = b""
        with contextlib.suppress(TimeoutError):
            while True:
                async with asyncio.timeout(silence_s(self._settings.baud)):
                    received = (received + await port.read())[-MAX_BUFFERED_BYTES:]
        return received

    def _framed(self, answer: bytes) -> bytes:
        return with_crc(bytes([self._settings.unit_id]) + answer)
