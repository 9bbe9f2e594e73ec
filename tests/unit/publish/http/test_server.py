"""Clients that are hostile or many, a port that is taken, and an end that leaves nothing."""

import asyncio
import contextlib
import errno
import signal
import socket
import time

import h11
import pytest
from support.foreign import need
from support.ports import has_ipv6
from support.serving import serving

from altd.config import HttpSettings
from altd.publish.http import server
from altd.publish.http.operations import COMMON_ERRORS
from altd.publish.http.publisher import HttpPublisher
from altd.status.health import Component
from altd.status.unit import PublishedUnit

from .conftest import Answer, Served, Unit


async def test_a_taken_port_is_an_error(published: PublishedUnit, component: Component) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        publisher = HttpPublisher(
            HttpSettings(host="127.0.0.1", port=taken.getsockname()[1]), published, component
        )
        with pytest.raises(OSError, match="in use") as caught:
            await publisher.run(lambda: pytest.fail("not ready"))
    assert caught.value.errno == errno.EADDRINUSE


async def test_a_foreign_address_is_an_error(published: PublishedUnit, component: Component) -> None:
    publisher = HttpPublisher(HttpSettings(host="192.0.2.1", port=0), published, component)
    with pytest.raises(OSError, match="Cannot assign requested address"):
        await publisher.run(lambda: pytest.fail("not ready"))


async def test_it_can_be_served_again_on_the_same_port(
    served: Served, published: PublishedUnit, component: Component
) -> None:
    async with served() as unit, unit.stream() as events:
        await events.head()
        port = unit.port
    publisher = HttpPublisher(HttpSettings(host="127.0.0.1", port=port), published, component)
    async with asyncio.timeout(60), serving(publisher):
        assert publisher.port == port


async def test_cancellation_is_prompt_and_leaves_nothing_even_with_streams_open(served: Served) -> None:
    before = asyncio.all_tasks()
    async with served() as unit:
        readers = [await unit.connect() for _ in range(5)]
        for _, writer in readers[:3]:
            writer.write(b"GET /api/stream HTTP/1.1\r\nHost: unit\r\n\r\n")
        await unit.until(lambda: unit.publisher.answers.streams.open == 3)
        unit.task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await asyncio.wait_for(unit.task, 60)
        assert unit.publisher.answers.streams.open == 0
        for reader, writer in readers:
            with contextlib.suppress(ConnectionError):
                await asyncio.wait_for(reader.read(), 60)
            writer.close()
    await asyncio.sleep(0)
    assert asyncio.all_tasks() == before


async def test_the_signals_stay_the_daemons(unit: Unit) -> None:
    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    await unit.ask("/api/status")
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)] == before


