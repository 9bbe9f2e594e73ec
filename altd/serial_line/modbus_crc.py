"""The CRC at the end of each Modbus RTU frame (Modbus over Serial Line V1.02, 6.2)."""

from __future__ import annotations


def _table() -> tuple[int, ...]:
    """Return the table of the CRC with the polynomial 0xA001 (6.2.2)."""
    table = []
    for register in range(256):
        for _ in range(8):
            register = (register >> 1) ^ (0xA001 if register & 1 else 0)
        table.append(register)
    return tuple(table)


TABLE = _table()
START = 0xFFFF


def register_after(frame: bytes) -> int:
    """Return the CRC register after these bytes; 0 after a frame with its CRC."""
    register = START
    for byte in frame:
        register = (register >> 8) ^ TABLE[(register ^ byte) & 0xFF]
    return register


def with_crc(frame: bytes) -> bytes:
    """Return the frame with its CRC."""
    return frame + register_after(frame).to_bytes(2, "little")
