"""Pictures over a WebSocket, by a foreign client (the library websockets) and by hostile bytes."""

from __future__ import annotations

import asyncio
import contextlib
import json
import random
import socket
import struct
from collections.abc import AsyncIterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import pytest
from support.clock import FakeClock
from unit.publish.http.conftest import Served, Unit
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, InvalidStatus

from altd.publish.http import pictures
from altd.status.health import Component, Health
from altd.status.picture_desk import NoPictureError, Picture, SpotContour, TargetView

AXES = (375.0, 240.0), (-4.0, 0.0), (0.0, -4.0)
VIEWS = (
    TargetView("front", "left", 752, 480, ((1.0, 2.0), (3.0, 4.0)), ((5.0, 6.0),), *AXES),
    TargetView("rear", "right", 752, 480, (), (), *AXES),
)
SHOWN_AXES = {"middle": [375, 240], "x_axis": [-4, 0], "y_axis": [0, -4]}
SIZE = {"width": 752, "height": 480}
SPOT = SpotContour(200.123, 100.5, 22.0, 21.0, -30.0)


def picture(target: str, number: int, **about: Any) -> Picture:
    values = {"sequence": 100 + number, "t_ns": 8_000_000_000, "width": 752, "height": 480, "spot": SPOT}
    values |= {"why": "", "leds_on": False, "jpeg": b"\xff\xd8" + target.encode() * number, **about}
    return Picture(target, number, **values)  # type: ignore[arg-type]


@dataclass
class Maker:
    """Gives what a test puts into it."""

    views: Sequence[TargetView] = VIEWS
    newest: dict[str, Picture] = field(default_factory=dict)
    asked: list[dict[str, int]] = field(default_factory=list)
    fails: str = ""

    def put(self, *newest: Picture) -> None:
        self.newest |= {each.target: each for each in newest}

    async def newer(self, seen: dict[str, int]) -> Sequence[Picture]:
        self.asked.append(dict(seen))
        while True:
            if self.fails:
                raise NoPictureError(self.fails)
            if ready := [each for each in self.newest.values() if each.number > seen.get(each.target, 0)]:
                return ready
            await asyncio.sleep(0.005)


@pytest.fixture
def maker(health: Health) -> Maker:
    maker = Maker()
    health.pictures.open(maker)
    return maker


def looking(unit: Unit, **options: Any) -> contextlib.AbstractAsyncContextManager[ClientConnection]:
    return connect(f"ws://127.0.0.1:{unit.port}/api/v1/pictures", compression=None, **options)


async def first(browser: ClientConnection) -> Any:
    async with asyncio.timeout(5.0):
        return json.loads(await browser.recv())


async def answered(browser: ClientConnection, ask: str = "next") -> tuple[dict[str, Any], bytes]:
    """The header of the next message, and what is behind it."""
    async with asyncio.timeout(5.0):  # asyncio.wait_for of Python 3.11 may lose a cancellation
        await browser.send(ask)
        message = await browser.recv()
    assert isinstance(message, bytes)
    length = int.from_bytes(message[:4], "big")
    return json.loads(message[4 : 4 + length]), message[4 + length :]


async def shown(browser: ClientConnection, ask: str = "next") -> list[tuple[dict[str, Any], bytes]]:
    """Each picture's header and its JPEG."""
    header, rest = await answered(browser, ask)
    found = []
    for each in header["pictures"]:
        found.append((each, rest[: each["bytes"]]))
        rest = rest[each["bytes"] :]
    assert rest == b""
    return found


