"""20,000 hostile requests on the local socket beside a poller: it is answered rightly all the time."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import random
from pathlib import Path

import pytest

from altd.publish.http.local import LocalPublisher
from altd.records import Measurement
from altd.status.board import Board
from altd.status.health import Health

REQUESTS = 20_000
CLIENTS = 16
_GOOD = (
    b"GET /api/v1/measurement HTTP/1.1\r\nHost: a\r\n\r\n",
    b"GET /api/v1/status HTTP/1.1\r\nHost: a\r\nAccept: */*\r\n\r\n",
    b"POST /api/v1/self-check HTTP/1.1\r\nHost: localhost\r\nX-Altd-Request: 1\r\n\r\n",
    b"HEAD /api/v1/targets?a=%00 HTTP/1.1\r\nHost: a\r\nContent-Length: 5\r\n\r\nhello",
    b"GET /../../etc/passwd HTTP/1.0\r\n\r\n",
    b"GET /api/status HTTP/1.1\r\nHost: a\r\nTransfer-Encoding: chunked\r\n\r\n5\r\nhello\r\n0\r\n\r\n",
)


def spoilt(chance: random.Random) -> bytes:
    """A request of which bytes are changed, taken out or doubled."""
    request = bytearray(chance.choice(_GOOD))
    for _ in range(1 + chance.randrange(4)):
        at = chance.randrange(len(request))
        match chance.randrange(3):
            case 0:
                request[at] = chance.randrange(256)
            case 1:
                del request[at : at + chance.randrange(1, 8)]
            case 2:
                request[at:at] = request[max(at - 8, 0) : at] * chance.randrange(1, 5)
        if not request:
            return b"\r\n"
    return bytes(request)


async def test_none_of_them_costs_the_poller_an_answer(
    tmp_path: Path, board: Board, health: Health, measured: Measurement, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.WARNING)
    board.publish(measured)
    path = tmp_path / "altd.sock"
    publisher = LocalPublisher(path, board, health, health.component("local"))
    ready = asyncio.Event()
    serving = asyncio.ensure_future(publisher.run(ready.set))
    await ready.wait()
    left, polled = iter(range(REQUESTS)), 0

    async def attack(seed: int) -> None:
        chance = random.Random(seed)
        for _ in left:
            reader, writer = await asyncio.open_unix_connection(path)
            with contextlib.suppress(ConnectionError):
                writer.write(spoilt(chance))
                writer.write_eof()
                answer = await reader.read(300)
                assert answer == b"" or answer.startswith(b"HTTP/1.1 ")
            writer.transport.abort()

    attacks = [asyncio.create_task(attack(seed)) for seed in range(CLIENTS)]
    while not all(task.done() for task in attacks):
        async with asyncio.timeout(5.0):
            reader, writer = await asyncio.open_unix_connection(path)
            writer.write(b"GET /api/v1/measurement HTTP/1.1\r\nHost: a\r\n\r\n")
            head, _, body = (await reader.read()).partition(b"\r\n\r\n")
            writer.close()
        assert head.startswith(b"HTTP/1.1 200 ")
        assert b'"sequence": 160' in body
        polled += 1
        await asyncio.sleep(0.02)
    await asyncio.gather(*attacks)
    assert not serving.done()
    serving.cancel()
    await asyncio.wait({serving})
    assert polled > 20
    assert not caplog.records, caplog.text
