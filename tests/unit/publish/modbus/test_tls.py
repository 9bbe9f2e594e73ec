"""Modbus/TCP Security by foreign clients: pymodbus, openssl, Python's ssl; certificates of openssl."""

import asyncio
import contextlib
import shutil
import socket
import ssl
import struct
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager
from pathlib import Path
from typing import Any

import pytest
from pymodbus.client import AsyncModbusTlsClient
from support.certificates import AUTHORITY, ROLE, Files, expired, made
from support.modbus_wire import EVERYTHING, ONE, ONE_ANSWER, UNIT, Measured, connected, eventually, frame
from support.serving import serving

from altd.config import ModbusTcpSettings
from altd.errors import BadInputError
from altd.publish.modbus import tcp
from altd.publish.modbus.tcp import ModbusTcpPublisher
from altd.status.board import Board
from altd.status.health import Component, Health, State
from altd.status.unit import PublishedUnit
from altd.tcp_port import CONNECTIONS

CHECK_NOW = bytes.fromhex("06 03e8 0001")

Served = Callable[..., AbstractAsyncContextManager[ModbusTcpPublisher]]


class Plant:
    """An authority, the unit's certificate, and those of clients."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.ca = made(folder, "ca", *AUTHORITY)
        self.unit = made(folder, "unit", ca=self.ca)
        self.reader = made(folder, "reader", ca=self.ca)
        self.operator = made(folder, "operator", "-addext", ROLE + "operator", ca=self.ca)
        self.expired = expired(folder, self.ca)
        self.stranger = made(folder, "stranger")
        self.server_alone = made(folder, "server", "-addext", "extendedKeyUsage=serverAuth", ca=self.ca)

    @property
    def settings(self) -> dict[str, Path]:
        return {"certificate": self.unit[0], "key": self.unit[1], "client_ca": self.ca[0]}

    def client(self, files: Files | None) -> ssl.SSLContext:
        context = ssl.create_default_context(cafile=str(self.ca[0]))
        if files is not None:
            context.load_cert_chain(*files)
        return context


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> Plant:
    return Plant(tmp_path_factory.mktemp("plant"))


@pytest.fixture
def health(component: Component) -> Health:
    return Health(component.clock)


@pytest.fixture
def served(published: PublishedUnit, component: Component, plant: Plant) -> Served:
    @contextlib.asynccontextmanager
    async def served(**more: Any) -> AsyncIterator[ModbusTcpPublisher]:
        settings = ModbusTcpSettings(host="127.0.0.1", port=0, unit_id=UNIT, **(plant.settings | more))
        publisher = ModbusTcpPublisher(settings, published, component)
        async with serving(publisher):
            yield publisher

    return served


async def is_answered(publisher: ModbusTcpPublisher, context: ssl.SSLContext) -> bool:
    """Whether a client is served; TLS 1.3 tells a client that it is refused only after its handshake."""
    try:
        async with asyncio.timeout(60), connected(publisher, tls=context) as client:
            return await client.ask(ONE) == ONE_ANSWER
    except (OSError, asyncio.IncompleteReadError):
        return False


async def test_pymodbus_reads_the_registers_of_a_plain_port_over_tls(
    served: Served, tcp: ModbusTcpPublisher, board: Board, measured: Measured, plant: Plant
) -> None:
    board.publish(measured())
    async with served() as publisher, connected(tcp) as plain:
        context = plant.client(plant.reader)
        context.check_hostname = False  # pymodbus hands over its own name for the server
        over_tls = AsyncModbusTlsClient("127.0.0.1", port=publisher.port, sslctx=context)
        assert await over_tls.connect()
        for address, count in ((0, 120), (300, 50)):
            read = await over_tls.read_input_registers(address, count=count, device_id=UNIT)
            answer = await plain.ask(struct.pack(">BHH", 4, address, count))
            assert struct.pack(f">{count}H", *read.registers) == answer[2:]
        over_tls.close()


@pytest.mark.parametrize("who", [None, "expired", "stranger", "server_alone"])
@pytest.mark.parametrize("version", [ssl.TLSVersion.TLSv1_2, ssl.TLSVersion.TLSv1_3])
async def test_no_other_client_is_answered_and_none_is_logged(
    served: Served,
    plant: Plant,
    component: Component,
    caplog: pytest.LogCaptureFixture,
    who: str | None,
    version: ssl.TLSVersion,
) -> None:
    context = plant.client(getattr(plant, who) if who else None)
    context.minimum_version = context.maximum_version = version
    async with served() as publisher:
        for number in range(1, 4):
            assert not await is_answered(publisher, context)
            await eventually(lambda number=number: component.counters.get("handshakes_failed", 0) == number)
        assert await is_answered(publisher, plant.client(plant.reader))
    assert "requests" in component.counters
    assert component.counters["requests"] == 1
    assert caplog.records == []


@pytest.mark.parametrize(
    "garbage", [b"", frame(EVERYTHING), b"\x16\x03\x01\x02\x00\x01\x00" + b"\xff" * 600, b"\x80" * 70_000]
)
async def test_plain_bytes_are_answered_by_a_close(
    served: Served, plant: Plant, component: Component, caplog: pytest.LogCaptureFixture, garbage: bytes
) -> None:
    async with served() as publisher:
        async with connected(publisher) as client:
            client.send(garbage)
            if garbage:
                assert await client.is_closed_without_an_answer()
        await eventually(lambda: component.counters.get("handshakes_failed", 0) == 1)
        assert await is_answered(publisher, plant.client(plant.reader))
    assert caplog.records == []


async def test_a_handshake_that_hangs_ends_and_holds_up_no_other(
    served: Served, plant: Plant, component: Component, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tcp, "HANDSHAKE_TIMEOUT_S", 1.0)
    async with served() as publisher, connected(publisher) as silent:
        assert await is_answered(publisher, plant.client(plant.reader))
        assert await silent.is_closed()
    assert component.counters["handshakes_failed"] == 1


async def test_an_address_with_many_handshakes_displaces_its_own(
    served: Served, plant: Plant, component: Component
) -> None:
    """16 that hang for 5 s each would else keep every controller out for as long."""
    async with contextlib.AsyncExitStack() as stack:
        publisher = await stack.enter_async_context(served(reserved=["127.0.0.9"]))
        for _ in range(3 * tcp.MAX_HANDSHAKES):
            await stack.enter_async_context(connected(publisher, "127.0.0.2"))
        await eventually(lambda: component.counters.get("clients_displaced", 0) >= 2 * tcp.MAX_HANDSHAKES)
        for address in ("127.0.0.3", "127.0.0.9"):
            async with connected(publisher, address, tls=plant.client(plant.reader)) as client:
                assert await client.ask(ONE) == ONE_ANSWER


async def test_clients_with_certificates_make_room_as_others_do(
    served: Served, plant: Plant, component: Component
) -> None:
    """A connection without a certificate closes none of them: it never gets a place."""
    context = plant.client(plant.reader)
    async with contextlib.AsyncExitStack() as stack:
        publisher = await stack.enter_async_context(served(reserved=["127.0.0.9"]))
        first = await stack.enter_async_context(connected(publisher, "127.0.0.9", tls=context))
        assert await first.ask(ONE) == ONE_ANSWER
        for number in range(tcp.MAX_CLIENTS - 1):
            await stack.enter_async_context(connected(publisher, f"127.0.1.{number}", tls=context))
        await eventually(lambda: component.counters["clients"] == tcp.MAX_CLIENTS)
        assert not await is_answered(publisher, plant.client(None))
        assert component.counters.get("clients_displaced", 0) == 0
        assert await is_answered(publisher, context)
        await eventually(lambda: component.counters.get("clients_displaced", 0) == 1)
        assert await first.ask(ONE) == ONE_ANSWER


async def test_an_address_begins_handshakes_only_so_often(
    served: Served, component: Component, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Time stands still, so that no token comes back; a reserved address is exempt."""
    async with contextlib.AsyncExitStack() as stack:
        publisher = await stack.enter_async_context(served(reserved=["127.0.0.9"]))
        for address in ("127.0.0.2", "127.0.0.9"):
            for _ in range(CONNECTIONS.burst + 5):
                async with connected(publisher, address) as client:
                    client.send(b"\x80")
        await eventually(lambda: component.counters.get("connections_limited", 0) == 5)


