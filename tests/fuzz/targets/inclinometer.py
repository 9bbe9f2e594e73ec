"""Bytes that an inclinometer's line may bring, and noise makes of them."""

import struct

from fuzz.spoil import spoilt_bytes
from hypothesis import strategies as st
from support.modbus_rtu_wire import crc, frame

from altd.devices.inclinometer.registers import Question
from altd.ports import InclinometerError

NAME = "inclinometer"

QUESTION = Question(1, 4, 0, 2)
ANSWERS = (
    *(frame(bytes([4, 4, 0x8C, 0x97, 0, 0]), 1), frame(bytes([4, 4, 0xD9, 3, 0xFF, 0xFF]), 1)),
    *(QUESTION.frame, QUESTION.frame + frame(bytes([4, 4, 0, 0, 0, 1]), 1)),
    *(frame(b"\x84\x02", 1), frame(bytes([4, 2, 0, 0]), 1), frame(bytes([3, 4, 0, 0, 0, 0]), 1)),
    *(frame(bytes([4, 4, 1, 2, 3, 4]), 2), b""),
)
EXAMPLES = st.sampled_from(ANSWERS) | spoilt_bytes(st.sampled_from(ANSWERS))


def check(example: bytes) -> None:
    """An accepted answer is the whole answer to the question, with its CRC, and nothing besides."""
    try:
        registers = QUESTION.registers(example, "here")
    except InclinometerError:
        return
    answer = struct.pack(">BBBHH", 1, 4, 4, *registers)
    assert example.removeprefix(QUESTION.frame) == answer + crc(answer), registers
