"""Small questions to GigE Vision cameras over their control protocol (GVCP), answered in milliseconds.

Aravis waits 2.5 s for a camera that does not answer, and finding one takes it a second, in which no other
camera can be opened. These questions need neither control of the camera nor Aravis.

An answer counts when it comes from the address that was asked, bears the number of the question, which nobody
can guess, and has the very length that it states. What comes beside it costs a bounded time and no memory.
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

_KEY = 0x42
_ACKNOWLEDGE = 0x01
_BROADCAST_ACKNOWLEDGE = 0x10
_DISCOVERY, _READ_REGISTER = 0x0002, 0x0080
_HEADER = struct.Struct(">HHHH")
_DISCOVERY_BYTES, _REGISTER_BYTES = 248, 4
_CONTROL_PRIVILEGE = 0x0A00
_HEARTBEAT_TIMEOUT_MS = 0x0938

_SIOCGIFADDR = 0x8915
_MAX_DATAGRAM_BYTES = 2048
_MAX_FOUND = 256
_DATAGRAMS_AT_ONCE = 256


@dataclass(frozen=True, slots=True)
class Greeting:
    """How a camera introduces itself."""

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


def greet(address: str, within_s: float) -> Greeting | None:
    """The camera at an address, or None when none answers in time."""
    ack = _ask(address, _DISCOVERY, b"", within_s)
    greeting = None if ack is None else _greeting(ack)
    return greeting if greeting is not None and greeting.address == address else None


def discover(within_s: float) -> list[Greeting]:
    """All cameras that answer to a broadcast on any of this computer's networks, by address.

    Anybody can claim to be one; ``greet`` asks the address itself.
    """
    found: dict[str, Greeting] = {}
    request_id = _new_request_id()
    question = _command(_DISCOVERY, request_id, b"", broadcast=True)
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
        deadline = time.monotonic() + within_s
        while (left_s := deadline - time.monotonic()) > 0:
            time.sleep(min(left_s, 0.02))
            for asking in sockets:
                for packet in _waiting(asking):
                    ack = _answer(packet, _DISCOVERY, request_id)
                    greeting = None if ack is None else _greeting(ack)
                    if greeting is not None and len(found) < _MAX_FOUND:
                        found[greeting.address] = greeting
    finally:
        for asking in sockets:
            asking.close()
    return [found[address] for address in sorted(found)]


def privilege(address: str, within_s: float) -> int | None:
    """The camera's control privilege register, 0 when nobody controls it; None when it does not answer.

    Aravis' simulated camera takes this question, from whomever, for its controller's sign of life.
    """
    return _register(address, _CONTROL_PRIVILEGE, within_s)


def heartbeat_s(address: str, within_s: float) -> float | None:
    """For how long the camera waits for its controller's sign of life before it drops it."""
    timeout_ms = _register(address, _HEARTBEAT_TIMEOUT_MS, within_s)
    return None if timeout_ms is None else timeout_ms * 1e-3


def own_address_towards(address: str) -> str:
    """The address of the interface through which a camera is reached; raises OSError when there is none."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.connect((address, PORT))
        own: str = probe.getsockname()[0]
        return own


def is_address(text: str) -> bool:
    """Whether this is an IPv4 address; GigE Vision knows no other."""
    try:
        socket.inet_pton(socket.AF_INET, text)
    except OSError:
        return False
    return True


def _register(address: str, register: int, within_s: float) -> int | None:
    ack = _ask(address, _READ_REGISTER, struct.pack(">I", register), within_s)
    return None if ack is None or len(ack) != _REGISTER_BYTES else int.from_bytes(ack, "big")


def _ask(address: str, command: int, payload: bytes, within_s: float) -> bytes | None:
    """The payload of the camera's answer; None when it refuses or does not answer."""
    deadline, request_id = time.monotonic() + within_s, _new_request_id()
    with suppress(OSError), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asking:
        asking.connect((address, PORT))
        asking.send(_command(command, request_id, payload))
        while (left_s := deadline - time.monotonic()) > 0:
            asking.settimeout(left_s)
            ack = _answer(asking.recv(_MAX_DATAGRAM_BYTES), command, request_id)
            if ack is not None:
                return ack
    return None


def _new_request_id() -> int:
    """Any but 0, which the standard forbids."""
    return 1 + secrets.randbelow(65535)


def _command(command: int, request_id: int, payload: bytes, broadcast: bool = False) -> bytes:
    flags = _ACKNOWLEDGE | (_BROADCAST_ACKNOWLEDGE if broadcast else 0)
    return _HEADER.pack(_KEY << 8 | flags, command, len(payload), request_id) + payload


def _answer(packet: bytes, command: int, request_id: int) -> bytes | None:
    if len(packet) < _HEADER.size:
        return None
    status, acknowledged, length, answered_id = _HEADER.unpack_from(packet)
    payload = packet[_HEADER.size :]
    fits = acknowledged == command + 1 and answered_id == request_id and length == len(payload)
    return payload if status == 0 and fits else None


def _greeting(ack: bytes) -> Greeting | None:
    """Offsets are those of GigE Vision's bootstrap registers."""
    if len(ack) != _DISCOVERY_BYTES:
        return None
    return Greeting(
        address=socket.inet_ntop(socket.AF_INET, ack[0x24:0x28]),
        vendor=_text(ack[0x48:0x68]),
        model=_text(ack[0x68:0x88]),
        serial=_text(ack[0xD8:0xE8]),
        user_name=_text(ack[0xE8:0xF8]),
    )


def _text(field: bytes) -> str:
    text = field.split(b"\0", 1)[0].decode("utf-8", "replace").strip()
    return "".join(letter for letter in text if letter.isprintable())


def _waiting(asking: socket.socket) -> Iterator[bytes]:
    """Datagrams that have come; a flood of them does not hold up the other sockets."""
    with suppress(OSError):
        for _ in range(_DATAGRAMS_AT_ONCE):
            yield asking.recv(_MAX_DATAGRAM_BYTES)


def _own_addresses() -> Iterator[str]:
    """Of each interface, by /proc: the service may not use the netlink sockets of ``if_nameindex``."""
    lines = Path("/proc/self/net/dev").read_text().splitlines()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        for name, colon, _ in (line.strip().partition(":") for line in lines):
            if not colon:
                continue
            with suppress(OSError):  # an interface without an IPv4 address
                request = struct.pack("256s", name.encode())
                yield socket.inet_ntoa(fcntl.ioctl(any_socket, _SIOCGIFADDR, request)[20:24])
