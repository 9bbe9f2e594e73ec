"""What is said on a Modbus line, followed from silence to silence: whose frames these are, and which asks us.

"Serial" is the Modbus over Serial Line Specification V1.02, "Application" the Modbus Application Protocol
V1.1b3. A frame begins after a silence, and its CRC says where it ends (Serial 2.5.1). The end of another
unit's answer can be, byte for byte, a request to this unit with a CRC that fits. So the bytes since a silence
are first read as whole frames, one behind the other, with the answer that is due on the bus in mind; only
where that does not work, after noise, is a request looked for at their end.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

from pymodbus.framer import FramerRTU

LONGEST = 256
"""Bytes of the longest frame (Serial 2.5.1)."""

SHORTEST = 4
"""Unit id, function and CRC."""

MAX_UNIT_ID = 247
"""The largest unit id; 0 is everybody (Serial 2.2)."""

_MOST_PIECES = 16
"""In which adapters tear a frame. More is noise, and each costs a look at all that begin before it."""
TORN_S = 0.1
"""A silence that no frame bridges. The specification says 1.5 characters (Serial 2.5.1.1), but USB adapters
hand over what they have every 16 ms."""

ANSWER_TIMEOUT_S = 1.0
"""A unit that has not answered by then is not waited for (Serial 2.4.1: "from 1 s to several seconds")."""

_BIT_READS, _REGISTER_READS, _SINGLE_WRITES, _MULTIPLE_WRITES = {1, 2}, {3, 4}, {5, 6}, {15, 16}
"""Functions by the lengths of their frames (Application 6.1 to 6.6, 6.11, 6.12)."""

_FAILED = 0x80

_REQUESTS_AFTER_NOISE = ((8, bytes([3])), (8, bytes([4])), (7, bytes([43, 14])))
"""Length and first bytes of the requests that are looked for behind noise."""


def _crc_table() -> tuple[int, ...]:
    """The table of the CRC with the polynomial 0xA001 (Serial 6.2.2)."""
    table = []
    for register in range(256):
        for _ in range(8):
            register = (register >> 1) ^ (0xA001 if register & 1 else 0)
        table.append(register)
    return tuple(table)


_CRC = _crc_table()


@dataclass(frozen=True, slots=True)
class _Due:
    """The answer that another unit owes."""

    unit_id: int
    function: int
    length: int
    until_s: float

    @classmethod
    def after(cls, frame: bytes, now_s: float) -> Self | None:
        """What follows a frame, if that is a request whose answer's length is known."""
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
        return cls(unit_id, function, length, now_s + ANSWER_TIMEOUT_S)

    def is_begun_by(self, heard: bytes) -> bool:
        """Whether the answer can begin, or be damaged, like this."""
        return heard[0] == self.unit_id and heard[1:2] in (b"", bytes([self.function]))


class Bus:
    """Follows one line for one unit."""

    def __init__(self, unit_id: int) -> None:
        self._unit_id = unit_id
        self._pieces: list[bytes] = []
        self._heard_s = float("-inf")
        self._due: _Due | None = None

    def hear(self, heard: bytes, now_s: float) -> bytes | None:
        """Take what was heard up to a silence; the request to this unit that ends there, without id, CRC."""
        if now_s - self._heard_s > TORN_S:
            self._pieces.clear()
        self._heard_s = now_s
        if self._due is not None and now_s > self._due.until_s:
            self._due = None
        self._pieces.append(heard)
        while len(self._pieces) > 1 and (
            sum(map(len, self._pieces)) > LONGEST or len(self._pieces) > _MOST_PIECES
        ):
            del self._pieces[0]
        for first in range(len(self._pieces)):
            whole = b"".join(self._pieces[first:])
            frames = frames_of(whole, self._unit_id)
            if frames is not None:
                return self._take(frames, now_s)
            if first == 0 and self._due is not None and self._due.is_begun_by(whole):
                if len(whole) < self._due.length:
                    return None  # the rest is to come
                if len(whole) == self._due.length:
                    self.forget()  # damaged on its way
                    return None
        request = request_after_noise(heard, self._unit_id)
        if request is not None:
            self.forget()
        return request

    def forget(self) -> None:
        """What was heard so far is done with."""
        self._pieces.clear()
        self._due = None

    def _take(self, frames: list[bytes], now_s: float) -> bytes | None:
        due, last = self._due, frames[-1]
        self.forget()
        if last[0] == self._unit_id:
            return last[1:-2]
        is_answer = due is not None and due.is_begun_by(last) and len(last) == due.length
        if not (is_answer and len(frames) == 1):
            self._due = _Due.after(last, now_s)
        return None


def frames_of(heard: bytes, unit_id: int) -> list[bytes] | None:
    """``heard`` as whole frames, one behind the other; None when it is something else.

    A frame of another unit has a length that its function knows; one to ``unit_id`` may be malformed.
    """
    begun_at: dict[
        int, int
    ] = {}  # where a frame ends, and where the first that was found to end there begins
    begins = [0]
    while begins:
        begin = begins.pop()
        for end in _ends_of_frames(heard, begin):
            frame = heard[begin:end]
            is_frame = frame[0] == unit_id or (frame[0] <= MAX_UNIT_ID and _has_its_length(frame))
            if is_frame and end not in begun_at:
                begun_at[end] = begin
                begins.append(end)
    frames, end = list[bytes](), len(heard)
    while end > 0:
        if end not in begun_at:
            return None
        frames.append(heard[begun_at[end] : end])
        end = begun_at[end]
    return frames[::-1]


def request_after_noise(heard: bytes, unit_id: int) -> bytes | None:
    """The request to this unit at the end of bytes that are no frames, without id and CRC."""
    for length, head in _REQUESTS_AFTER_NOISE:
        frame = heard[-length:]
        if frame.startswith(bytes([unit_id]) + head) and len(frame) == length:
            crc = int.from_bytes(frame[-2:], "big")
            if FramerRTU.check_CRC(frame[:-2], crc):
                return frame[1:-2]
    return None


def _ends_of_frames(heard: bytes, begin: int) -> list[int]:
    """Where a frame that begins there may end, the last place first: its CRC leaves nothing over."""
    register, ends = 0xFFFF, []
    for place in range(begin, min(len(heard), begin + LONGEST)):
        register = (register >> 8) ^ _CRC[(register ^ heard[place]) & 0xFF]
        if register == 0 and place + 1 - begin >= SHORTEST:
            ends.append(place + 1)
    return ends[::-1]


def _has_its_length(frame: bytes) -> bool:
    """Whether a request or an answer of this function can be so long; of most functions it is not known."""
    function, length = frame[1], len(frame)
    if function & _FAILED:
        return length == 5
    if function in _BIT_READS | _REGISTER_READS:
        return length in (8, 5 + frame[2])
    if function in _SINGLE_WRITES:
        return length == 8
    if function in _MULTIPLE_WRITES:
        return length == 8 or (length > 8 and length == 9 + frame[6])
    return True
