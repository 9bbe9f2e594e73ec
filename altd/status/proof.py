"""The identity of a message for its reader: its unit, its session, its number, its time.

These and the CRC are the measures of a black channel against the errors of a line (EN 50159, 7.3;
IEC 61784-3, 5.4). ``docs/proof.md`` says how a reader checks them.
"""

from __future__ import annotations

import secrets
import zlib
from dataclasses import dataclass
from typing import Protocol, Self

_NOT_KNOWN = 0xFFFF_FFFF
"""No number that is sent is all ones: in registers that is "not known" (``docs/modbus.md``)."""


@dataclass(frozen=True, slots=True)
class Identity:
    """Which unit this is and which run of its daemon; None: not known."""

    unit: int | None = None
    session: int | None = None

    @classmethod
    def drawn(cls, serial: str) -> Self:
        """The identity of a daemon that starts now; its session is a random number, never 0."""
        return cls(unit_number(serial), 1 + secrets.randbelow(_NOT_KNOWN - 1))


@dataclass(frozen=True, slots=True)
class Stamp:
    """One message of one interface.

    ``message`` counts the messages of this interface from 1, ``clock_ms`` the milliseconds since the daemon
    started; 0xFFFFFFFE is followed by 0 in both.
    """

    identity: Identity
    message: int
    clock_ms: int


class Running(Protocol):
    """An object that knows its identity and the time since its start: the board."""

    @property
    def identity(self) -> Identity:
        """Which unit, which session."""

    def running_ns(self) -> int:
        """Nanoseconds since the start."""


class Stamps:
    """The stamps of one interface, one for each message that it sends."""

    def __init__(self, running: Running) -> None:
        self._running = running
        self._messages = 0

    def next(self) -> Stamp:
        """The stamp of a message that is sent now."""
        self._messages += 1
        clock_ms = self._running.running_ns() // 1_000_000
        return Stamp(self._running.identity, self._messages % _NOT_KNOWN, clock_ms % _NOT_KNOWN)


def unit_number(serial: str) -> int:
    """The CRC-32 of a serial number in UTF-8, by which every message names its unit."""
    return min(crc32(serial.encode()), _NOT_KNOWN - 1)


def crc32(data: bytes) -> int:
    """The CRC-32 of IEEE 802.3 (polynomial 0x04C11DB7, reflected, begun with and inverted by all ones)."""
    return zlib.crc32(data)


def sealed(line: str) -> str:
    """A JSON object in one line, ASCII, with ``crc32`` as its last member: of all bytes before that."""
    body = line.removesuffix("}")
    return f'{body}, "crc32": "{crc32(body.encode("ascii")):08X}"}}'


def is_sealed(message: bytes) -> bool:
    """Whether a message ends with the right ``crc32``."""
    body, _, rest = message.rpartition(b', "crc32": ')
    return rest == b'"%08X"}' % crc32(body)
