"""The stream: every measurement once, the newest first for the slow, silence that is reported."""

import asyncio
import socket
from dataclasses import replace

import pytest
from support.clock import FakeClock

from altd.publish.http import server, stream
from altd.records import Measurement
from altd.status.board import Board
from altd.status.health import Component
from altd.status.measurement_json import as_object_now

from .conftest import Served, Unit


async def test_the_latest_comes_at_once_and_then_every_new_one(
    served: Served, board: Board, component: Component, measured: Measurement
) -> None:
    board.publish(measured)
    async with served() as unit, unit.stream() as events:
        head = (await events.head()).lower()
        assert b"content-type: text/event-stream" in head
        assert b"cache-control: no-store" in head
        assert b"x-accel-buffering: no" in head, "nginx would hold events back"
        sequence, told = await events.event()
        assert sequence == "160"
        assert told.items() >= as_object_now(measured, board.age_s()).items()
        for sequence in range(161, 171):
            board.publish(replace(measured, sequence=sequence))
            assert (await events.event())[0] == str(sequence)
    assert component.counters["streams"] == 1
    assert component.counters["events_skipped"] == 0
    assert component.data_given == 11


async def test_a_head_of_a_stream_has_the_headers_and_no_length(unit: Unit) -> None:
    for path in ("/api/stream", "/api/v1/stream"):
        answer = await unit.ask(path, "HEAD")
        assert (answer.status, answer.body) == (200, b"")
        assert answer.headers["content-type"].startswith("text/event-stream")
        assert answer.headers["x-accel-buffering"] == "no"
        assert "content-length" not in answer.headers


async def test_silence_is_told_by_a_comment(
    served: Served, board: Board, measured: Measurement, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stream, "KEEP_ALIVE_INTERVAL_S", 0.02)
    async with served() as unit, unit.stream() as events:
        await events.head()
        assert (await events.block()).startswith("retry: ")
        assert await events.block() == ": nothing new"
        board.publish(measured)
        assert (await events.event())[0] == "160"
        assert await events.block() == ": nothing new"


async def test_a_measurement_that_goes_stale_is_told_once(
    served: Served, board: Board, clock: FakeClock, measured: Measurement, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stream, "KEEP_ALIVE_INTERVAL_S", 0.02)
    board.publish(measured)
    async with served() as unit, unit.stream() as events:
        await events.head()
        await events.event()
        clock.now_ns += 2_000_000_000
        sequence, told = await events.event()
        assert (sequence, told["valid"], told["status"]) == ("160", False, ["stale"])
        assert await events.block() == ": nothing new"


async def test_a_slow_client_skips_and_then_gets_the_newest(
    unit: Unit, board: Board, component: Component, measured: Measurement
) -> None:
    with socket.socket() as client:
        client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        client.setblocking(False)
        loop = asyncio.get_running_loop()
        await loop.sock_connect(client, ("127.0.0.1", unit.port))
        await loop.sock_sendall(client, b"GET /api/stream HTTP/1.1\r\nHost: unit\r\n\r\n")
        await unit.until(lambda: component.counters.get("streams", 0) == 1)
        for sequence in range(2000):
            board.publish(replace(measured, sequence=sequence))
            await asyncio.sleep(0)
        received = b""
        async with asyncio.timeout(60):
            while b"id: 1999\n" not in received:
                received += await loop.sock_recv(client, 65536)
    ids = [int(line[4:]) for line in received.split(b"\n") if line.startswith(b"id: ")]
    assert ids == sorted(set(ids))
    assert len(ids) < 300, "old measurements were queued"
    assert component.counters["events_skipped"] == 2000 - len(ids)
    await unit.until(lambda: unit.publisher.answers.streams.open == 0)


async def test_a_client_that_goes_away_leaves_nothing(unit: Unit, measured: Measurement) -> None:
    before = len(asyncio.all_tasks())
    for _ in range(3):
        async with unit.stream() as events:
            await events.head()
            assert unit.publisher.answers.streams.open == 1
        await unit.until(lambda: unit.publisher.answers.streams.open == 0)
    await unit.until(lambda: len(asyncio.all_tasks()) == before)


async def test_a_stalled_client_is_cut_off(
    served: Served, board: Board, component: Component, measured: Measurement, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server, "SEND_TIMEOUT_S", 1)
    async with served() as unit:
        with socket.socket() as client:
            client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            client.connect(("127.0.0.1", unit.port))
            client.sendall(b"GET /api/stream HTTP/1.1\r\nHost: unit\r\n\r\n")
            await unit.until(lambda: unit.publisher.answers.streams.open == 1)
            for sequence in range(500):
                board.publish(replace(measured, sequence=sequence))
                await asyncio.sleep(0)
            assert unit.publisher.answers.streams.open == 1
            await unit.until(lambda: unit.publisher.answers.streams.open == 0, timeout_s=60)


async def test_only_so_many_streams_are_served(
    unit: Unit, component: Component, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stream, "MAX_STREAMS", 2)
    async with unit.stream() as first, unit.stream() as second:
        await first.head()
        await second.head()
        refused = await unit.ask("/api/stream")
        assert refused.status == 503
        assert refused.json == {"error": "2 streams are open already"}
        assert (await unit.ask("/api/status")).status == 200
    await unit.until(lambda: unit.publisher.answers.streams.open == 0)
    async with unit.stream() as again:
        assert b" 200 " in await again.head()
    assert component.counters["streams_refused"] == 1
