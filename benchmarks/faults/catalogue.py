"""All faults by name: the campaign's ways, and faults of ports, network and clock around the daemon.

A fault of the second kind is an asynchronous generator: it begins with its first step, makes a step with each
exposure, and ends when it is closed.
"""

import contextlib
import os
import socket
import struct
from collections.abc import AsyncGenerator, Callable, Iterable, Iterator
from dataclasses import dataclass
from datetime import timedelta

from benchmarks.campaign.way import Draw, Way, summary_of
from benchmarks.campaign.ways import ANOTHER_UNIT, WAYS
from benchmarks.campaign.ways.spots import photographed_beam
from benchmarks.faults.live import LiveUnit
from benchmarks.faults.wires import Wires
from benchmarks.harness import HOST
from benchmarks.poller import READ

Act = Callable[[LiveUnit, Wires, Draw], AsyncGenerator[None]]


@dataclass(frozen=True, slots=True)
class Fault:
    """A fault: a way of the campaign, or an action around the daemon.

    ``is_blind``: nothing can be measured while it lasts, so a reason is due within a second.
    """

    name: str
    kind: str
    summary: str
    way: Way | None = None
    act: Act | None = None
    is_blind: bool = False


async def _lasting(begin: Callable[[], object], end: Callable[[], object]) -> AsyncGenerator[None]:
    begin()
    try:
        while True:
            yield
    finally:
        end()


def camera_unplugged(unit: LiveUnit, _wires: Wires, draw: Draw) -> AsyncGenerator[None]:
    """One camera or both are unplugged, not found, and plugged in again."""

    def begin() -> None:
        for name in draw.targets():
            unit.cameras[name].is_unplugged = True

    def end() -> None:
        for camera in unit.cameras.values():
            camera.is_unplugged = False

    return _lasting(begin, end)


def port_unplugged(_unit: LiveUnit, wires: Wires, _draw: Draw) -> AsyncGenerator[None]:
    """The serial port of the telegram is unplugged, and plugged in again."""
    return _lasting(wires.telegram.unplug, wires.telegram.plug)


def reader_stuck(_unit: LiveUnit, wires: Wires, _draw: Draw) -> AsyncGenerator[None]:
    """The reader of the telegram stops reading; it begins again with an empty buffer."""
    return _lasting(wires.telegram.stop, wires.telegram.restart)


def clock_set(unit: LiveUnit, _wires: Wires, draw: Draw) -> AsyncGenerator[None]:
    """The computer's clock is set forward or back by an hour, and right again."""

    def set_by(hours: int) -> None:
        unit.clock.utc_step = timedelta(hours=hours)

    return _lasting(lambda: set_by(draw.sign()), lambda: set_by(0))


async def port_noise(_unit: LiveUnit, wires: Wires, draw: Draw) -> AsyncGenerator[None]:
    """Random bytes come in on the lines of telegram and Modbus RTU."""
    while True:
        _write(wires, draw.rng.bytes(draw.whole(1, 100)))
        yield


async def port_flood(_unit: LiveUnit, wires: Wires, draw: Draw) -> AsyncGenerator[None]:
    """The lines of telegram and Modbus RTU are flooded with requests without end."""
    request = draw.of("?\r\n", "\x01\x04\x00\x00\x00\x64").encode("latin-1")
    while True:
        _write(wires, request * (4096 // len(request)))
        yield


async def network_cut(_unit: LiveUnit, wires: Wires, draw: Draw) -> AsyncGenerator[None]:
    """All connections are reset, again and again; the clients come back."""
    every = draw.whole(1, 10)
    while True:
        wires.reset()
        for _ in range(every):
            yield


async def network_slow(unit: LiveUnit, _wires: Wires, _draw: Draw) -> AsyncGenerator[None]:
    """Clients beside the reader send a request byte by byte and read no answer."""
    requests = {unit.wires.modbus_port: READ * 200, unit.wires.http_port: b"GET /api/v1/measurement" * 50}
    links = [(_link(port), request) for port, request in requests.items() for _ in range(4)]
    try:
        for at in range(min(map(len, requests.values()))):
            for link, request in links:
                _send(link, request[at : at + 1])
            yield
    finally:
        _close(link for link, _ in links)


async def network_duplicated(_unit: LiveUnit, wires: Wires, draw: Draw) -> AsyncGenerator[None]:
    """Each request comes two to twenty times, on a second connection beside the reader's."""
    copies = draw.whole(2, 20)
    while True:
        await wires.ask_again(copies)
        yield


async def network_hostile(unit: LiveUnit, _wires: Wires, draw: Draw) -> AsyncGenerator[None]:
    """Clients send random, torn and oversized messages to every TCP port, and leave."""
    forged = (
        struct.pack(">HHHB", 1, 0, 65535, 1),
        READ[:7] + struct.pack(">BHHB", 16, 0, 123, 246) + bytes(246),
        b"GET /" + b"a" * 9000,
        b"POST /api/v1/measurement HTTP/1.1\r\nContent-Length: 99999999999\r\n\r\n{",
        READ[:6],
    )
    links: list[socket.socket] = []
    try:
        while True:
            _close(links)
            links = [_link(port) for port in (unit.wires.modbus_port, unit.wires.http_port) for _ in range(3)]
            for link in links:
                which = draw.whole(0, len(forged))
                _send(link, draw.rng.bytes(draw.whole(1, 600)) if which == len(forged) else forged[which])
            yield
    finally:
        _close(links)


def _link(port: int) -> socket.socket:
    link = socket.socket()
    link.setblocking(False)
    link.connect_ex((HOST, port))
    return link


def _send(link: socket.socket, data: bytes) -> None:
    with contextlib.suppress(OSError):
        link.send(data)


def _close(links: Iterable[socket.socket]) -> None:
    for link in links:
        link.close()


def _write(wires: Wires, data: bytes) -> None:
    for line in wires.serial_lines:
        with contextlib.suppress(BlockingIOError):
            os.write(line, data)


_ACTS: dict[str, tuple[Act, ...]] = {
    "camera": (camera_unplugged,),
    "ports": (port_unplugged, port_noise, port_flood, reader_stuck),
    "network": (network_cut, network_slow, network_duplicated, network_hostile),
    "system": (clock_set,),
}
_GROUPS = {
    "camera": ("frames", "times"),
    "light": ("spots", "surfaces", "ambient"),
    "geometry": ("cameras",),
}
"""Kinds of the campaign's ways that are used; the others disturb nothing, or files."""
_OF_CAMERA = ("exchanged", "one_for_both", "mirrored", "flipped", "upside_down")
"""Ways of the kind ``cameras`` in which no camera has moved."""
_LEFT_OUT = ("clean_times", ANOTHER_UNIT, photographed_beam.__name__)
"""Not faults of a daemon; and photographs that the repository does not contain: runs would differ without."""
_BLIND = ("frozen", "loop", "inverted", "camera_unplugged", *_OF_CAMERA)


def _faults() -> Iterator[Fault]:
    for group, kinds in _GROUPS.items():
        for way in WAYS.values():
            if way.kind in kinds and way.name not in _LEFT_OUT:
                of = "camera" if way.name in _OF_CAMERA else group
                yield Fault(way.name, of, way.summary, way=way, is_blind=way.name in _BLIND)
    for group, acts in _ACTS.items():
        for act in acts:
            name = act.__name__
            yield Fault(name, group, summary_of(act), act=act, is_blind=name in _BLIND)


FAULTS = {fault.name: fault for fault in _faults()}
"""All faults that run on the stepped clock; faults in real time are in ``real``."""