async def test_a_browser_gets_the_newest_picture_of_each_target_with_what_is_in_it(
    served: Served, maker: Maker
) -> None:
    maker.put(picture("front", 7), picture("rear", 3, spot=None, why="rear_spot_missing", leds_on=True))
    async with served() as unit, looking(unit) as browser:
        assert await first(browser) == {
            "views": [
                {
                    "target": "front",
                    "width": 752,
                    "height": 480,
                    "outline": [[1, 2], [3, 4]],
                    "leds": [[5, 6]],
                    **SHOWN_AXES,
                },
                {"target": "rear", "width": 752, "height": 480, "outline": [], "leds": [], **SHOWN_AXES},
            ]
        }
        (front, jpeg), (rear, rear_jpeg) = await shown(browser)
        assert (jpeg, rear_jpeg) == (maker.newest["front"].jpeg, maker.newest["rear"].jpeg)
        assert front == {
            "target": "front",
            "sequence": 107,
            "age_s": 0.0,
            "width": 752,
            "height": 480,
            "spot": {
                "u_px": 200.12,
                "v_px": 100.5,
                "semi_major_px": 22,
                "semi_minor_px": 21,
                "turn_deg": -30,
            },
            "why": "",
            "leds_on": False,
            "bytes": len(jpeg),
        }
        assert (rear["spot"], rear["why"], rear["leds_on"]) == (None, "rear_spot_missing", True)


async def test_each_picture_comes_once_and_only_when_it_is_asked_for(served: Served, maker: Maker) -> None:
    maker.put(picture("front", 1))
    async with served() as unit, looking(unit) as browser:
        await first(browser)
        with pytest.raises(TimeoutError):
            await asyncio.wait_for(browser.recv(), 0.2)
        assert maker.asked == []
        assert [each["sequence"] for each, _ in await shown(browser)] == [101]
        maker.put(picture("front", 2), picture("rear", 1))
        maker.put(picture("front", 9))
        assert [each["sequence"] for each, _ in await shown(browser)] == [109, 101]
        assert maker.asked == [{}, {"front": 1}]


async def test_where_nothing_new_comes_it_is_told_that_the_unit_is_there(
    served: Served, maker: Maker, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pictures, "NOTHING_NEW_S", 0.1)
    async with served() as unit, looking(unit) as browser:
        await first(browser)
        assert await shown(browser) == []
        maker.put(picture("rear", 1))
        assert len(await shown(browser)) == 1


async def test_a_picture_says_how_old_its_light_is(
    served: Served, maker: Maker, component: Component
) -> None:
    maker.put(picture("front", 1, t_ns=component.clock.monotonic_ns() - 1_234_000_000))
    async with served() as unit, looking(unit) as browser:
        await first(browser)
        assert (await shown(browser))[0][0]["age_s"] == 1.234


async def test_a_message_says_for_how_long_the_unit_held_it(
    served: Served, maker: Maker, clock: FakeClock
) -> None:
    async with served() as unit, looking(unit) as browser:
        await first(browser)
        answer = asyncio.create_task(answered(browser))
        await unit.until(lambda: len(maker.asked) == 1)
        clock.now_ns += 250_000_000
        maker.put(picture("front", 1))
        assert (await answer)[0]["held_s"] == 0.25


async def test_a_browser_that_asks_for_nothing_any_more_is_closed(
    served: Served, maker: Maker, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pictures, "MAX_SILENCE_S", 0.2)
    async with served() as unit, looking(unit) as browser:
        await first(browser)
        with pytest.raises(ConnectionClosed) as closed:
            await asyncio.wait_for(browser.recv(), 5.0)
        assert closed.value.rcvd is not None
        assert (closed.value.rcvd.code, closed.value.rcvd.reason) == (1001, "nothing was asked for")


async def test_more_browsers_than_may_look_are_told_so(
    served: Served, maker: Maker, component: Component
) -> None:
    maker.put(picture("front", 1))
    async with served() as unit, contextlib.AsyncExitStack() as browsers:
        for _ in range(pictures.MAX_VIEWERS):
            await first(await browsers.enter_async_context(looking(unit)))
        async with looking(unit) as late:
            with pytest.raises(ConnectionClosed) as closed:
                await asyncio.wait_for(late.recv(), 5.0)
            assert closed.value.rcvd is not None
            assert closed.value.rcvd.code == 1013
        assert component.counters["viewers_refused"] == 1
        await browsers.aclose()
        await unit.until(lambda: unit.publisher.open_viewers == 0)
        async with looking(unit) as browser:
            await first(browser)
            assert len(await shown(browser)) == 1


