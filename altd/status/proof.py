"""Identity of a message for its reader: its unit, its session, its number, its time.

With the CRC, these are a black channel's measures against transmission errors (EN 50159, 7.3; IEC 61784-3,
5.4). ``docs/proof.md`` describes the reader's checks.
"""

from __future__ import annotations

import secrets
import zlib
from dataclasses import dataclass
from typing import Protocol, Self

_NOT_KNOWN = 0xFFFF_FFFF
"""Value of all ones, which is never sent: in registers it means "not known" (``docs/modbus.md``)."""


@dataclass(frozen=True, slots=True)
class Identity:
    """Number of the unit and of the daemon's session; None: not known."""

    unit: int | None = None
    session: int | None = None

    @classmethod
    def drawn(cls, serial: str) -> Self:
        """Return the identity of a daemon that starts now; its session is a random number, never 0."""
        return cls(unit_number(serial), 1 + secrets.randbelow(_NOT_KNOWN - 1))


@dataclass(frozen=True, slots=True)
class Stamp:
    """Stamp of one message of one interface.

    ``message`` counts the messages of this interface, ``clock_ms`` the milliseconds since the daemon started;
    both continue with 0 after 0xFFFFFFFE.
    """

    identity: Identity
    message: int
    clock_ms: int


class Running(Protocol):
    """An object with an identity, the time since its start, and the counts of its messages: the board."""

    @property
    def messages(self) -> dict[str, int]:
        """Number of messages that each interface has sent in this session, by the interface's component."""

    @property
    def identity(self) -> Identity:
        """Numbers of the unit and of the session."""

    def running_ns(self) -> int:
        """Return the nanoseconds since the start."""


class Stamps:
    """Stamps of one interface, one for each message that it sends.

    Within a session the numbers of an interface never go back: one that is opened again continues, and one
    that is added begins above all others, since a client may follow it from another address.
    """

    def __init__(self, running: Running, interface: str) -> None:
        self._running = running
        self._interface = interface
        running.messages.setdefault(interface, max(running.messages.values(), default=0))

    def next(self) -> Stamp:
        """Return the stamp of a message that is sent now."""
        self._running.messages[self._interface] += 1
        message = self._running.messages[self._interface] % _NOT_KNOWN
        clock_ms = self._running.running_ns() // 1_000_000
        return Stamp(self._running.identity, message, clock_ms % _NOT_KNOWN)


def unit_number(serial: str) -> int:
    """Return the CRC-32 of a serial number in UTF-8, the unit's number in every message."""
    return min(crc32(serial.encode()), _NOT_KNOWN - 1)


def crc32(data: bytes) -> int:
    """Return the CRC-32 of IEEE 802.3 (polynomial 0x04C11DB7, reflected, initial and final XOR all ones)."""
    return zlib.crc32(data)


def sealed(line: str) -> str:
    """Append ``crc32`` of all bytes before it to a JSON object, in one line of ASCII."""
    body = line.removesuffix("}")
    return f'{body}, "crc32": "{crc32(body.encode("ascii")):08X}"}}'


def is_sealed(message: bytes) -> bool:
    """Whether a message ends with the right ``crc32``."""
    body, _, rest = message.rpartition(b', "crc32": ')
    return rest == b'"%08X"}' % crc32(body)
