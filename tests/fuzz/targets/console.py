"""Keys into the console, on a pseudo terminal: plain text comes back, and the next person is answered."""

from __future__ import annotations

import asyncio
import contextlib
import os
import re
import tty
from typing import Any

from fuzz.served import Faces, served
from fuzz.spoil import spoilt_bytes
from hypothesis import strategies as st

from altd.config import SerialPort
from altd.publish.serial import publisher as serial_publisher
from altd.publish.serial.publisher import ConsolePublisher

NAME = "console"
WIDTH = 80

_LINES = (
    *(b"help\r", b"status\r\n", b"measure\n", b"watch\r", b"watch 0.1\r", b"watch 1e400\r", b"watch nan\r"),
    *(
        b"\x1b[A\x1b[B\x1bOP",
        b"\x7f\x08\x08",
        b"\x03",
        b"\x15",
        b"\xff\x00\xfe",
        b"no such thing\r",
        b"\r\n\n\r",
    ),
)
_SESSIONS = st.lists(st.sampled_from(_LINES), min_size=1, max_size=8).map(b"".join)
EXAMPLES = (_SESSIONS | spoilt_bytes(_SESSIONS)).map(lambda keys: keys[:1500])

_CONTROL = re.compile(rb"[^\x20-\x7e\r\n\x08]")


class _Line:
    """A pseudo terminal whose near end the console opens."""

    def __init__(self, faces: Faces) -> None:
        serial_publisher.PAUSE_S = 0.0  # the rest after each turn: examples are tried one behind the other
        self.far, near = os.openpty()
        os.set_blocking(self.far, False)
        tty.setraw(near)
        settings = SerialPort.model_validate({"device": os.ttyname(near), "speaks": "console"})
        self._console = ConsolePublisher(
            settings, faces.board, faces.health, faces.component(NAME), faces.clock
        )

    async def run(self, ready: Any) -> None:
        await self._console.run(ready)


_face = served(_Line)


def check(example: bytes) -> None:
    """No control characters, no line wider than a screen; afterwards ``measure`` shows the measurement."""
    faces, line = _face()
    shown = faces.do(_session(line.far, example))
    assert not _CONTROL.search(shown), shown
    for row in shown.split(b"\r\n"):
        visible = row.replace(b"\b \b", b"").rpartition(b"\r")[2]
        assert b"\n" not in row
        assert len(visible) <= WIDTH + len(example)


async def _session(far: int, keys: bytes) -> bytes:
    """What is shown for the keys; then whatever they left behind is ended and the console asked."""
    _read(far)
    shown = b""
    for begin in range(0, len(keys), 100):
        os.write(far, keys[begin : begin + 100])
        shown += await _heard(far, 0.0)
    os.write(far, b"q\x15\r")
    shown += await _heard(far, 0.003)
    os.write(far, b"measure\r")
    answer = b""
    async with asyncio.timeout(10.0):
        while not answer.endswith(b"not available\r\n> "):
            answer += await _heard(far, 0.001)
    assert b"  x          10.012 mm  +/- 0.004\r\n" in answer, answer
    return shown


async def _heard(far: int, at_least_s: float) -> bytes:
    await asyncio.sleep(at_least_s)
    return _read(far)


def _read(far: int) -> bytes:
    heard = b""
    with contextlib.suppress(BlockingIOError):
        while True:
            heard += os.read(far, 65536)
    return heard
