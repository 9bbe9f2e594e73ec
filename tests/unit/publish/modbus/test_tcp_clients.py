"""Modbus TCP: clients that come, go, crowd and misbehave."""

import asyncio
import contextlib
import gc
import itertools
import logging
import socket
import struct
from pathlib import Path

import pytest
from support.modbus_wire import (
    EVERYTHING,
    ONE,
    ONE_ANSWER,
    UNIT,
    Client,
    Measured,
    connected,
    eventually,
    frame,
    words,
)
from support.serving import serving

from altd.publish.modbus.registers import SIZE
from altd.publish.modbus.tcp import MAX_CLIENTS, ModbusTcpPublisher
from altd.status.board import Board
from altd.status.health import Component
from altd.status.unit import PublishedUnit

from .conftest import tcp_of


def timers_of_connections(port: int) -> list[str]:
    """The kernel's timers of what is connected to a port of ours (proc(5), /proc/net/tcp)."""
    rows = [row.split() for row in Path("/proc/net/tcp").read_text().splitlines()[1:]]
    return [row[5][:2] for row in rows if row[1].endswith(f":{port:04X}") and row[3] == "01"]


@pytest.mark.parametrize(
    "garbage",
    [
        frame(ONE, protocol=1),
        b"GET / HTTP/1.1\r\nHost: altd\r\n\r\n",
        bytes(64),
        b"\xff" * 2000,
        struct.pack(">HHHB", 1, 0, 1, UNIT),
        struct.pack(">HHHB", 1, 0, 255, UNIT) + bytes(300),
    ],
)
async def test_a_client_that_makes_no_sense_is_closed_and_others_go_on(
    tcp: ModbusTcpPublisher, component: Component, client: Client, garbage: bytes
) -> None:
    async with connected(tcp) as hostile:
        hostile.send(garbage)
        assert await hostile.is_closed()
    assert component.counters["garbled"] == 1
    assert await client.ask(ONE) == ONE_ANSWER


async def test_what_was_asked_before_the_garbage_is_answered(client: Client) -> None:
    client.send(frame(ONE) + frame(ONE, protocol=9))
    assert await client.hear() == (1, UNIT, ONE_ANSWER)
    assert await client.is_closed()


async def test_a_torn_request_of_a_client_that_leaves_does_no_harm(
    tcp: ModbusTcpPublisher, component: Component, client: Client
) -> None:
    for end in range(1, len(frame(ONE))):
        async with connected(tcp) as leaving:
            leaving.send(frame(ONE)[:end])
    assert await client.ask(ONE) == ONE_ANSWER
    await eventually(lambda: component.counters["clients"] == 1)


async def test_a_client_that_resets_its_connection_does_no_harm(
    tcp: ModbusTcpPublisher, component: Component, client: Client
) -> None:
    for _ in range(5):
        rude = socket.create_connection(("127.0.0.1", tcp.port))
        rude.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        rude.sendall(frame(ONE) * 50)
        rude.close()
    assert await client.ask(ONE) == ONE_ANSWER
    await eventually(lambda: component.counters["clients"] == 1)


async def test_malformed_requests_do_not_fill_the_log(
    client: Client, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.INFO):
        for pdu in (b"\x04", b"\x63", b"\x2b\x0e\x09\x00", b"\x04\x00\x00\xff\xff"):
            await client.ask(pdu)
    assert not caplog.records


async def test_20_clients_at_once_are_all_served_beside_one_that_says_nothing(
    tcp: ModbusTcpPublisher, component: Component
) -> None:
    async def controller() -> None:
        async with connected(tcp) as client:
            for _ in range(10):
                assert len(words(await client.ask(EVERYTHING))) == SIZE

    async with connected(tcp):
        await asyncio.gather(*(controller() for _ in range(20)))
    assert component.counters["requests"] == 200


async def test_a_controller_keeps_its_connection_beside_64_addresses_that_ask_too(
    tcp: ModbusTcpPublisher, component: Component, client: Client
) -> None:
    """It asks so rarely that each client with a place has asked after it."""
    for _ in range(2):
        assert await client.ask(ONE) == ONE_ANSWER
    async with contextlib.AsyncExitStack() as stack:
        for number in range(64):
            coming = await stack.enter_async_context(connected(tcp, f"127.0.1.{number + 1}"))
            assert await coming.ask(ONE) == ONE_ANSWER
            if number == 40:
                assert await client.ask(ONE) == ONE_ANSWER
        assert await client.ask(ONE) == ONE_ANSWER
        assert component.counters["clients_displaced"] == 65 - MAX_CLIENTS


@pytest.mark.parametrize("reserved", [(), ("127.0.3.0/24",)], ids=["open", "reserved"])
async def test_a_reserved_controller_gets_in_where_others_have_asked_for_longer(
    published: PublishedUnit, component: Component, reserved: tuple[str, ...]
) -> None:
    """And stays, as no other new connection does."""
    publisher = tcp_of(published, component, reserved=reserved)
    async with serving(publisher), contextlib.AsyncExitStack() as stack:
        for number in range(MAX_CLIENTS):
            early = await stack.enter_async_context(connected(publisher, f"127.0.1.{number + 1}"))
            for _ in range(3):
                assert await early.ask(ONE) == ONE_ANSWER
        controller = await stack.enter_async_context(connected(publisher, "127.0.3.1"))
        assert await controller.ask(ONE) == ONE_ANSWER
        for number in range(MAX_CLIENTS):
            late = await stack.enter_async_context(connected(publisher, f"127.0.2.{number + 1}"))
            assert await late.ask(ONE) == ONE_ANSWER
        if reserved:
            assert await controller.ask(ONE) == ONE_ANSWER
        else:
            assert await controller.is_closed()


