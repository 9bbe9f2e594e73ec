"""All faults by name: the campaign's ways, and those of ports, network and clock around the daemon.

A fault of the second kind is an asynchronous generator: it begins with its first step, makes a step with each
exposure, and ends when it is closed.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import socket
import struct
from collections.abc import AsyncGenerator, Callable, Sequence
from dataclasses import dataclass
from datetime import timedelta

from altd.errors import BadInputError
from benchmarks.campaign.catalogue import ANOTHER_UNIT, WAYS
from benchmarks.campaign.way import Draw, Spoil, Way
from benchmarks.campaign.ways.times import Mistimed
from benchmarks.faults.live import LiveUnit
from benchmarks.faults.wires import Wires
from benchmarks.interfaces import HOST
from benchmarks.poller import READ

Act = Callable[[LiveUnit, Wires, Draw], AsyncGenerator[None]]

_GROUP_OF_KIND = {
    "spots": "light",
    "surfaces": "light",
    "ambient": "light",
    "grey values": "camera",
    "frames": "camera",
    "times": "camera",
    "cameras": "geometry",
}
_NO_FAULT = ("clean", "clean_driving", "clean_times", ANOTHER_UNIT)
_OF_CAMERA = ("exchanged", "one_for_both", "mirrored", "flipped", "upside_down")
"""Of the campaign's cameras; the others have moved."""


@dataclass(frozen=True, slots=True)
class Fault:
    """A fault: a way of the campaign, or an act around the daemon.

    ``is_blind``: nothing can be measured while it lasts, so a reason is due within a second.
    """

    name: str
    group: str
    summary: str
    way: Way | None = None
    act: Act | None = None
    is_blind: bool = False


async def camera_unplugged(unit: LiveUnit, _wires: Wires, draw: Draw) -> AsyncGenerator[None]:
    """One camera or both are unplugged, not found, and plugged in again."""
    cameras = [unit.cameras[name] for name in draw.targets()]
    with _set(cameras, "is_unplugged"):
        while True:
            yield


@contextlib.contextmanager
def _set(objects: Sequence[object], name: str):  # type: ignore[no-untyped-def]
    for each in objects:
        setattr(each, name, True)
    try:
        yield
    finally:
        for each in objects:
            setattr(each, name, False)


async def port_unplugged(_unit: LiveUnit, wires: Wires, _draw: Draw) -> AsyncGenerator[None]:
    """The serial port of the telegram is unplugged, and plugged in again."""
    wires.telegram.unplug()
    try:
        while True:
            yield
    finally:
        wires.telegram.plug()


async def port_noise(_unit: LiveUnit, wires: Wires, draw: Draw) -> AsyncGenerator[None]:
    """Random bytes come in on the lines of telegram and Modbus RTU."""
    while True:
        for line in wires.serial_lines:
            _write(line, draw.rng.bytes(draw.whole(1, 100)))
        yield


