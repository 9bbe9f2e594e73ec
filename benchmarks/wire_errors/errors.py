"""Errors of IEC 61784-3, 5.3, as changes that a line makes to the messages sent on it.

Content is corrupted so that the wire's own checks still pass: only the CRC-32 can detect it.
"""

import re
import struct
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import reduce
from operator import xor
from random import Random

Change = Callable[[bytes, Random], bytes]

_BREAKS_THE_LINE = b"\r\n"
_FOREIGN_SENTENCE = b"$GPGGA,081530.12,4717.11,N,00833.91,E,1,08,1.01,499.6,M,48.0,M,,0*5B\r\n"


@dataclass(frozen=True, slots=True)
class Payload:
    """A kind of content: ``spoil`` inverts bits, ``imitate`` makes other content without a new CRC-32."""

    spoil: Change
    imitate: Change


def turned(content: bytes, chance: Random) -> bytes:
    """Content with one, a few or many inverted bits."""
    spoilt = bytearray(content)
    bits = chance.choice((1, 1, 2, 3, 8, 32, 100))
    for place in chance.sample(range(8 * len(content)), bits):
        spoilt[place // 8] ^= 1 << place % 8
    return bytes(spoilt)


def _turned_text(content: bytes, chance: Random) -> bytes:
    """Line of text with inverted bits, which stays one line."""
    while True:
        spoilt = turned(content, chance)
        if not set(_BREAKS_THE_LINE) & set(spoilt):
            return spoilt


def _with_checksums(telegram: bytes) -> bytes:
    """Telegram with a correct checksum in every sentence."""

    def summed(found: re.Match[bytes]) -> bytes:
        return b"$%s*%02X" % (found[1], reduce(xor, found[1], 0))

    return re.sub(rb"\$([^$*]*)\*[^\r]{2}", summed, telegram)


def _spoilt_telegram(content: bytes, chance: Random) -> bytes:
    while True:
        spoilt = _with_checksums(turned(content, chance))
        if spoilt != content:  # else only a checksum was inverted, and then corrected
            return spoilt


def _imitated_block(content: bytes, chance: Random) -> bytes:
    """Another beam position under this unit's name, or registers of some other device at these addresses."""
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


LIMIT_S = 0.15
"""Maximum age of a value that the reader may use."""

HOLD_S = 0.2
"""Time for which a delayed message is held."""

_KEPT = 50


@dataclass(frozen=True, slots=True)
class Delivery:
    """Message that the line delivers after ``hold_s``; None: nothing, although a message is due.

    ``is_spoilt``: this is the error that the reader has to detect.
    """

    content: bytes | None
    is_spoilt: bool = False
    hold_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Line:
    """Far end of the line: this unit, another one, and the content of their messages."""

    unit: Callable[[], bytes]
    other: Callable[[], bytes]
    payload: Payload
    chance: Random
    is_polled: bool


Error = Callable[[Line], Iterator[Delivery]]
"""Endless deliveries, alternately good and corrupted."""


def _each_second(spoilt: Callable[[Line], Delivery]) -> Error:
    def deliveries(line: Line) -> Iterator[Delivery]:
        while True:
            yield Delivery(line.unit())
            yield spoilt(line)

    return deliveries


def _repetition(line: Line) -> Iterator[Delivery]:
    while True:
        message = line.unit()
        yield Delivery(message)
        yield Delivery(message, True)


def _lost(line: Line) -> Delivery:
    lost = line.unit()
    return Delivery(None if line.is_polled and lost else line.unit(), True)


def _insertion(line: Line) -> Iterator[Delivery]:
    said = deque([line.unit()], maxlen=_KEPT)
    while True:
        message = line.unit()
        yield Delivery(message)
        yield Delivery(line.chance.choice(said), True)
        said.append(message)


def _wrong_order(line: Line) -> Iterator[Delivery]:
    while True:
        first, second = line.unit(), line.unit()
        yield Delivery(second)
        yield Delivery(first, True)


ERRORS: dict[str, Error] = {
    # bits inverted; the wire's own checksum is corrected
    "corruption": _each_second(lambda line: Delivery(line.payload.spoil(line.unit(), line.chance), True)),
    # the previous message, once more
    "repetition": _repetition,
    # no answer; on a wire without requests the message after it has to reveal the loss
    "loss": _each_second(_lost),
    # an earlier message of this session, with a matching CRC
    "insertion": _insertion,
    # two messages, the later one first
    "wrong order": _wrong_order,
    # a message that is held in transfer
    "delay": _each_second(lambda line: Delivery(line.unit(), True, HOLD_S)),
    # a sender that imitates the unit without a new CRC-32
    "masquerade": _each_second(lambda line: Delivery(line.payload.imitate(line.unit(), line.chance), True)),
    # a good message of another unit of the same kind
    "wrong address": _each_second(lambda line: Delivery(line.other(), True)),
}
