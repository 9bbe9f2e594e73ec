"""Terminals with a wrong speed or parity, bit by bit as a UART sees them."""

import pytest

from altd.publish.serial.console import Console
from tools.pages.example import MEASURED
from tools.pages.serial_examples import unit_that_shows

WRONG = b"wrong baud rate or parity"


def line_of(data: bytes, baud: int, *, bits: int, parity: str) -> list[tuple[float, int]]:
    """When the line takes which level: start bit, data, parity, stop bit; 0.1 s from key to key."""
    levels = []
    for number, byte in enumerate(data):
        frame = [0, *((byte >> bit) & 1 for bit in range(bits))]
        if parity != "none":
            frame.append((sum(frame) + (parity == "odd")) % 2)
        levels += [(0.1 * number + place / baud, level) for place, level in enumerate([*frame, 1])]
    return levels


def heard(levels: list[tuple[float, int]], baud: int) -> bytes:
    """The bytes as a UART with eight data bits and no parity reads them: sampled in the middle of its bits.

    A byte whose stop bit is missing is passed on, as Linux does without INPCK.
    """

    def level_at(t_s: float) -> int:
        return next((level for begin_s, level in reversed(levels) if begin_s <= t_s), 1)

    found, t_s = bytearray(), 0.0
    for begin_s, level in levels:
        if level or begin_s < t_s:
            continue
        middle_s = begin_s + 0.5 / baud
        if level_at(middle_s):
            continue  # a spike
        found.append(sum(level_at(middle_s + (bit + 1) / baud) << bit for bit in range(8)))
        t_s = middle_s + 9 / baud
    return bytes(found)


def answer(keys: bytes) -> bytes:
    console = Console(unit_that_shows(MEASURED))
    return console.feed(keys) + console.rest()


def test_the_model_of_the_line_carries_what_is_set_up_rightly() -> None:
    assert heard(line_of(b"measure\r", 9600, bits=8, parity="none"), 9600) == b"measure\r"
    assert heard(line_of(b"measure\r", 9600, bits=8, parity="even"), 9600) == b"measure\r"


@pytest.mark.parametrize("baud", [1200, 2400, 4800, 19200, 38400, 57600, 115200])
@pytest.mark.parametrize("line", [b"help\r", b"status\r", b"measure\r"])
def test_lines_at_a_wrong_speed_are_told_when_the_right_one_is_set(baud: int, line: bytes) -> None:
    """Three tries, then the technician finds the speed and presses Enter."""
    keys = heard(line_of(line * 3, baud, bits=8, parity="none"), 9600)
    shown = answer(keys + b"\r")
    assert WRONG in shown
    assert b"measurement" not in shown


@pytest.mark.parametrize("parity", ["even", "none"])
@pytest.mark.parametrize("line", [b"\r", b"help\r", b"status\r", b"measure\r"])
def test_seven_data_bits_are_told_although_their_enter_is_none(parity: str, line: bytes) -> None:
    assert WRONG in answer(heard(line_of(line, 9600, bits=7, parity=parity), 9600))


def test_seven_data_bits_with_odd_parity_are_told() -> None:
    for line in (b"help\r", b"status\r", b"measure\r"):
        shown = answer(heard(line_of(line, 9600, bits=7, parity="odd"), 9600))
        assert b"parity" in shown
        assert b"measurement" not in shown
