"""The packets of GigE Vision's control protocol (GVCP), to and from bytes; all numbers are big-endian.

Nothing here believes a packet: it counts when it bears the number of the question and has the very length
that it states.

Source: the GigE Vision standard, version 2.0: GVCP's headers, DISCOVERY and READREG, bootstrap registers.
"""

from __future__ import annotations

import socket
import struct
from dataclasses import dataclass

PORT = 3956
DISCOVERY, READ_REGISTER = 0x0002, 0x0080
"""Commands; the acknowledge of each has the next number."""
CONTROL_PRIVILEGE, HEARTBEAT_TIMEOUT_MS = 0x0A00, 0x0938
"""Bootstrap registers."""

_KEY = 0x42
_ACKNOWLEDGE = 0x01
_BROADCAST_ACKNOWLEDGE = 0x10
_HEADER = struct.Struct(">HHHH")
_DISCOVERY_BYTES, _REGISTER_BYTES = 248, 4


@dataclass(frozen=True, slots=True)
class DiscoveredCamera:
    """A camera as it describes itself."""

    address: str
    vendor: str
    model: str
    serial: str
    user_name: str

    @property
    def id(self) -> str:
        """Vendor, model and serial number, as Aravis composes them."""
        return f"{self.vendor}-{self.model}-{self.serial}"

    def is_called(self, name: str) -> bool:
        """Whether ``name`` is its serial number, address, id or the name that its user gave it."""
        return name != "" and name in (self.serial, self.address, self.id, self.user_name)


def command(number: int, request_id: int, payload: bytes = b"", broadcast: bool = False) -> bytes:
    """A command that asks for an acknowledge. ``request_id`` 0 is forbidden."""
    flags = _ACKNOWLEDGE | (_BROADCAST_ACKNOWLEDGE if broadcast else 0)
    return _HEADER.pack(_KEY << 8 | flags, number, len(payload), request_id) + payload


def read_acknowledge(packet: bytes, number: int, request_id: int) -> bytes | None:
    """The payload of the acknowledge of a command; None for any other packet, and for a refusal."""
    if len(packet) < _HEADER.size:
        return None
    status, acknowledged, length, answered_id = _HEADER.unpack_from(packet)
    payload = packet[_HEADER.size :]
    fits = acknowledged == number + 1 and answered_id == request_id and length == len(payload)
    return payload if status == 0 and fits else None


def read_discovery(payload: bytes) -> DiscoveredCamera | None:
    """The camera that a DISCOVERY_ACK describes; its fields lie where the bootstrap registers do."""
    if len(payload) != _DISCOVERY_BYTES:
        return None
    return DiscoveredCamera(
        address=socket.inet_ntop(socket.AF_INET, payload[0x24:0x28]),
        vendor=_text(payload[0x48:0x68]),
        model=_text(payload[0x68:0x88]),
        serial=_text(payload[0xD8:0xE8]),
        user_name=_text(payload[0xE8:0xF8]),
    )


def read_register(payload: bytes) -> int | None:
    """The value in a READREG_ACK of one register."""
    return int.from_bytes(payload, "big") if len(payload) == _REGISTER_BYTES else None


def is_address(text: str) -> bool:
    """Whether this is an IPv4 address; GigE Vision knows no other."""
    try:
        socket.inet_pton(socket.AF_INET, text)
    except OSError:
        return False
    return True


def _text(field: bytes) -> str:
    text = field.split(b"\0", 1)[0].decode("utf-8", "replace").strip()
    return "".join(letter for letter in text if letter.isprintable())
