"""Datagrams on GigE Vision's control port, which anybody on the network may send."""

import struct

from fuzz.spoil import spoilt_bytes
from hypothesis import strategies as st

from altd.devices.aravis import gvcp

NAME = "gvcp"

REQUEST_ID = 7


def _acknowledge(payload: bytes, acknowledged: int) -> bytes:
    return struct.pack(">HHHH", 0, acknowledged, len(payload), REQUEST_ID) + payload


def _introduction() -> bytes:
    payload = bytearray(248)
    payload[0x24:0x28] = bytes((192, 168, 7, 2))
    for start, text in ((0x48, b"Maker"), (0x68, b"Model"), (0xD8, b"4711"), (0xE8, b"front")):
        payload[start : start + len(text)] = text
    return _acknowledge(bytes(payload), 3)


EXAMPLES = spoilt_bytes(st.sampled_from((_introduction(), _acknowledge(b"\0\0\0\2", 0x81))))


def check(example: bytes) -> None:
    """An answer is used as a whole or not at all, and what is shown of it can be printed on one line."""
    discovered = gvcp.read_acknowledge(example, gvcp.DISCOVERY, REQUEST_ID)
    camera = None if discovered is None else gvcp.read_discovery(discovered)
    if camera is not None:
        assert camera.id.isprintable()
        assert gvcp.is_address(camera.address)
    register = gvcp.read_acknowledge(example, gvcp.READ_REGISTER, REQUEST_ID)
    assert register is None or len(register) <= len(example)
