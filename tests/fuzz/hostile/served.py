"""A unit's interfaces as the attackers find them."""

import contextlib
import os
import tty
from collections.abc import AsyncIterator, Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from fuzz.hostile.modbus import NEXT_ZERO, UNIT
from fuzz.hostile.pictures import Maker
from fuzz.hostile.requests import Address
from support.serving import serving

from altd.config import ConsolePortSettings, HttpSettings, ModbusTcpSettings
from altd.credentials.file import change
from altd.credentials.hashes import PasswordHash
from altd.publish.http.publisher import HttpPublisher, LocalPublisher
from altd.publish.modbus.tcp import ModbusTcpPublisher
from altd.publish.serial.publisher import ConsolePublisher
from altd.runtime.clock import SystemClock
from altd.runtime.supervision import Publisher
from altd.status.health import MEASURING, Health, State
from altd.status.unit import PublishedUnit
from altd.status.zero import Zero
from tools.pages.example import MEASURED, board
from tools.pages.serial_examples import unit_that_shows

HOST = "127.0.0.1"


@dataclass(frozen=True, slots=True)
class Served:
    """The address of an interface; ``left`` counts objects that must be 0 at the end, by name."""

    address: Address
    left: Callable[[], Mapping[str, int]]


@contextlib.asynccontextmanager
async def http(folder: Path) -> AsyncIterator[Served]:
    """With credentials, so that there is something to get at."""
    credentials = folder / "credentials"
    password = PasswordHash.of("nobody guesses this")
    change(credentials, "ana", lambda known: known.with_password("ana", password))
    async with _over_tcp(HttpSettings(host=HOST, port=0, names=("unit",), credentials=credentials)) as served:
        yield served


@contextlib.asynccontextmanager
async def websocket(folder: Path) -> AsyncIterator[Served]:
    """Open to everybody, with pictures."""
    async with _over_tcp(HttpSettings(host=HOST, port=0, names=("unit",))) as served:
        yield served


@contextlib.asynccontextmanager
async def local(folder: Path) -> AsyncIterator[Served]:
    """The socket in the file system."""
    unit, path = _published(), folder / "altd.sock"
    publisher = LocalPublisher(path, unit, unit.health.component("local"))
    async with _running(publisher):
        yield Served(str(path), _left_by(publisher))


@contextlib.asynccontextmanager
async def console() -> AsyncIterator[int]:
    """A serial console; the descriptor of its line's far end, which does not block."""
    unit = unit_that_shows(MEASURED)
    unit.health.component(MEASURING).set_state(State.OK, "")
    far, near = os.openpty()
    try:
        tty.setraw(near)
        os.set_blocking(far, False)
        settings = ConsolePortSettings(device=Path(os.ttyname(near)), speaks="console")
        component = Health(SystemClock()).component("console")
        async with _running(ConsolePublisher(settings, unit, component)):
            yield far
    finally:
        os.close(near)
        os.close(far)


def _published() -> PublishedUnit:
    unit = PublishedUnit(board(), Health(SystemClock()))
    unit.pictures.open(Maker())
    return unit


@contextlib.asynccontextmanager
async def _over_tcp(settings: HttpSettings) -> AsyncIterator[Served]:
    unit = _published()
    publisher = HttpPublisher(settings, unit, unit.health.component("http"))
    async with _running(publisher):
        yield Served((HOST, publisher.port), _left_by(publisher))


def _left_by(publisher: HttpPublisher) -> Callable[[], Mapping[str, int]]:
    answers = publisher.answers
    return lambda: {"viewers": answers.viewers.open, "streams": answers.streams.open}


@contextlib.asynccontextmanager
async def modbus(folder: Path) -> AsyncIterator[Served]:
    """With all commands allowed, none of which an attacker gets right."""
    unit, checks = _published(), list[None]()
    unit.self_check.open(lambda: checks.append(None))
    unit.zero = Zero(unit.events, first_number=NEXT_ZERO)
    settings = ModbusTcpSettings(host=HOST, port=0, unit_id=UNIT, allow_self_check=True, allow_zero=True)
    component = unit.health.component("modbus")
    publisher = ModbusTcpPublisher(settings, unit, component)

    def left() -> Mapping[str, int]:
        written = {"zeros": unit.zero.state.count, "self-checks": len(checks)}
        return {"clients": component.counters.get("clients", 0), **written}

    async with _running(publisher):
        yield Served((HOST, publisher.port), left)


@contextlib.asynccontextmanager
async def _running(publisher: Publisher) -> AsyncIterator[None]:
    """Raises what the publisher died of, at the end too."""
    async with serving(publisher) as task:
        yield
        if task.done():
            task.result()