async def test_connections_that_never_ask_do_not_displace_who_does(
    tcp: ModbusTcpPublisher, component: Component, client: Client
) -> None:
    assert await client.ask(ONE) == ONE_ANSWER
    for _ in range(3):
        async with contextlib.AsyncExitStack() as stack:
            for silent in [connected(tcp) for _ in range(MAX_CLIENTS + 1)]:
                await stack.enter_async_context(silent)
            assert await client.ask(ONE) == ONE_ANSWER
    assert component.counters["clients_displaced"] >= 3


async def test_a_host_that_crowds_the_unit_displaces_its_own_connections_first(
    tcp: ModbusTcpPublisher, client: Client
) -> None:
    assert await client.ask(ONE) == ONE_ANSWER
    async with contextlib.AsyncExitStack() as stack:
        for coming in [connected(tcp, "127.0.0.2") for _ in range(2 * MAX_CLIENTS)]:
            crowding = await stack.enter_async_context(coming)
            assert await crowding.ask(ONE) == ONE_ANSWER
        assert await client.ask(ONE) == ONE_ANSWER


async def test_a_client_that_never_takes_its_answers_is_left_waiting_and_delays_nobody(
    tcp: ModbusTcpPublisher, board: Board, component: Component, measured: Measured, client: Client
) -> None:
    greedy = socket.socket()
    greedy.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
    greedy.connect(("127.0.0.1", tcp.port))
    greedy.setblocking(False)
    try:
        answered = -1
        while component.counters.get("requests", 0) > answered:
            answered = component.counters.get("requests", 0)
            for _ in range(20):
                with contextlib.suppress(BlockingIOError):
                    greedy.send(frame(EVERYTHING) * 1000)
                await asyncio.sleep(0.005)
            assert answered < 30_000, "answers pile up"
        for count in range(20):
            board.publish(measured(sequence=count))
            async with asyncio.timeout(60):
                assert words(await client.ask(struct.pack(">BHH", 4, 8, 2))) == (0, count)
    finally:
        greedy.close()
    await eventually(lambda: component.counters["clients"] == 1)


async def test_a_crowd_with_many_requests_gets_one_answer_a_turn_of_the_loop(
    tcp: ModbusTcpPublisher, component: Component
) -> None:
    async with contextlib.AsyncExitStack() as stack:
        crowd = [await stack.enter_async_context(connected(tcp)) for _ in range(20)]
        for client in crowd:
            client.send(frame(ONE) * 20)
        answered = [0]
        async with asyncio.timeout(60):
            while answered[-1] < 400:
                await asyncio.sleep(0)
                answered.append(component.counters.get("requests", 0))
        for client in crowd:
            for _ in range(20):
                await client.hear()
    assert max(after - before for before, after in itertools.pairwise(answered)) == 1


async def test_the_kernel_watches_over_connections(client: Client, tcp: ModbusTcpPublisher) -> None:
    assert await client.ask(ONE) == ONE_ANSWER
    assert timers_of_connections(tcp.port) == ["02"], "the keep-alive timer"


async def test_an_address_in_use_is_an_os_error(
    tcp: ModbusTcpPublisher, published: PublishedUnit, component: Component
) -> None:
    with pytest.raises(OSError, match="Address already in use by"):
        async with serving(tcp_of(published, component, port=tcp.port)):
            pass


async def test_after_a_cancellation_nothing_is_left_and_the_port_is_free(
    published: PublishedUnit, component: Component
) -> None:
    publisher = tcp_of(published, component)
    before = asyncio.all_tasks()
    async with contextlib.AsyncExitStack() as stack:
        async with serving(publisher):
            clients = [await stack.enter_async_context(connected(publisher)) for _ in range(3)]
            assert await clients[0].ask(ONE) == ONE_ANSWER
            clients[1].send(frame(ONE)[:5])
        assert asyncio.all_tasks() == before
        assert not component.counters.get("clients")
        for client in clients:
            assert await client.is_closed()
    async with serving(tcp_of(published, component, port=publisher.port)):
        pass


@pytest.mark.parametrize("turns", range(12))
async def test_a_client_that_connects_as_the_publisher_ends_is_closed(
    published: PublishedUnit, component: Component, caplog: pytest.LogCaptureFixture, turns: int
) -> None:
    """In one of these turns of the loop the connection is accepted, in the next its streams are made."""
    publisher = tcp_of(published, component)
    async with serving(publisher):
        client = socket.create_connection(("127.0.0.1", publisher.port), 10)
        for _ in range(turns):
            await asyncio.sleep(0)
    for _ in range(12):
        await asyncio.sleep(0)
    with client:
        client.settimeout(10)
        with contextlib.suppress(ConnectionResetError):
            assert client.recv(1) == b""
    gc.collect()
    assert not caplog.records
    assert not component.counters.get("clients")
