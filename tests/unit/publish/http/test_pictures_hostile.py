"""Hostile clients of the pictures over a WebSocket, most of them by bytes that no browser sends."""

import asyncio
import contextlib
import socket
import struct

import pytest
from support.picture_maker import Maker, picture
from websockets.exceptions import InvalidStatus

from .browsers import closed, first, looking, shown
from .conftest import Served, Unit

HANDSHAKE = (
    b"GET /api/v1/pictures HTTP/1.1\r\nHost: unit\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n"
)


async def shaken(unit: Unit, more: bytes = b"") -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
    """A connection to which the unit has agreed, with what is sent at once behind the request."""
    reader, writer = await unit.connect()
    writer.write(HANDSHAKE + more)
    async with asyncio.timeout(60):
        await reader.readuntil(b"\r\n\r\n")
    return reader, writer


@pytest.mark.parametrize("ask", ["x" * 300, b"next"])
async def test_what_is_no_request_for_a_picture_ends_the_connection(
    served: Served, maker: Maker, ask: str | bytes
) -> None:
    async with served() as unit, looking(unit) as browser:
        await first(browser)
        await browser.send(ask)
        assert (await closed(browser))[0] in (1003, 1009)
        await unit.until(lambda: unit.publisher.answers.viewers.open == 0)


async def test_pings_of_who_has_left_are_answered_to_nobody_and_logged_nowhere(
    unit: Unit, maker: Maker, caplog: pytest.LogCaptureFixture
) -> None:
    for _ in range(5):
        _, writer = await shaken(unit)
        writer.write(b"\x89\x80\x00\x00\x00\x00" * 300)
        leaving = writer.get_extra_info("socket")
        leaving.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))  # by a reset
        writer.transport.abort()
        await unit.until(lambda: unit.publisher.answers.viewers.open == 0)
    assert caplog.records == []


@pytest.mark.parametrize("before", [b"\x82\x80\x00\x00\x00\x00", b"\x81\x84\x00\x00\x00\x00next"])
async def test_what_is_to_be_said_after_too_large_a_message_is_no_defect(
    unit: Unit, maker: Maker, caplog: pytest.LogCaptureFixture, before: bytes
) -> None:
    reader, writer = await shaken(unit)
    async with asyncio.timeout(60):
        writer.write(before + b"\x81\xfe\x01\x2c\x00\x00\x00\x00" + b"n" * 300)
        await asyncio.sleep(0.05)
        maker.put(picture("front", 1))
        assert (await reader.read()).endswith(b"maximum size (256 bytes)")
    writer.close()
    await unit.until(lambda: unit.publisher.answers.viewers.open == 0)
    assert caplog.records == []


async def test_who_speaks_before_the_unit_has_agreed_and_leaves_is_noticed(unit: Unit, maker: Maker) -> None:
    _, writer = await shaken(unit, b"\x89\x80\x00\x00\x00\x00" * 1000)
    await unit.until(lambda: unit.publisher.answers.viewers.open == 1)
    writer.close()
    await unit.until(lambda: unit.publisher.answers.viewers.open == 0)


@pytest.mark.parametrize(
    "more",
    [b"\x89\x80\x00\x00\x00\x00", b"\x8a\x80\x00\x00\x00\x00", b"\x00\x80\x00\x00\x00\x00"],
    ids=["pings", "pongs", "fragments"],
)
async def test_who_sends_more_than_a_browser_is_cut_off_before_it_is_parsed(
    served: Served, maker: Maker, more: bytes
) -> None:
    maker.put(picture("front", 1))
    async with served() as unit, looking(unit) as browser:
        await first(browser)
        reader, writer = await shaken(unit)
        writer.write(b"\x01\x80\x00\x00\x00\x00" + more * 40_000)
        with contextlib.suppress(ConnectionError):
            async with asyncio.timeout(60):
                heard = await reader.read()
            assert heard.count(b"\x8a\x00") < 350, "2048 bytes have room for 341 empty pings"
        writer.close()
        await unit.until(lambda: unit.publisher.answers.viewers.open == 1)
        assert len(await shown(browser)) == 1


async def test_a_page_of_another_site_sees_no_pictures(unit: Unit, maker: Maker) -> None:
    for origin in ("http://evil.example", "null", f"https://127.0.0.1:{unit.port}", "http://127.0.0.1:1"):
        with pytest.raises(InvalidStatus) as refused:
            async with looking(unit, origin=origin):
                pass
        assert refused.value.response.status_code == 403
    async with looking(unit, origin=f"http://127.0.0.1:{unit.port}") as browser:
        await first(browser)
