"""Packets of GigE Vision's stream, made from the standard without the code under test."""

import struct

MONO8 = 0x01080001
CHUNKS, EXTENDED_CHUNKS, IMAGE_WITH_CHUNKS = 0x0004, 0x0005, 0x4001
LEADER, TRAILER, PAYLOAD = 1, 2, 3
KILLER = bytes.fromhex("00000000820000000000000000000001f00000000000000100000000")
"""A trailer with extended ids, packet id 0xF0000000: 28 bytes for which Aravis 0.8.26 allocates 64 GB."""


def packet(
    block_id: int, kind: int, number: int, body: bytes, extended: bool = False, status: int = 0
) -> bytes:
    if extended:
        return struct.pack(">HHIQI", status, 0, 0x80000000 | kind << 24, block_id, number) + body
    return struct.pack(">HHI", status, block_id, kind << 24 | number) + body


def leader(
    width: int, height: int, timestamp: int, pixel_format: int = MONO8, payload_type: int = 1
) -> bytes:
    return struct.pack(">HHQIIIIIHH", 0, payload_type, timestamp, pixel_format, width, height, 0, 0, 0, 0)


def trailer(lines: int, payload_type: int = 1, payload_bytes: int = 0) -> bytes:
    if payload_type == EXTENDED_CHUNKS:
        return struct.pack(">HHIII", 0, payload_type, payload_bytes, lines, 0)
    chunks = struct.pack(">II", payload_bytes, 0) if payload_type & 0x4000 else b""
    return struct.pack(">HHI", 0, payload_type, lines) + chunks


def chunk(number: int, content: bytes, stated_bytes: int | None = None) -> bytes:
    """A chunk of GenICam: its content, filled up to four bytes, its id and its length."""
    filled = content + bytes(-len(content) % 4)
    return filled + struct.pack(">II", number, len(filled) if stated_bytes is None else stated_bytes)


def frame(
    block_id: int,
    image: bytes,
    width: int,
    packet_bytes: int,
    timestamp: int = 1,
    extended: bool = False,
    payload_type: int = 1,
    lines: int | None = None,
) -> list[bytes]:
    """All packets of a frame, in order; of one with chunks ``image`` holds them all."""
    size = packet_bytes - 28 - (20 if extended else 8)
    lines = len(image) // width if lines is None else lines
    bodies = [image[at : at + size] for at in range(0, len(image), size)]
    begin = leader(width, lines, timestamp, payload_type=payload_type)
    end = trailer(lines, payload_type, len(image))
    return [
        packet(block_id, LEADER, 0, begin, extended),
        *(packet(block_id, PAYLOAD, n, body, extended) for n, body in enumerate(bodies, 1)),
        packet(block_id, TRAILER, len(bodies) + 1, end, extended),
    ]