async def port_flood(_unit: LiveUnit, wires: Wires, draw: Draw) -> AsyncGenerator[None]:
    """The lines of telegram and Modbus RTU are flooded with requests without end."""
    request = draw.of("?\r\n", "\x01\x04\x00\x00\x00\x64").encode("latin-1")
    while True:
        for line in wires.serial_lines:
            _write(line, request * (4096 // len(request)))
        yield


async def reader_stuck(_unit: LiveUnit, wires: Wires, _draw: Draw) -> AsyncGenerator[None]:
    """The reader of the telegram stops reading; it begins again with an empty buffer."""
    wires.telegram.is_read = False
    try:
        while True:
            yield
    finally:
        wires.telegram.restart()


async def network_cut(_unit: LiveUnit, wires: Wires, draw: Draw) -> AsyncGenerator[None]:
    """All connections are reset, again and again; the clients come back."""
    every = draw.whole(1, 10)
    step = 0
    while True:
        if step % every == 0:
            wires.reset()
        step += 1
        yield


async def network_slow(unit: LiveUnit, _wires: Wires, _draw: Draw) -> AsyncGenerator[None]:
    """Clients beside the reader send a request byte by byte and read no answer."""
    requests = {unit.wires.modbus_port: READ * 200, unit.wires.http_port: _GET * 50}
    links = {port: [_link(port) for _ in range(4)] for port in requests}
    at = 0
    try:
        while True:
            for port, request in requests.items():
                for link in links[port]:
                    _send(link, request[at % len(request) :][:1])
            at += 1
            yield
    finally:
        _close(*links.values())


async def network_duplicated(unit: LiveUnit, wires: Wires, draw: Draw) -> AsyncGenerator[None]:
    """Each request comes two to twenty times, on a second connection beside the reader's."""
    copies = draw.whole(2, 20)
    while True:
        await wires.ask_again(copies)
        yield


async def network_hostile(unit: LiveUnit, _wires: Wires, draw: Draw) -> AsyncGenerator[None]:
    """Clients send random, torn and oversized messages to every TCP port."""
    ports = (unit.wires.modbus_port, unit.wires.http_port)
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
            links = [_link(port) for port in ports for _ in range(3)]
            for link in links:
                which = draw.whole(0, len(forged))
                _send(link, draw.rng.bytes(draw.whole(1, 600)) if which == len(forged) else forged[which])
            yield
    finally:
        _close(links)


async def network_flood(unit: LiveUnit, _wires: Wires, draw: Draw) -> AsyncGenerator[None]:
    """Connections are opened without end at one port, and stay open."""
    port = int(draw.of(str(unit.wires.modbus_port), str(unit.wires.http_port)))
    links: list[socket.socket] = []
    try:
        while True:
            links += [_link(port) for _ in range(8)]
            yield
    finally:
        _close(links)


def _clock_set(hours: float) -> Act:
    async def act(unit: LiveUnit, _wires: Wires, _draw: Draw) -> AsyncGenerator[None]:
        unit.clock.utc_step = timedelta(hours=hours)
        try:
            while True:
                yield
        finally:
            unit.clock.utc_step = timedelta()

    act.__doc__ = f"The computer's clock is set {'forward' if hours > 0 else 'back'} by an hour, and back again."
    return act


async def loop_held(unit: LiveUnit, _wires: Wires, draw: Draw) -> AsyncGenerator[None]:
    """The event loop is blocked for up to 30 ms at each exposure, as by a quarter of a processor."""
    loop = asyncio.get_running_loop()
    while True:
        loop.call_soon(_burn, draw.uniform(0.0, 0.03))
        yield


def _burn(seconds: float) -> None:
    end_s = asyncio.get_running_loop().time() + seconds
    while asyncio.get_running_loop().time() < end_s:
        pass


_GET = b"GET /api/v1/measurement HTTP/1.1\r\nHost: localhost\r\n\r\n"


def _link(port: int) -> socket.socket:
    link = socket.socket()
    link.setblocking(False)
    link.connect_ex((HOST, port))
    return link


def _send(link: socket.socket, data: bytes) -> None:
    with contextlib.suppress(OSError):
        link.send(data)


def _write(line: int, data: bytes) -> None:
    with contextlib.suppress(BlockingIOError):
        os.write(line, data)


def _close(*links: Sequence[socket.socket]) -> None:
    for link in (one for some in links for one in some):
        link.close()


_ACTS: tuple[tuple[str, str, Act, bool], ...] = (
    ("camera_unplugged", "camera", camera_unplugged, True),
    *((act.__name__, "ports", act, False) for act in (port_unplugged, port_noise, port_flood, reader_stuck)),
    *(
        (act.__name__, "network", act, False)
        for act in (network_cut, network_slow, network_duplicated, network_hostile, network_flood)
    ),
    ("clock_forward", "system", _clock_set(1.0), False),
    ("clock_back", "system", _clock_set(-1.0), False),
    ("loop_held", "system", loop_held, False),
)

_BLIND = {
    *("frozen", "loop", *_OF_CAMERA, "inverted"),
    *("lamp_disc_alone", "lamp_on_one", "laser_off"),
}


def _of_way(way: Way) -> Fault:
    summary = (way.make.__doc__ or "").strip().splitlines()[0]
    group = "camera" if way.name in _OF_CAMERA else _GROUP_OF_KIND[way.kind]
    return Fault(way.name, group, summary, way=way, is_blind=way.name in _BLIND)


FAULTS: dict[str, Fault] = {
    fault.name: fault
    for fault in (
        *(_of_way(way) for way in WAYS.values() if way.name not in _NO_FAULT and way.kind in _GROUP_OF_KIND),
        *(
            Fault(name, group, (act.__doc__ or "").strip().splitlines()[0], act=act, is_blind=is_blind)
            for name, group, act, is_blind in _ACTS
        ),
    )
}
"""Every fault that runs on the set clock; those in real time are in ``real``."""


def chosen(names: str) -> list[Fault]:
    """The faults of these names or groups, comma-separated; all where there is none. Raises BadInputError."""
    found = []
    for name in names.split(",") if names else FAULTS:
        of_name = [fault for fault in FAULTS.values() if name in (fault.name, fault.group)]
        if not of_name:
            groups = dict.fromkeys(fault.group for fault in FAULTS.values())
            raise BadInputError("--only", f"unknown fault {name!r}; groups are {', '.join(groups)}")
        found += of_name
    return list(dict.fromkeys(found))


def is_drawn(made: object) -> Spoil | Mistimed:
    """What a way's draw made, of the kinds that run here."""
    if isinstance(made, Spoil | Mistimed):
        return made
    raise TypeError(type(made).__name__)