async def test_a_frame_that_cannot_be_shown_closes_with_the_reason(served: Served, maker: Maker) -> None:
    async with served() as unit, looking(unit) as browser:
        await first(browser)
        maker.fails = "the frame of front cannot be encoded"
        with pytest.raises(ConnectionClosed) as closed:
            await shown(browser)
        assert closed.value.rcvd is not None
        assert (closed.value.rcvd.code, closed.value.rcvd.reason) == (1013, maker.fails)


async def test_a_unit_without_pictures_says_so(served: Served) -> None:
    async with served() as unit, looking(unit) as browser:
        with pytest.raises(ConnectionClosed) as closed:
            await asyncio.wait_for(browser.recv(), 5.0)
        assert closed.value.rcvd is not None
        assert closed.value.rcvd.reason == "this unit shows no pictures"


@pytest.mark.parametrize("ask", ["x" * 300, b"next"])
async def test_what_is_no_request_for_a_picture_ends_the_connection(
    served: Served, maker: Maker, ask: str | bytes
) -> None:
    async with served() as unit, looking(unit) as browser:
        await first(browser)
        await browser.send(ask)
        with pytest.raises(ConnectionClosed) as closed:
            await asyncio.wait_for(browser.recv(), 5.0)
        assert closed.value.rcvd is not None
        assert closed.value.rcvd.code in (1003, 1009)
        await unit.until(lambda: unit.publisher.open_viewers == 0)


async def test_pings_of_who_has_left_are_answered_to_nobody_and_logged_nowhere(
    served: Served, maker: Maker, caplog: pytest.LogCaptureFixture
) -> None:
    async with served() as unit:
        for _ in range(5):
            reader, writer = await unit.connect()
            writer.write(HANDSHAKE)
            async with asyncio.timeout(5.0):
                await reader.readuntil(b"\r\n\r\n")
            writer.write(b"\x89\x80\x00\x00\x00\x00" * 300)
            leaving = writer.get_extra_info("socket")
            leaving.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))  # by a reset
            writer.transport.abort()
            await unit.until(lambda: unit.publisher.open_viewers == 0)
    assert caplog.records == []


@pytest.mark.parametrize("before", [b"\x82\x80\x00\x00\x00\x00", b"\x81\x84\x00\x00\x00\x00next"])
async def test_what_is_to_be_said_after_too_large_a_message_is_no_defect(
    served: Served, maker: Maker, caplog: pytest.LogCaptureFixture, before: bytes
) -> None:
    async with served() as unit:
        reader, writer = await unit.connect()
        writer.write(HANDSHAKE)
        async with asyncio.timeout(5.0):
            await reader.readuntil(b"\r\n\r\n")
            writer.write(before + b"\x81\xfe\x01\x2c\x00\x00\x00\x00" + b"n" * 300)
            await asyncio.sleep(0.05)
            maker.put(picture("front", 1))
            assert (await reader.read()).endswith(b"maximum size (256 bytes)")
        writer.close()
        await unit.until(lambda: unit.publisher.open_viewers == 0)
    assert caplog.records == []