@pytest.fixture
def parsed(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The bytes that h11 got, call by call."""
    lengths: list[int] = []
    receive_data = h11.Connection.receive_data

    def count(connection: h11.Connection, data: bytes) -> None:
        lengths.append(len(data))
        receive_data(connection, data)

    monkeypatch.setattr(h11.Connection, "receive_data", count)
    return lengths


@pytest.mark.parametrize("field", ["Transfer-Encoding: chunked", "transfer-encoding:gzip,chunked"])
@pytest.mark.parametrize("body", [b"", b"1\r\nx\r\n" * 700], ids=["not sent", "at once"])
async def test_a_body_in_chunks_is_refused_and_none_is_parsed(
    unit: Unit, caplog: pytest.LogCaptureFixture, parsed: list[int], field: str, body: bytes
) -> None:
    head = f"POST /api/v1/login HTTP/1.1\r\nHost: a\r\n{field}\r\n\r\n".encode()
    answer = await unit.send(head + body)
    assert answer[:12] == b"HTTP/1.1 411" or (body and not answer)  # closed before all was taken
    assert 411 in COMMON_ERRORS, "the OpenAPI document lacks it"
    assert parsed == []
    assert (await unit.ask("/api/status")).status == 200
    assert caplog.records == []


@pytest.mark.parametrize(
    "fields",
    [
        b"TRANSFER-ENCODING:chunked\r\n",
        b"X: a\nTransfer-Encoding: chunked\n",
        b"X: a\r\n Transfer-Encoding: chunked\r\n",
        b"X: a\rTransfer-Encoding: chunked\r\n",
        b"Transfer-Encoding : chunked\r\n",
        b"Transfer-Encoding\r\n : chunked\r\n",
        b"\r\nTransfer-Encoding: chunked\r\n",
        b"\x0bTransfer-Encoding: chunked\r\n",
    ],
)
@pytest.mark.parametrize("before", [b"", b"\r\n", b"\n", b"\r\n\r\n"])
async def test_no_form_of_the_field_hides_chunks(
    unit: Unit, monkeypatch: pytest.MonkeyPatch, before: bytes, fields: bytes
) -> None:
    """h11 itself decides what a body in chunks is."""
    events: list[object] = []
    next_event = h11.Connection.next_event

    def note(connection: h11.Connection) -> object:
        events.append(next_event(connection))
        return events[-1]

    monkeypatch.setattr(h11.Connection, "next_event", note)
    await unit.send(before + b"POST / HTTP/1.1\r\nHost: a\r\n" + fields + b"\r\n1\r\nx\r\n0\r\n\r\n")
    requests = [event for event in events if isinstance(event, h11.Request)]
    assert all(name != b"transfer-encoding" for request in requests for name, _ in request.headers)


async def test_pipelined_requests_do_not_trouble_it(unit: Unit) -> None:
    pipelined = b"GET /api/status HTTP/1.1\r\nHost: a\r\n\r\n" * 50
    assert (await unit.send(pipelined))[:12] in (b"HTTP/1.1 200", b"")
    assert (await unit.ask("/api/status")).status == 200


@pytest.mark.parametrize("path", ["/api/v1/stream", "/api/v1/measurement", "/api/v1/login"])
@pytest.mark.parametrize("pause_s", [0.0, 0.05], ids=["at once", "later"])
async def test_a_body_that_nobody_asked_for_is_not_parsed(
    unit: Unit, parsed: list[int], path: str, pause_s: float
) -> None:
    head = f"POST {path} HTTP/1.1\r\nHost: a\r\nContent-Length: 200000\r\n\r\n".encode()
    reader, writer = await unit.connect()
    writer.write(head)
    if pause_s:
        await asyncio.sleep(pause_s)
    writer.write(b"x" * 200_000)
    with contextlib.suppress(ConnectionError, TimeoutError):
        async with asyncio.timeout(0.5):
            await reader.read()
    writer.transport.abort()
    assert len(head) <= sum(parsed) <= len(head) + server.MAX_BYTES_BEHIND_HEADER
    parsed.clear()
    assert (await unit.ask("/api/status")).status == 200


async def test_a_header_that_never_ends_is_cut_off(unit: Unit, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "REQUEST_TIMEOUT_S", 0.5)
    reader, writer = await unit.connect()
    started = time.perf_counter()
    with contextlib.suppress(ConnectionError):
        while not (reader.at_eof() or reader.exception()):
            assert time.perf_counter() - started < 60
            writer.write(b"G")
            await asyncio.sleep(0.01)
    writer.close()
    async with unit.stream() as events:
        await events.head()
        await asyncio.sleep(0.6)
        assert unit.publisher.answers.streams.open == 1, "a stream outlives the deadline of its request"


async def test_a_flood_of_connections_is_bounded_and_passes(
    unit: Unit, component: Component, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server, "MAX_CONNECTIONS", 10)
    flood = [await unit.connect() for _ in range(40)]
    await unit.until(lambda: component.counters.get("connections_refused", 0) == 30)
    await unit.until(
        lambda: sum(reader.at_eof() or reader.exception() is not None for reader, _ in flood) >= 30
    )
    for _, writer in flood:
        writer.close()
    await asyncio.sleep(0.05)
    assert (await unit.ask("/api/status")).status == 200


@pytest.mark.parametrize(("host", "client"), [("::1", "::1"), ("::", "::1"), ("::", "127.0.0.1")])
async def test_it_listens_on_ipv6_and_on_every_address_in_both_versions(
    published: PublishedUnit, component: Component, host: str, client: str
) -> None:
    need(has_ipv6(), "this machine has no IPv6")
    settings = HttpSettings(host=host, port=0, allow=("127.0.0.1",))
    publisher = HttpPublisher(settings, published, component)
    async with serving(publisher):
        reader, writer = await asyncio.open_connection(client, publisher.port)
        writer.write(b"GET /healthz HTTP/1.1\r\nHost: unit\r\n\r\n")
        assert b" 200 OK" in await reader.readline()
        writer.close()


@pytest.mark.parametrize(
    ("target", "status"),
    [
        ("http://unit/healthz", 200),
        ("HTTP://unit:8080/api/status?x=1", 200),
        ("http://unit", 200),
        ("http://unit/api/%73tatus", 404),
        ("http://stranger/api/status", 421),
        ("http://stranger@unit.example/api/status", 400),
        ("https://unit/healthz", 404),
        ("ftp://unit/healthz", 404),
        (f"http://unit/{'a' * 2048}", 414),
    ],
)
async def test_a_target_may_be_a_whole_url_and_counts_in_place_of_host(
    unit: Unit, target: str, status: int
) -> None:
    """RFC 9112, 3.2.2."""
    assert (await unit.ask(target, headers={"Host": "unit"})).status == status


HEAD_OF = "GET /healthz HTTP/1.1\r\nHost: unit\r\n"


@pytest.mark.parametrize(
    ("request_text", "status"),
    [
        ("GET /healthz HTTP/1.0\r\n", 200),
        ("GET /healthz HTTP/1.2\r\nHost: unit\r\n", 200),
        ("GET /healthz HTTP/2.0\r\nHost: unit\r\n", 505),
        ("PRI * HTTP/2.0\r\n", 505),
        ("\0\1\2\3\r\n", 400),
        ("GET  /  HTTP/1.1\r\n", 400),
        ("GET / HTTP/1.1\r\n", 400),
        (HEAD_OF + "Host: b\r\n", 400),
        (HEAD_OF + "Content-Length: -1\r\n", 400),
        ("\r\n" + HEAD_OF, 200),
        (HEAD_OF + "X: a\r\n b\r\n", 200),
        ("GET /healthz HTTP/1.1\r\n Host: unit\r\n", 400),
        ("GET /healthz HTTP/1.1\r\nHost : unit\r\n", 400),
        (HEAD_OF + "X: a\0b\r\n", 400),
        (HEAD_OF + "X: a\rb\r\n", 400),
        ("GET /healthz HTTP/1.1\r\nHost:\r\n", 200),
        ("GET /healthz HTTP/1.1\r\nHost: [::1]:80\r\n", 200),
        ("GET /healthz HTTP/1.1\r\nHost: unit:abc\r\n", 400),
        ("GET /healthz HTTP/1.1\r\nHost: unit unit\r\n", 400),
        ("GET /healthz HTTP/1.1\r\nHost: unit/x\r\n", 400),
        ("GET /healthz HTTP/1.1\r\nHost: [::1\r\n", 400),
        (HEAD_OF + "Content-Length: 5, 6\r\n", 400),
        (HEAD_OF + "Content-Length: +5\r\n", 400),
        (HEAD_OF + "Content-Length: 2\r\nTransfer-Encoding: chunked\r\n", 411),
        (f"GET /?{'x' * 3000} HTTP/1.1\r\nHost: unit\r\n", 414),
        (f"GET /?{'x' * 9000} HTTP/1.1\r\nHost: unit\r\n", 414),
        (f"{HEAD_OF}X: {'x' * 9000}\r\n", 431),
        (HEAD_OF + "X: x\r\n" * 70, 431),
        (f"HEAD{HEAD_OF[3:]}X: {'x' * 9000}\r\n", 431),
        (f"HEAD{HEAD_OF[3:]}Transfer-Encoding: chunked\r\n", 411),
        (HEAD_OF + "Expect: 100-continue\r\n", 200),
        (HEAD_OF + 'Accept: image/png\r\nRange: bytes=0-1\r\nIf-None-Match: "x"\r\n', 200),
        (HEAD_OF + "Connection: Upgrade, HTTP2-Settings\r\nUpgrade: h2c\r\n", 200),
        ("GET /api/v1/pictures HTTP/1.1\r\nHost: unit\r\n", 426),
    ],
)
async def test_each_form_of_a_request_has_its_status(unit: Unit, request_text: str, status: int) -> None:
    """RFC 9110 and 9112; each answer has a date, and none to HEAD a body."""
    answer = Answer.of(await unit.send(f"{request_text}\r\n".encode()))
    assert answer.status == status
    assert answer.headers["date"].endswith(" GMT")
    assert answer.headers["connection"] == "close"
    assert (answer.body == b"") is request_text.startswith("HEAD")
    assert status != 426 or answer.headers["upgrade"] == "websocket"
    assert status in {200, 426, *COMMON_ERRORS}


async def test_a_client_that_waits_for_100_is_told_to_go_on(unit: Unit) -> None:
    """RFC 9110, 10.1.1."""
    reader, writer = await unit.connect()
    head = "POST /api/v1/login HTTP/1.1\r\nHost: unit\r\nContent-Type: application/json\r\n"
    writer.write(f"{head}Content-Length: 2\r\nExpect: 100-continue\r\n\r\n".encode())
    assert await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), 60) == b"HTTP/1.1 100 Continue\r\n\r\n"
    writer.write(b"{}")
    assert (await asyncio.wait_for(reader.read(), 60)).startswith(b"HTTP/1.1 400 ")
    writer.close()


async def test_a_stream_for_http_1_0_is_not_chunked(unit: Unit) -> None:
    """RFC 9112, 6.1."""
    reader, writer = await unit.connect()
    writer.write(b"GET /api/stream HTTP/1.0\r\n\r\n")
    head = await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), 60)
    assert head.startswith(b"HTTP/1.1 200 ")
    assert b"transfer-encoding" not in head.lower()
    writer.close()
