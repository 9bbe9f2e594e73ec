"""Frames of Modbus RTU by the specification's own arithmetic; nothing of it comes from the product."""

import itertools
import struct

from support.modbus_wire import ONE, UNIT

OTHER = 9
"""Another unit on the bus."""


def register_after(data: bytes, register: int = 0xFFFF) -> int:
    """The CRC register, bit by bit (Modbus over Serial Line V1.02, 6.2.2)."""
    for byte in data:
        register ^= byte
        for _ in range(8):
            register = (register >> 1) ^ 0xA001 if register & 1 else register >> 1
    return register


def crc(data: bytes) -> bytes:
    return struct.pack("<H", register_after(data))


def frame(pdu: bytes, unit: int = UNIT) -> bytes:
    return bytes([unit]) + pdu + crc(bytes([unit]) + pdu)


def answer_that_ends_as_a_request(count: int = 20) -> bytes:
    """An answer of another unit with ``count`` registers whose last 8 bytes are a whole request to this one.

    Two bytes before them are chosen so that the register is there what it is where a frame begins; then both
    frames end with the same CRC.
    """
    head = bytes([OTHER, 4, 2 * count]) + bytes(range(2 * count - 8))
    register = register_after(head)
    chosen = next(
        bytes(pair)
        for pair in itertools.product(range(256), repeat=2)
        if register_after(bytes(pair), register) == 0xFFFF
    )
    answer = frame((head + chosen + bytes([UNIT]) + ONE)[1:], OTHER)
    assert answer[-8:] == frame(ONE)
    return answer


READ_OF_20 = frame(struct.pack(">BHH", 4, 0, 20), OTHER)
COLLIDING = answer_that_ends_as_a_request()
"""The answer to ``READ_OF_20`` that ends as a request to this unit."""