async def test_only_a_role_of_the_settings_commands(
    served: Served, plant: Plant, published: PublishedUnit, component: Component
) -> None:
    asked: list[bool] = []
    published.self_check.open(lambda: asked.append(True))
    async with served(allow_self_check=True, roles=("operator",)) as publisher:
        async with connected(publisher, tls=plant.client(plant.reader)) as reader:
            assert await reader.ask(CHECK_NOW) == bytes.fromhex("86 01")
            assert await reader.ask(ONE) == ONE_ANSWER
        assert asked == []
        async with connected(publisher, tls=plant.client(plant.operator)) as operator:
            assert await operator.ask(CHECK_NOW) == CHECK_NOW
        assert asked == [True]
    async with (
        served(allow_self_check=True, roles=("engineer",)) as publisher,
        connected(publisher, tls=plant.client(plant.operator)) as operator,
    ):
        assert await operator.ask(CHECK_NOW) == bytes.fromhex("86 01")
    assert asked == [True]


async def test_a_session_that_is_resumed_has_the_role_of_its_certificate(
    served: Served, plant: Plant, published: PublishedUnit
) -> None:
    """With the operator's session, but the reader's word, and the other way round."""
    published.self_check.open(lambda: None)
    async with served(allow_self_check=True, roles=("operator",)) as publisher:

        def ask(context: ssl.SSLContext, session: ssl.SSLSession | None) -> tuple[bytes, Any]:
            raw = socket.create_connection(("127.0.0.1", publisher.port), timeout=60)
            with context.wrap_socket(raw, server_hostname="127.0.0.1", session=session) as secured:
                secured.sendall(frame(CHECK_NOW))
                answer = secured.recv(100)
                return answer[7:], (secured.session, secured.session_reused)

        for files, expected in ((plant.operator, CHECK_NOW), (plant.reader, bytes.fromhex("86 01"))):
            context = plant.client(files)
            context.maximum_version = ssl.TLSVersion.TLSv1_2
            answer, (session, _) = await asyncio.to_thread(ask, context, None)
            assert answer == expected
            answer, (_, is_resumed) = await asyncio.to_thread(ask, context, session)
            assert (answer, is_resumed) == (expected, True)


