"""GVCP: the commands of GigE Vision and a client for a camera's registers.

No packet is trusted: a response must have the request's number, which is random, and exactly the length that
it states. Except for a broadcast, it must come from the requested address. Other datagrams cost a bounded
time and no memory.

Source: the GigE Vision standard, version 2.0: GVCP's headers, DISCOVERY and READREG, bootstrap registers.

Aravis waits 2.5 s for a camera that does not answer. To find one takes a second, and no other camera can
be opened meanwhile. These requests need neither control of the camera nor Aravis.
"""

from __future__ import annotations

import fcntl
import secrets
import socket
import struct
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

PORT = 3956
DISCOVERY, READ_REGISTER = 0x0002, 0x0080
"""Commands; the acknowledge of each has the next number."""
CONTROL_PRIVILEGE, HEARTBEAT_TIMEOUT_MS = 0x0A00, 0x0938
"""Addresses of bootstrap registers."""

_KEY = 0x42
_ACKNOWLEDGE = 0x01
_BROADCAST_ACKNOWLEDGE = 0x10
_HEADER = struct.Struct(">HHHH")
_DISCOVERY_BYTES, _REGISTER_BYTES = 248, 4


@dataclass(frozen=True, slots=True)
class DiscoveredCamera:
    """A camera with the identity that it reports."""

    address: str
    vendor: str
    model: str
    serial: str
    user_name: str

    @property
    def id(self) -> str:
        """Vendor, model and serial number, as Aravis composes them."""
        return f"{self.vendor}-{self.model}-{self.serial}"

    def has_name(self, name: str) -> bool:
        """Whether ``name`` is its serial number, address, id or user-defined name."""
        return name != "" and name in (self.serial, self.address, self.id, self.user_name)


def command(number: int, request_id: int, payload: bytes = b"", broadcast: bool = False) -> bytes:
    """Build a command that requests an acknowledge. ``request_id`` 0 is forbidden."""
    flags = _ACKNOWLEDGE | (_BROADCAST_ACKNOWLEDGE if broadcast else 0)
    return _HEADER.pack(_KEY << 8 | flags, number, len(payload), request_id) + payload


def read_acknowledge(packet: bytes, number: int, request_id: int) -> bytes | None:
    """Payload of the acknowledge of a command; None for any other packet, and for a refusal."""
    if len(packet) < _HEADER.size:
        return None
    status, acknowledged, length, answered_id = _HEADER.unpack_from(packet)
    payload = packet[_HEADER.size :]
    fits = acknowledged == number + 1 and answered_id == request_id and length == len(payload)
    return payload if status == 0 and fits else None


def read_discovery(payload: bytes) -> DiscoveredCamera | None:
    """Camera described by a DISCOVERY_ACK, whose fields have the offsets of the bootstrap registers."""
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
    """Value in a READREG_ACK of one register."""
    return int.from_bytes(payload, "big") if len(payload) == _REGISTER_BYTES else None


def is_address(text: str) -> bool:
    """Whether this is an IPv4 address; GigE Vision supports no other."""
    try:
        socket.inet_pton(socket.AF_INET, text)
    except OSError:
        return False
    return True


def _text(field: bytes) -> str:
    text = field.split(b"\0", 1)[0].decode("utf-8", "replace").strip()
    return "".join(letter for letter in text if letter.isprintable())


_SIOCGIFADDR = 0x8915
_MAX_DATAGRAM_BYTES = 2048
_MAX_CAMERAS = 256
_MAX_DATAGRAMS_AT_ONCE = 256
_POLL_INTERVAL_S = 0.02


def discover_at(address: str, timeout_s: float) -> DiscoveredCamera | None:
    """Return the camera at an address, or None when none answers in time."""
    payload = _acknowledge(address, DISCOVERY, b"", timeout_s)
    camera = None if payload is None else read_discovery(payload)
    return camera if camera is not None and camera.address == address else None


