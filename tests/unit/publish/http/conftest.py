"""A unit that is served on a free port, and a client that speaks through plain streams."""

from __future__ import annotations

import asyncio
import contextlib
import functools
import json
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft202012Validator
from support.clock import FakeClock
from support.measurements import measured
from support.picture_maker import Maker
from support.serving import serving
from support.status_fixtures import checked as report_of_check

from altd.config import HttpSettings
from altd.credentials import file, hashes
from altd.credentials.file import Credentials, save_credentials
from altd.credentials.hashes import PasswordHash, token_digest
from altd.history.history import History
from altd.instruments.beam.instrument import QUANTITIES
from altd.publish.http.openapi import document_of
from altd.publish.http.paths import PATHS
from altd.publish.http.publisher import HttpPublisher
from altd.records import Measurement
from altd.status.event_log import EventLog
from altd.status.health import Component, Health
from altd.status.unit import PublishedUnit


@dataclass
class Answer:
    status: int
    headers: dict[str, str]
    body: bytes

    @classmethod
    def of(cls, received: bytes) -> Answer:
        head, _, body = received.partition(b"\r\n\r\n")
        first, *lines = head.decode("latin-1").split("\r\n")
        headers = {name.lower(): value for name, value in (line.split(": ", 1) for line in lines)}
        return cls(int(first.split()[1]), headers, body)

    @property
    def json(self) -> Any:
        assert self.headers["content-type"] == "application/json"
        return json.loads(self.body)


@dataclass
class Unit:
    """The served parts, and ways to request them."""

    publisher: HttpPublisher
    task: asyncio.Task[None]

    @property
    def port(self) -> int:
        return self.publisher.port

    async def connect(self) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        return await asyncio.open_connection("127.0.0.1", self.port)

    async def send(self, request: bytes) -> bytes:
        """Send bytes and read until the unit closes the connection."""
        reader, writer = await self.connect()
        writer.write(request)
        try:
            return await asyncio.wait_for(reader.read(), 60)
        except ConnectionError:
            return b""
        finally:
            writer.close()
            with contextlib.suppress(ConnectionError):
                await writer.wait_closed()

    async def ask(
        self, path: str, method: str = "GET", headers: dict[str, str] | None = None, body: bytes = b""
    ) -> Answer:
        lines = {"Host": "unit", **({"Content-Length": str(len(body))} if body else {}), **(headers or {})}
        head = "".join(f"{name}: {value}\r\n" for name, value in lines.items())
        return Answer.of(await self.send(f"{method} {path} HTTP/1.1\r\n{head}\r\n".encode("latin-1") + body))

    @contextlib.asynccontextmanager
    async def stream(self) -> AsyncIterator[Events]:
        reader, writer = await self.connect()
        writer.write(b"GET /api/stream HTTP/1.1\r\nHost: unit\r\n\r\n")
        try:
            yield Events(reader)
        finally:
            writer.close()
            with contextlib.suppress(ConnectionError):
                await writer.wait_closed()

    async def until(self, holds: Callable[[], bool], timeout_s: float = 60.0) -> None:
        async with asyncio.timeout(timeout_s):
            while not holds():  # noqa: ASYNC110  the condition lies in the code under test
                await asyncio.sleep(0.005)


@dataclass
class Events:
    """Reads a stream block by block."""

    reader: asyncio.StreamReader

    async def head(self) -> bytes:
        return await asyncio.wait_for(self.reader.readuntil(b"\r\n\r\n"), 60)

    async def block(self) -> str:
        """The next block; chunked framing has one chunk a block here."""
        size = await asyncio.wait_for(self.reader.readline(), 60)
        data = await self.reader.readexactly(int(size, 16) + 2)
        assert data.endswith(b"\n\n\r\n")
        return data[:-4].decode()

    async def event(self) -> tuple[str, Any]:
        """The next event: its id and its object."""
        async with asyncio.timeout(60):  # comments come all the while
            while not (block := await self.block()).startswith("id: "):
                pass
        first, second = block.split("\n")
        return first.removeprefix("id: "), json.loads(second.removeprefix("data: "))