async def test_renewed_files_count_from_the_next_handshake_on(
    served: Served, plant: Plant, tmp_path: Path, component: Component
) -> None:
    ca, certificate, key = (tmp_path / name for name in ("ca.pem", "unit.pem", "unit.key"))
    shutil.copy(plant.ca[0], ca)
    shutil.copy(plant.unit[0], certificate)
    shutil.copy(plant.unit[1], key)
    reader, stranger = plant.client(plant.reader), plant.client(plant.stranger)
    async with served(certificate=certificate, key=key, client_ca=ca) as publisher:
        assert component.message == f"Modbus TCP on port {publisher.port} with TLS"
        assert await is_answered(publisher, reader)
        ca.write_text("nothing")
        assert await is_answered(publisher, reader), "the old ones count until the new ones fit"
        assert component.state is State.DEGRADED
        assert "ca.pem: contains no certificate" in component.message
        shutil.copy(plant.stranger[0], ca)
        assert await is_answered(publisher, stranger)
        assert not await is_answered(publisher, reader)
        assert component.state is State.OK


@pytest.mark.parametrize("name", ["certificate", "key", "client_ca"])
def test_a_file_that_cannot_be_used_is_named_at_the_start(
    published: PublishedUnit, component: Component, plant: Plant, tmp_path: Path, name: str
) -> None:
    settings = ModbusTcpSettings(**(plant.settings | {name: tmp_path / "nothing.pem"}))
    with pytest.raises(BadInputError, match=r"nothing\.pem: No such file"):
        ModbusTcpPublisher(settings, published, component)
