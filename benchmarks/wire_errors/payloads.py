"""How a message's content is spoilt while the wire's own checks still pass: only the CRC-32 can tell."""

from __future__ import annotations

import re
import struct
from collections.abc import Callable
from dataclasses import dataclass
from functools import reduce
from operator import xor
from random import Random

Change = Callable[[bytes, Random], bytes]

_BREAKS_THE_LINE = b"\r\n"
_FOREIGN_SENTENCE = b"$GPGGA,081530.12,4717.11,N,00833.91,E,1,08,1.01,499.6,M,48.0,M,,0*5B\r\n"


@dataclass(frozen=True, slots=True)
class Payload:
    """A kind of content: ``spoil`` turns bits round, ``imitate`` makes another without a new CRC-32."""

    spoil: Change
    imitate: Change


def turned(content: bytes, chance: Random) -> bytes:
    """With one bit, a few or many turned round; at least one."""
    spoilt = bytearray(content)
    bits = chance.choice((1, 1, 2, 3, 8, 32, 100))
    for place in chance.sample(range(8 * len(content)), bits):
        spoilt[place // 8] ^= 1 << place % 8
    return bytes(spoilt)


def _turned_text(content: bytes, chance: Random) -> bytes:
    """The same of a line of text, which stays one line."""
    while True:
        spoilt = turned(content, chance)
        if not set(_BREAKS_THE_LINE) & set(spoilt):
            return spoilt


def _with_checksums(telegram: bytes) -> bytes:
    """Every sentence with the checksum that it should have."""

    def summed(found: re.Match[bytes]) -> bytes:
        return b"$%s*%02X" % (found[1], reduce(xor, found[1], 0))

    return re.sub(rb"\$([^$*]*)\*[^\r]{2}", summed, telegram)


def _spoilt_telegram(content: bytes, chance: Random) -> bytes:
    while True:
        spoilt = _with_checksums(turned(content, chance))
        if spoilt != content:  # else it was a checksum that was turned and made good again
            return spoilt


def _imitated_block(content: bytes, chance: Random) -> bytes:
    """Another place of the beam under this unit's name, or what some other device has at these addresses."""
    if chance.random() < 0.5:
        return content[:60] + struct.pack(">f", chance.uniform(-70, 70)) + content[64:]
    return chance.choice((bytes(160), b"\xff" * 160, chance.randbytes(160)))


def _imitated_telegram(content: bytes, chance: Random) -> bytes:
    if chance.random() < 0.2:
        return _FOREIGN_SENTENCE
    fields = content.split(b",")
    fields[4] = b"%.3f" % chance.uniform(-70, 70)
    return _with_checksums(b",".join(fields))


def _imitated_json(content: bytes, chance: Random) -> bytes:
    if chance.random() < 0.2:
        return b'{"x_mm": 1.0, "valid": true, "status": []}'
    return re.sub(rb'"x_mm": [-0-9.]+', b'"x_mm": %.3f' % chance.uniform(-70, 70), content, count=1)


BLOCK = Payload(turned, _imitated_block)
TELEGRAM = Payload(_spoilt_telegram, _imitated_telegram)
JSON = Payload(_turned_text, _imitated_json)
