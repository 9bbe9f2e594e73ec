"""The CRC at the end of each Modbus RTU frame (Modbus over Serial Line V1.02, 6.2)."""

from __future__ import annotations

from functools import reduce

START = 0xFFFF
TABLE = tuple(
    reduce(lambda register, _: register >> 1 ^ 0xA001 * (register & 1), range(8), byte) for byte in range(256)
)
"""Registers after each byte, from 0, with the polynomial 0xA001 (6.2.2)."""


def register_after(frame: bytes) -> int:
    """Return the CRC register after these bytes; 0 after a frame with its CRC."""
    return reduce(lambda register, byte: register >> 8 ^ TABLE[(register ^ byte) & 0xFF], frame, START)


def with_crc(frame: bytes) -> bytes:
    """Return the frame with its CRC."""
    return frame + register_after(frame).to_bytes(2, "little")
