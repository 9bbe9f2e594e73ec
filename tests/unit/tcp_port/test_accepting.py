"""Accepting where descriptors have run out and where many come at once, and whose addresses count as one."""

import asyncio
import contextlib
import errno
import itertools
import logging
import os
import resource
import select
import socket
from collections.abc import AsyncIterator, Iterator
from unittest.mock import Mock

import pytest
from support.clock import FakeClock
from support.foreign import need
from support.ports import has_ipv6

from altd import tcp_port
from altd.status.health import Component
from altd.tcp_port import accept, address_of, group_of, is_among_last, listen, listen_with_reserved


@pytest.fixture
def component() -> Component:
    return Component("http", FakeClock())


@pytest.fixture
def admitted() -> Iterator[list[socket.socket]]:
    connections: list[socket.socket] = []
    yield connections
    for connection in connections:
        connection.close()


@contextlib.asynccontextmanager
async def accepting_into(
    admitted: list[socket.socket], component: Component
) -> AsyncIterator[tuple[str, int]]:
    async def admit(connection: socket.socket) -> None:
        admitted.append(connection)

    with listen("127.0.0.1", 0) as listener:
        task = asyncio.create_task(accept(listener, component, admit))
        try:
            yield listener.getsockname()
        finally:
            task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await task


@contextlib.contextmanager
def no_descriptor_left() -> Iterator[None]:
    """As if the process had used up what it may have."""
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    lowest_free = os.dup(0)
    os.close(lowest_free)
    resource.setrlimit(resource.RLIMIT_NOFILE, (lowest_free, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, before)


async def until(admitted: list[socket.socket], count: int) -> None:
    async with asyncio.timeout(60):
        while len(admitted) < count:  # noqa: ASYNC110
            await asyncio.sleep(0.001)


async def test_without_descriptors_it_waits_says_so_and_goes_on(
    admitted: list[socket.socket],
    component: Component,
    caplog: pytest.LogCaptureFixture,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(tcp_port, "RETRY_INTERVAL_S", 0.05)
    async with accepting_into(admitted, component) as address:
        clients = [socket.socket() for _ in range(20)]
        await asyncio.sleep(0.01)
        with no_descriptor_left():
            for client in clients:
                client.connect(address)
            await asyncio.sleep(0.12)
            assert admitted == []
        await until(admitted, 20)
        for client in clients:
            client.close()
    assert 1 <= component.counters["accepts_failed"] <= 4
    assert {(record.levelno, record.getMessage()) for record in caplog.records} == {
        (logging.WARNING, "http: cannot accept connections: Too many open files")
    }


async def test_the_loop_has_a_turn_between_two(admitted: list[socket.socket], component: Component) -> None:
    async with accepting_into(admitted, component) as address:
        clients = [socket.create_connection(address) for _ in range(50)]
        counts = [0]
        async with asyncio.timeout(60):
            while counts[-1] < 50:
                await asyncio.sleep(0)
                counts.append(len(admitted))
        for client in clients:
            client.close()
    assert max(after - before for before, after in itertools.pairwise(counts)) == 1


async def test_a_flood_of_connections_leaves_the_loop_the_time_between_two(
    admitted: list[socket.socket], component: Component
) -> None:
    began_s = asyncio.get_running_loop().time()
    async with accepting_into(admitted, component) as address:
        clients = [socket.create_connection(address) for _ in range(51)]
        await until(admitted, 51)
        assert asyncio.get_running_loop().time() - began_s >= 0.05
        for client in clients:
            client.close()


async def test_a_connection_that_is_refused_by_an_error_ends_nothing(component: Component) -> None:
    seen = []

    async def admit(connection: socket.socket) -> None:
        seen.append(connection)
        raise ConnectionResetError

    with listen("127.0.0.1", 0) as listener:
        task = asyncio.create_task(accept(listener, component, admit))
        for _ in range(3):
            with socket.create_connection(listener.getsockname()):
                await asyncio.sleep(0.02)
        assert not task.done()
        task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await task
    assert len(seen) == 3
    assert all(connection.fileno() == -1 for connection in seen)


def test_the_last_descriptors_are_told_by_their_number() -> None:
    with socket.socket() as connection:
        limit, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
        assert not is_among_last(connection, 1)
        assert is_among_last(connection, limit - connection.fileno())
        assert not is_among_last(connection, limit - connection.fileno() - 1)


def test_an_address_that_cannot_be_had_is_answered_by_the_process_that_has_it() -> None:
    taken_by_us = rf"Address already in use by \S+ \(process {os.getpid()}\); end it, or choose another port"
    answers = {"192.0.2.1": "Cannot assign requested", "127.0.0.1": taken_by_us, "0.0.0.0": taken_by_us}
    for host, answer in answers.items():
        with socket.create_server(("127.0.0.1", 0)) as taken, pytest.raises(OSError, match=answer):
            listen(host, taken.getsockname()[1])


def test_where_the_process_or_the_right_is_not_known_the_answer_says_what_to_do(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for number, answer in (
        (errno.EADDRINUSE, r"in use: `sudo ss -ltnp 'sport = :502'` shows by which program; end it"),
        (errno.EACCES, r"the service may use ports from 502 up .*; by hand, choose a port from"),
    ):
        refusing = Mock(side_effect=OSError(number, "no"))
        monkeypatch.setattr(socket, "create_server", refusing)
        monkeypatch.setattr(tcp_port, "owner_of_socket", lambda _: None)
        with pytest.raises(OSError, match=answer):
            listen("127.0.0.1", 502)


@pytest.mark.parametrize(
    ("host", "reserved", "client", "queue"),
    [
        ("127.0.0.1", ["127.0.3.1"], "127.0.3.1", 1),
        ("127.0.0.1", ["127.0.3.1"], "127.0.3.2", 0),
        ("127.0.0.1", ["10.0.0.0/8", "127.0.3.0/24"], "127.0.3.255", 1),
        ("127.0.0.1", ["10.0.0.0/8", "127.0.3.0/24"], "127.0.4.0", 0),
        ("127.0.0.1", ["0.0.0.0/0"], "127.0.3.1", 1),
        ("127.0.0.1", ["::/0", "10.0.0.0/8"], "127.0.3.1", 0),
        ("127.0.0.1", [f"127.0.{n}.1" for n in range(64)], "127.0.63.1", 1),
        ("127.0.0.1", [f"127.0.{n}.1" for n in range(64)], "127.0.64.1", 0),
        ("::1", ["2001:db8::/32", "::1"], "::1", 1),
        ("::1", ["::/64"], "::1", 1),
        ("::1", ["::2", "::1:0:0:1", "1::1", "0:0:1::1"], "::1", 0),
        ("::1", [f"2001:db8::{n:x}" for n in range(63)] + ["::/1"], "::1", 1),
    ],
)
def test_reserved_clients_have_their_queue(host: str, reserved: list[str], client: str, queue: int) -> None:
    need(host == "127.0.0.1" or has_ipv6(), "this machine has no IPv6")
    with contextlib.ExitStack() as stack:
        listeners = listen_with_reserved(host, 0, reserved)
        for listener in listeners:
            stack.enter_context(listener)
        stack.enter_context(socket.create_connection(listeners[0].getsockname()[:2], 10, (client, 0)))
        ready, _, _ = select.select(listeners, [], [], 10)
        assert ready == [listeners[queue]]


@pytest.mark.parametrize(
    ("reserved", "server", "client", "queue"),
    [
        ([], "127.0.0.1", "127.0.0.1", 0),
        ([], "::1", "::1", 0),
        (["10.0.0.0/8", "127.0.3.0/24", "2001:db8::/32"], "127.0.0.1", "127.0.3.1", 1),
        (["10.0.0.0/8", "127.0.3.0/24", "::1"], "::1", "::1", 1),
        (["::/0"], "127.0.0.1", "127.0.3.1", 0),
        (["0.0.0.0/0"], "::1", "::1", 0),
    ],
)
def test_every_address_is_served_in_both_versions_of_ip(
    reserved: list[str], server: str, client: str, queue: int
) -> None:
    need(has_ipv6(), "this machine has no IPv6")
    with contextlib.ExitStack() as stack:
        listeners = [stack.enter_context(each) for each in listen_with_reserved("::", 0, reserved)]
        port = listeners[0].getsockname()[1]
        stack.enter_context(socket.create_connection((server, port), 10, (client, 0)))
        ready, _, _ = select.select(listeners, [], [], 10)
        assert ready == [listeners[queue]]


@pytest.mark.parametrize("reserved", [[], ["::/0"]])
def test_without_reserved_clients_of_the_family_there_is_one_queue(reserved: list[str]) -> None:
    (listener,) = listen_with_reserved("127.0.0.1", 0, reserved)
    listener.close()


def test_a_reserved_client_connects_while_the_queue_of_the_others_is_full() -> None:
    with contextlib.ExitStack() as stack:
        listening = listen_with_reserved("127.0.0.1", 0, ["127.0.3.1"])
        listeners = [stack.enter_context(each) for each in listening]
        address = listeners[0].getsockname()
        for _ in range(2 * tcp_port.BACKLOG):
            waiting = stack.enter_context(socket.socket())
            waiting.setblocking(False)
            waiting.connect_ex(address)
        stack.enter_context(socket.create_connection(address, 10, ("127.0.3.1", 0)))
        with pytest.raises(TimeoutError):
            stack.enter_context(socket.create_connection(address, 0.2, ("127.0.3.2", 0)))


@pytest.mark.parametrize("first", [[], ["127.0.3.1"]])
@pytest.mark.parametrize("second", [[], ["127.0.3.1"]])
def test_two_daemons_never_share_a_port(first: list[str], second: list[str]) -> None:
    with contextlib.ExitStack() as stack:
        listeners = [stack.enter_context(each) for each in listen_with_reserved("127.0.0.1", 0, first)]
        with pytest.raises(OSError, match=f"Address already in use by .* \\(process {os.getpid()}\\)"):
            listen_with_reserved("127.0.0.1", listeners[0].getsockname()[1], second)


@pytest.mark.parametrize(
    ("host", "group"),
    [
        ("192.168.1.10", "192.168.1.10"),
        ("::ffff:10.0.0.1", "10.0.0.1"),
        ("2001:db8::1", "2001:db8::/64"),
        ("2001:db8::ffff:1", "2001:db8::/64"),
        ("2001:db8:0:1::1", "2001:db8:0:1::/64"),
        ("fe80::1%eth0", "fe80::/64"),
    ],
)
def test_a_host_with_a_network_of_its_own_counts_once(host: str, group: str) -> None:
    address = address_of(host)
    assert group_of(address) == group