async def test_who_speaks_before_the_unit_has_agreed_and_leaves_is_noticed(
    served: Served, maker: Maker
) -> None:
    async with served() as unit:
        reader, writer = await unit.connect()
        writer.write(HANDSHAKE + b"\x89\x80\x00\x00\x00\x00" * 1000)
        async with asyncio.timeout(5.0):
            await reader.readuntil(b"\r\n\r\n")
        await unit.until(lambda: unit.publisher.open_viewers == 1)
        writer.close()
        await unit.until(lambda: unit.publisher.open_viewers == 0)


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
        reader, writer = await unit.connect()
        writer.write(HANDSHAKE)
        async with asyncio.timeout(5.0):
            await reader.readuntil(b"\r\n\r\n")
        writer.write(b"\x01\x80\x00\x00\x00\x00" + more * 40_000)
        with contextlib.suppress(ConnectionError):
            async with asyncio.timeout(5.0):
                heard = await reader.read()
            assert heard.count(b"\x8a\x00") < 350, "2048 bytes have room for 341 empty pings"
        writer.close()
        await unit.until(lambda: unit.publisher.open_viewers == 1)
        assert len(await shown(browser)) == 1


async def test_a_page_of_another_site_sees_no_pictures(served: Served, maker: Maker) -> None:
    async with served() as unit:
        for origin in ("http://evil.example", "null", f"https://127.0.0.1:{unit.port}", "http://127.0.0.1:1"):
            with pytest.raises(InvalidStatus) as refused:
                async with looking(unit, origin=origin):
                    pass
            assert refused.value.response.status_code == 403
        async with looking(unit, origin=f"http://127.0.0.1:{unit.port}") as browser:
            await first(browser)


async def test_there_is_no_other_socket(served: Served, maker: Maker) -> None:
    async with served() as unit:
        for path in ("/", "/api/v1/measurement", "/api/v1/pictures/", "/nothing"):
            with pytest.raises(InvalidStatus):
                async with connect(f"ws://127.0.0.1:{unit.port}{path}"):
                    pass


@contextlib.asynccontextmanager
async def one_that_looks(unit: Unit, maker: Maker) -> AsyncIterator[list[int]]:
    """A browser that must be shown every picture that is made, whatever happens beside it."""
    seen: list[int] = []
    ended = asyncio.Event()

    async def look() -> None:
        async with looking(unit) as browser:
            await first(browser)
            while not ended.is_set():
                maker.put(picture("front", len(seen) + 1))
                seen.extend(each["sequence"] - 100 for each, _ in await shown(browser))
                await asyncio.sleep(0.02)  # as the unit's own pictures, which come ten times a second

    task = asyncio.create_task(look())
    yield seen
    ended.set()
    await task
    assert len(seen) > 20
    assert seen == list(range(1, len(seen) + 1))


HANDSHAKE = (
    b"GET /api/v1/pictures HTTP/1.1\r\nHost: unit\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n"
)


def hostile(rng: random.Random) -> bytes:
    """A handshake that was spoilt, or a good one with frames that no browser sends."""
    spoilt = bytearray(HANDSHAKE)
    if rng.random() < 0.4:
        for _ in range(rng.randint(1, 6)):
            spoilt[rng.randrange(len(spoilt))] = rng.randrange(256)
        return bytes(spoilt)
    frames = bytearray()
    for _ in range(rng.randint(1, 8)):
        length = rng.choice([0, 1, 5, 125, 126, 127])
        frames += bytes([rng.randrange(256), rng.choice([0, 128]) | length])
        frames += rng.randbytes(rng.choice([0, 2, 4, 8, 12, 200]))
    return HANDSHAKE + bytes(frames)


async def test_garbage_does_not_trouble_it_nor_who_looks_beside_it(
    served: Served, maker: Maker, caplog: pytest.LogCaptureFixture
) -> None:
    rng = random.Random(1)
    async with served() as unit:
        async with one_that_looks(unit, maker):
            for _ in range(40):
                await asyncio.gather(*(_throw(unit, hostile(rng)) for _ in range(10)))
        await unit.until(lambda: unit.publisher.open_viewers == 0)
        assert not unit.task.done()
    assert caplog.records == []


async def _throw(unit: Unit, data: bytes) -> None:
    reader, writer = await unit.connect()
    writer.write(data)
    with contextlib.suppress(ConnectionError, TimeoutError):
        await asyncio.wait_for(reader.read(4096), 0.05)
    writer.close()
