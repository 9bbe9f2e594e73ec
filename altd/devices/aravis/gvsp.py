"""Packets of GigE Vision's stream protocol (GVSP): conversion to and from bytes.

A block is a frame: a leader with packet id 0, payload packets from 1 on, a trailer. All numbers are
big-endian. Ids have 16 (block) and 24 bits (packet) or, with a flag in the header, 64 and 32 bits. Nothing
here checks a number: the caller must check that a packet id is in the expected range.

Source: the GigE Vision standard, version 2.0: GVSP's headers, leaders and trailers of images and of extended
chunk data, the layout of a chunk; GVCP's PACKETRESEND.
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
IMAGE = 0x0001
_EXTENDED_CHUNKS, _IMAGE_WITH_CHUNKS = 0x0005, 0x4001
_CHUNK_ALIGNMENT_BYTES, _CHUNK_END_BYTES = 4, 8
_KEY, _RESEND, _FLAG_EXTENDED = 0x42, 0x0040, 0x10


class Header(NamedTuple):
    """Header of every packet, ``size`` bytes long."""

    block_id: int
    packet_format: int
    packet_id: int
    extended: bool
    size: int


class Leader(NamedTuple):
    """Image announced by a leader. ``timestamp`` is in the camera's own ticks.

    ``payload_type`` other than ``IMAGE``: chunks, of which the image is the first.
    """

    payload_type: int
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


def payload_type(body: memoryview) -> int:
    """Payload type in ``body``, the bytes after the header of a leader or trailer; 0: too short."""
    return int.from_bytes(body[2:4], "big")


def read_leader(body: memoryview) -> Leader | None:
    """Leader in ``body``, the bytes after the header; None if it announces no image."""
    if payload_type(body) not in (IMAGE, _EXTENDED_CHUNKS, _IMAGE_WITH_CHUNKS) or len(body) < _LEADER.size:
        return None
    _, kind, timestamp, pixel_format, width, height, _, _, pad_x, pad_y = _LEADER.unpack_from(body)
    return Leader(kind, timestamp, pixel_format, width, height, pad_x, pad_y)


def is_trailer(body: memoryview, of_type: int) -> bool:
    """Whether this ends a payload of a type. The lengths in it are ignored: Aravis' cameras leave them 0."""
    return len(body) >= _TRAILER.size and payload_type(body) == of_type


def bytes_to_end_of_chunk(image_bytes: int) -> int:
    """Size of an image as the first chunk: filled up to four bytes, then its id and its length."""
    return image_bytes + -image_bytes % _CHUNK_ALIGNMENT_BYTES + _CHUNK_END_BYTES


def chunk_bytes(chunk: memoryview) -> int:
    """Length that the end of a chunk states, without id and length."""
    return int.from_bytes(chunk[-4:], "big")


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
