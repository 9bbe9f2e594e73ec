"""Packets of GigE Vision's stream protocol (GVSP): conversion to and from bytes.

A block is a frame: a leader with packet id 0, payload packets from 1 on, a trailer. All numbers are
big-endian. Ids have 16 (block) and 24 bits (packet) or, with a flag in the header, 64 and 32 bits. Nothing
here checks a number: the caller must check that a packet id is in the expected range.

Source: the GigE Vision standard, version 2.0: GVSP's headers, image leader and trailer; GVCP's PACKETRESEND.
"""

from __future__ import annotations

import struct
from typing import NamedTuple

LEADER, TRAILER, PAYLOAD = 1, 2, 3
"""Packet formats; the others carry no plain image."""

UDP_BYTES = 20 + 8
"""Size of the IP and UDP headers, which is included in the size of a stream's packets."""
HEADER_BYTES, EXTENDED_HEADER_BYTES = 8, 20

_HEADER = struct.Struct(">HHI")
_EXTENDED_IDS = struct.Struct(">QI")
_LEADER = struct.Struct(">HHQIIIIIHH")
_TRAILER = struct.Struct(">HHI")
_RESEND_COMMAND = struct.Struct(">BBHHH")
_EXTENDED = 0x80000000
_SUCCESS, _RESENT = 0x0000, 0x0100
_IMAGE = 0x0001
_KEY, _RESEND, _FLAG_EXTENDED = 0x42, 0x0040, 0x10


class Header(NamedTuple):
    """Header of every packet, ``size`` bytes long."""

    block_id: int
    packet_format: int
    packet_id: int
    extended: bool
    size: int


class Leader(NamedTuple):
    """Image announced by a leader. ``timestamp`` is in the camera's own ticks."""

    timestamp: int
    pixel_format: int
    width: int
    height: int
    padding_x: int
    padding_y: int


def read_header(packet: memoryview) -> Header | None:
    """Header of a packet; None without a block: too short, a camera error, block id 0 (test packets)."""
    if len(packet) < HEADER_BYTES:
        return None
    status, block_id, rest = _HEADER.unpack_from(packet)
    if status not in (_SUCCESS, _RESENT):
        return None
    packet_format, packet_id, extended, size = (rest >> 24) & 0x7F, rest & 0xFFFFFF, False, HEADER_BYTES
    if rest & _EXTENDED:
        if len(packet) < EXTENDED_HEADER_BYTES:
            return None
        block_id, packet_id = _EXTENDED_IDS.unpack_from(packet, HEADER_BYTES)
        extended, size = True, EXTENDED_HEADER_BYTES
    return Header(block_id, packet_format, packet_id, extended, size) if block_id else None


def read_leader(body: memoryview) -> Leader | None:
    """Leader in ``body``, the bytes after the header; None if it announces no plain image."""
    if len(body) < _LEADER.size:
        return None
    _, payload_type, timestamp, pixel_format, width, height, _, _, pad_x, pad_y = _LEADER.unpack_from(body)
    return Leader(timestamp, pixel_format, width, height, pad_x, pad_y) if payload_type == _IMAGE else None


def is_trailer(body: memoryview) -> bool:
    """Whether this ends a plain image. Its number of lines is ignored: Aravis' cameras leave it 0."""
    return len(body) >= _TRAILER.size and _TRAILER.unpack_from(body)[1] == _IMAGE


def data_bytes(packet_bytes: int, extended: bool) -> int:
    """Image bytes in each payload packet but the last, of a stream with packets of ``packet_bytes``."""
    return packet_bytes - UDP_BYTES - (EXTENDED_HEADER_BYTES if extended else HEADER_BYTES)


def resend_command(request_id: int, block_id: int, extended: bool, first: int, last: int) -> bytes:
    """Build the control packet that requests packets ``first`` to ``last`` of a block again."""
    if extended:
        payload = struct.pack(">HHIIQ", 0, 0, first, last, block_id)
    else:
        payload = struct.pack(">HHII", 0, block_id, first, last)
    flags = _FLAG_EXTENDED if extended else 0
    return _RESEND_COMMAND.pack(_KEY, flags, _RESEND, len(payload), request_id) + payload