DOCUMENT = document_of(PATHS, QUANTITIES, "0.1.0")
NEED_MORE = (
    *("/api/v1/trend", "/api/v1/events"),
    *("/api/v1/calibration", "/api/v1/calibration/file", "/api/v1/calibration/report"),
)
"""Answers of a history or a calibration, which the unit of most tests has not."""


def fits(document: dict[str, Any], path: str, answer: Answer, method: str = "get") -> Any:
    """The answer's object, after jsonschema has held it against the document."""
    response = document["paths"][path][method]["responses"][str(answer.status)]
    schema = response["content"]["application/json"]["schema"]
    whole = {**schema, "components": document["components"]}
    Draft202012Validator(whole).validate(answer.json)
    return answer.json


NAMES = ("unit", "alt-0007.plant", "a")
PASSWORD = "open sesame"
TOKEN = "q3T0m-yK1_oT7vE8Jm5zq0c4yG2uWn9aXb6RkLhSdPf"
OURS = {"X-Altd-Request": "1", "Host": "alt-0007.plant:80"}

Served = Callable[..., AbstractAsyncContextManager[Unit]]
"""Served with these settings of ``[http]``."""


@pytest.fixture
def component(health: Health) -> Component:
    return health.component("http")


@pytest.fixture
def events(clock: FakeClock) -> EventLog:
    return EventLog(clock)


@contextlib.asynccontextmanager
async def served_with(
    published: PublishedUnit, history: History | None, events: EventLog | None = None, **more: Any
) -> AsyncIterator[Unit]:
    """With its history, if it has one, and other settings of ``[http]``."""
    settings = HttpSettings(**{"host": "127.0.0.1", "port": 0, "names": NAMES, **more})
    publisher = HttpPublisher(settings, published, published.health.component("http"), history, events)
    async with serving(publisher) as task:
        yield Unit(publisher, task)
    if history is not None:
        await history.end()


@pytest.fixture
def served(published: PublishedUnit, events: EventLog) -> Served:
    return functools.partial(served_with, published, None, events)


@pytest.fixture
async def unit(served: Served) -> AsyncIterator[Unit]:
    async with served() as unit:
        yield unit


@pytest.fixture
def credentials(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for name, value in (("SCRYPT_N", 2), ("SCRYPT_R", 1), ("SCRYPT_P", 1)):
        monkeypatch.setattr(hashes, name, value)
    monkeypatch.setattr(file, "DUMMY_HASH", PasswordHash.of("of an unknown name"))
    path = tmp_path / "credentials"
    known = Credentials({"ana": PasswordHash.of(PASSWORD)}, {"press": token_digest(TOKEN)})
    save_credentials(path, known)
    path.chmod(0o600)
    return path


@pytest.fixture
def checked(published: PublishedUnit) -> list[int]:
    """Which checks were made; each is made as soon as it was asked for."""
    desk, numbers = published.self_check, list[int]()

    def make() -> None:
        numbers.append(desk.begin())
        desk.publish(report_of_check(numbers[-1]))

    desk.open(lambda: asyncio.get_running_loop().call_soon(make) and None)
    return numbers


async def check(unit: Unit, **headers: str) -> Answer:
    named = {name.replace("_", "-"): value for name, value in headers.items()}
    return await unit.ask("/api/v1/self-check", "POST", {**OURS, **named})


async def log_in(unit: Unit, name: str = "ana", password: str = PASSWORD, **headers: str) -> Answer:
    body = json.dumps({"name": name, "password": password}).encode()
    kind = {
        "Content-Type": "application/json",
        **{key.replace("_", "-"): text for key, text in headers.items()},
    }
    return await unit.ask("/api/v1/login", "POST", {**OURS, **kind}, body)


def cookie_of(answer: Answer) -> str:
    return answer.headers["set-cookie"].partition(";")[0]


@pytest.fixture
def maker(published: PublishedUnit) -> Maker:
    maker = Maker()
    published.pictures.open(maker)
    return maker


@pytest.fixture(name="measured")
def measured_fixture() -> Measurement:
    return measured(time=datetime(2026, 11, 20, 8, 15, 30, 125_000, UTC))
