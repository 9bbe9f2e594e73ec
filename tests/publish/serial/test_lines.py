"""Keys become lines, whatever the terminal sends."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from altd.publish.serial.lines import LONGEST_LINE, BadLine, LineEditor


def typed(data: bytes) -> tuple[bytes, list[str | BadLine]]:
    """The echo and the lines that came of some keys."""
    editor = LineEditor()
    taken = [editor.take(byte) for byte in data]
    echo = b"".join(piece for piece in taken if isinstance(piece, bytes))
    return echo, [piece for piece in taken if not isinstance(piece, bytes)]


@pytest.mark.parametrize(
    ("keys", "echo", "lines"),
    [
        (b"help\r", b"help", ["help"]),
        (b"help\n", b"help", ["help"]),
        (b"help\r\nstatus\r\n", b"helpstatus", ["help", "status"]),
        (b"\r\r\n\n", b"", ["", "", ""]),
        (b"hx\x7felp\r", b"hx\b \belp", ["help"]),
        (b"\x08\x08a\x08\x08\r", b"a\b \b", [""]),
        (b"stat\x15help\r", b"stat" + b"\b \b" * 4 + b"help", ["help"]),
        (b"stat\x03help\r", b"stat" + b"\b \b" * 4 + b"help", ["help"]),
        (b"he\x1b[Al\x1bOPp\x1b[15~\r", b"help", ["help"]),
        (b"\x1bhelp\r", b"help", ["help"]),
        (b"\x1b[" + b"1" * 40 + b"\rhelp\r", b"1" * 26 + b"help", ["1" * 26, "help"]),
        (b"a" * (LONGEST_LINE + 5) + b"\rhelp\r", b"a" * LONGEST_LINE + b"help", [BadLine.TOO_LONG, "help"]),
        (b"\xff\xfe\x00\x80\rhelp\r", b"help", [BadLine.NO_TEXT, "help"]),
        (b"\xff\x15help\r", b"help", ["help"]),
        ("hölp\r".encode(), b"h", [BadLine.NO_TEXT]),
    ],
)
def test_keys_become_lines(keys: bytes, echo: bytes, lines: list[str | BadLine]) -> None:
    assert typed(keys) == (echo, lines)


@given(st.binary(max_size=400))
def test_after_any_garbage_a_line_can_be_typed(garbage: bytes) -> None:
    echo, lines = typed(garbage + b"\r\rhelp\r")
    assert lines[-1] == "help"
    assert all(len(line) <= LONGEST_LINE for line in lines if isinstance(line, str))
    assert set(echo) <= set(range(0x20, 0x7F)) | {0x08}
