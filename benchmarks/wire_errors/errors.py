"""The errors of IEC 61784-3, 5.3 as what a line makes of the messages that are put into it."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from random import Random

from benchmarks.wire_errors.payloads import Payload

LIMIT_S = 0.15
"""The oldest value that the reader may use."""

HOLD_S = 0.2
"""For how long a delayed message is held."""

_KEPT = 50


@dataclass(frozen=True, slots=True)
class Delivery:
    """What the line hands to the reader, after a while; None: nothing, though something is due.

    ``is_spoilt``: this is the error that the reader has to find.
    """

    content: bytes | None
    is_spoilt: bool = False
    hold_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Line:
    """What stands at the line's far end: this unit, another one, and the content of their messages."""

    unit: Callable[[], bytes]
    other: Callable[[], bytes]
    payload: Payload
    chance: Random
    is_polled: bool


Error = Callable[[Line], Iterator[Delivery]]
"""Deliveries for ever, good and spoilt by turns."""


def corruption(line: Line) -> Iterator[Delivery]:
    """Bits turned round; the wire's own checksum is made to fit."""
    while True:
        yield Delivery(line.unit())
        yield Delivery(line.payload.spoil(line.unit(), line.chance), True)


def repetition(line: Line) -> Iterator[Delivery]:
    """The message before, once more."""
    while True:
        message = line.unit()
        yield Delivery(message)
        yield Delivery(message, True)


def loss(line: Line) -> Iterator[Delivery]:
    """No answer; on a wire without requests the message after it has to show the loss."""
    while True:
        yield Delivery(line.unit())
        lost = line.unit()
        yield Delivery(None if line.is_polled and lost else line.unit(), True)


def insertion(line: Line) -> Iterator[Delivery]:
    """A message of a while ago, of this session and with a CRC that fits."""
    said: deque[bytes] = deque(maxlen=_KEPT)
    said.append(line.unit())
    while True:
        message = line.unit()
        yield Delivery(message)
        yield Delivery(line.chance.choice(said), True)
        said.append(message)


def wrong_order(line: Line) -> Iterator[Delivery]:
    """Two messages, the later one first."""
    while True:
        first, second = line.unit(), line.unit()
        yield Delivery(second)
        yield Delivery(first, True)


def delay(line: Line) -> Iterator[Delivery]:
    """A message that is held on its way."""
    while True:
        yield Delivery(line.unit())
        yield Delivery(line.unit(), True, HOLD_S)


def masquerade(line: Line) -> Iterator[Delivery]:
    """A sender that does as if it was the unit, and knows nothing of the CRC-32."""
    while True:
        yield Delivery(line.unit())
        yield Delivery(line.payload.imitate(line.unit(), line.chance), True)


def wrong_address(line: Line) -> Iterator[Delivery]:
    """A good message of another unit of the same kind."""
    while True:
        yield Delivery(line.unit())
        yield Delivery(line.other(), True)


ERRORS: dict[str, Error] = {
    "corruption": corruption,
    "repetition": repetition,
    "loss": loss,
    "insertion": insertion,
    "wrong order": wrong_order,
    "delay": delay,
    "masquerade": masquerade,
    "wrong address": wrong_address,
}
