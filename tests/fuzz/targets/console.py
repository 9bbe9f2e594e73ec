"""Keys into the console, on a pseudo terminal: plain text comes back, and the next person is answered."""

import asyncio
import contextlib
import os
import re
import tty
from dataclasses import replace
from typing import Any

from fuzz.served import Faces, served
from fuzz.spoil import spoilt_bytes
from hypothesis import strategies as st

from altd.config import ConsolePortSettings
from altd.publish.serial import publisher as serial_publisher
from altd.publish.serial.keys import PASTE_TIMEOUT_S
from altd.publish.serial.publisher import ConsolePublisher
from tools.pages.example import MEASURED

NAME = "console"
WIDTH = 80

_SEQUENCES = rb"""
\e[A \e[B \e[C \e[D \eOA \e[H \e[4~ \e[3~ \e[1;5C \eOP \e[15~ \e[[A \e[M!!! \e[?62;22c \e[24;80R \x9bA \x8fP
\e[200~ \e[201~ \e[200~measure\rhelp\r\e[201~ \e]0;status\x07 \ePq\e\\ \xff\xfb\x01 \xff\xfd \xff\xf1
\xff\xfa\x18\0xterm\xff\xf0 \e \e[ \eO \x01 \x05 \x17 \x0b \x0c \x10 \x04 \e\x7f \xc3\xa4 \xe4 \x8d \x20
"""
# keys, reports and pastes as xterm, VT220, PuTTY, minicom, the Linux console and telnet send them

_LINES = rb"""
help\r status\r\n status\x20all\r measure\n watch\r watch\x200.1\r watch\x201e400\r watch\x20nan\r
?\r exit\r version\r selfcheck\r selfcheck\x20now\r selfcheck\x20now\x20now\r
\e[A\e[B\eOP \x7f\x08\x08 \x03 \x15 \xff\0\xfe no\x20such\x20thing\r \r\n\n\r
"""


def _bytes_of(words: bytes) -> list[bytes]:
    """The words, each with its escapes carried out; ``\\e`` is ESC."""
    escaped = (word.decode("ascii").replace(r"\e", r"\x1b") for word in words.split())
    return [word.encode("ascii").decode("unicode_escape").encode("latin-1") for word in escaped]


_TYPED = st.sampled_from(_bytes_of(_LINES + _SEQUENCES))
_SESSIONS = st.lists(_TYPED, min_size=1, max_size=12).map(b"".join)
EXAMPLES = (_SESSIONS | spoilt_bytes(_SESSIONS)).map(lambda keys: keys[:1500])

CONTROL = re.compile(rb"[^\x20-\x7e\r\n\x08]")


class _Line:
    """A pseudo terminal whose near end the console opens."""

    def __init__(self, faces: Faces) -> None:
        faces.published.self_check.open(lambda: None)
        serial_publisher.READ_INTERVAL_S = (
            0.0  # the rest after each turn: examples are tried one behind the other
        )
        self.far, near = os.openpty()
        os.set_blocking(self.far, False)
        tty.setraw(near)
        settings = ConsolePortSettings.model_validate({"device": os.ttyname(near), "speaks": "console"})
        component = faces.component(NAME)
        self._console = ConsolePublisher(settings, faces.published, component)

    async def run(self, ready: Any) -> None:
        await self._console.run(ready)


_face = served(_Line)


def check(example: bytes) -> None:
    """No control characters, no line wider than a screen; afterwards ``measure`` shows the measurement."""
    faces, line = _face()
    shown = faces.do(_session(faces, line, example))
    assert not CONTROL.search(shown), shown
    for row in shown.split(b"\r\n"):
        assert b"\n" not in row
        assert _columns(row) < WIDTH


def _columns(row: bytes) -> int:
    """The rightmost column of a terminal's cursor; it goes left of the first column never."""
    at = rightmost = 0
    for shown in row:
        at = 0 if shown == ord("\r") else at - 1 if shown == ord("\b") else at + 1
        assert at >= 0, row
        rightmost = max(rightmost, at)
    return rightmost


async def _session(faces: Faces, line: _Line, keys: bytes) -> bytes:
    """The output for the keys; then the rest that they left is ended and the console asked."""
    _read(line.far)
    shown = b""
    for begin in range(0, len(keys), 100):
        os.write(line.far, keys[begin : begin + 100])
        shown += await _heard(line.far, 0.0)
    ended = b""
    async with asyncio.timeout(10.0):
        while b"no command 'is-it-over'" not in ended:  # again where the kernel hands keys over late
            await faces.clock.advance(2.0 * PASTE_TIMEOUT_S)  # no input: every key that was begun is over
            os.write(line.far, b"q\x15\ris-it-over\r")
            for _ in range(20):
                ended += await _heard(line.far, 0.001)
                if ended.endswith(b"\r\n> "):
                    break
    shown += ended
    faces.board.publish(replace(MEASURED, t_ns=faces.clock.monotonic_ns()))
    os.write(line.far, b"measure\r")
    answer = b""
    async with asyncio.timeout(10.0):
        while not answer.endswith(b"not available\r\n> "):
            answer += await _heard(line.far, 0.001)
    assert b"  x          10.012 mm  +/- 0.004, now 0." in answer, answer
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