def discover(timeout_s: float) -> list[DiscoveredCamera]:
    """Return all cameras that answer a broadcast on any of this computer's networks, sorted by address.

    Any host can claim to be a camera; ``discover_at`` queries the address itself.
    """
    found: dict[str, DiscoveredCamera] = {}
    request_id = _new_request_id()
    question = command(DISCOVERY, request_id, broadcast=True)
    sockets: list[socket.socket] = []
    try:
        for own in _own_addresses():
            asking = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            sockets.append(asking)
            asking.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
            asking.setblocking(False)
            with suppress(OSError):  # an interface without a network
                asking.bind((own, 0))
                asking.sendto(question, ("255.255.255.255", PORT))
        deadline = time.monotonic() + timeout_s
        while (left_s := deadline - time.monotonic()) > 0:
            time.sleep(min(left_s, _POLL_INTERVAL_S))
            for asking in sockets:
                for packet in _datagrams(asking):
                    payload = read_acknowledge(packet, DISCOVERY, request_id)
                    camera = None if payload is None else read_discovery(payload)
                    if camera is not None and len(found) < _MAX_CAMERAS:
                        found[camera.address] = camera
    finally:
        for asking in sockets:
            asking.close()
    return [found[address] for address in sorted(found)]


def control_privilege(address: str, timeout_s: float) -> int | None:
    """Control privilege register of the camera, 0 when no program controls it; None when it does not answer.

    Aravis' simulated camera takes this request, from any sender, for its controller's heartbeat.
    """
    return _register(address, CONTROL_PRIVILEGE, timeout_s)


def heartbeat_timeout_s(address: str, timeout_s: float) -> float | None:
    """Time without a heartbeat after which the camera drops its controller, s; None if not known."""
    heartbeat_ms = _register(address, HEARTBEAT_TIMEOUT_MS, timeout_s)
    return None if heartbeat_ms is None else heartbeat_ms * 1e-3


def own_address_towards(address: str) -> str:
    """Address of the interface through which a camera is reached; raises OSError when there is none."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.connect((address, PORT))
        own: str = probe.getsockname()[0]
        return own


def _register(address: str, register: int, timeout_s: float) -> int | None:
    payload = _acknowledge(address, READ_REGISTER, struct.pack(">I", register), timeout_s)
    return None if payload is None else read_register(payload)


def _acknowledge(address: str, number: int, payload: bytes, timeout_s: float) -> bytes | None:
    """Payload of the camera's response; None when it refuses or does not answer."""
    deadline, request_id = time.monotonic() + timeout_s, _new_request_id()
    with suppress(OSError), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asking:
        asking.connect((address, PORT))
        asking.send(command(number, request_id, payload))
        while (left_s := deadline - time.monotonic()) > 0:
            asking.settimeout(left_s)
            answer = read_acknowledge(asking.recv(_MAX_DATAGRAM_BYTES), number, request_id)
            if answer is not None:
                return answer
    return None


def _new_request_id() -> int:
    """Random request number other than 0, which the standard forbids."""
    return 1 + secrets.randbelow(65535)


def _datagrams(asking: socket.socket) -> Iterator[bytes]:
    """Yield datagrams that have arrived; a flood of them does not hold up the other sockets."""
    with suppress(OSError):
        for _ in range(_MAX_DATAGRAMS_AT_ONCE):
            yield asking.recv(_MAX_DATAGRAM_BYTES)


def _own_addresses() -> Iterator[str]:
    """Address of each interface, by /proc: the service may not use ``if_nameindex``'s netlink sockets."""
    lines = Path("/proc/self/net/dev").read_text().splitlines()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        for name, colon, _ in (line.strip().partition(":") for line in lines):
            if not colon:
                continue
            with suppress(OSError):  # an interface without an IPv4 address
                request = struct.pack("256s", name.encode())
                yield socket.inet_ntoa(fcntl.ioctl(any_socket, _SIOCGIFADDR, request)[20:24])
