"""A browser that looks at pictures: the library websockets, and what it is shown."""

import asyncio
import contextlib
import json
from typing import Any

import pytest
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed

from .conftest import Unit


def looking(unit: Unit, **options: Any) -> contextlib.AbstractAsyncContextManager[ClientConnection]:
    return connect(f"ws://127.0.0.1:{unit.port}/api/v1/pictures", compression=None, **options)


async def first(browser: ClientConnection) -> Any:
    async with asyncio.timeout(60):
        return json.loads(await browser.recv())


async def answered(browser: ClientConnection, ask: str = "next") -> tuple[dict[str, Any], bytes]:
    """The header of the next message, and what is behind it."""
    async with asyncio.timeout(60):  # asyncio.wait_for of Python 3.11 may lose a cancellation
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


async def closed(browser: ClientConnection) -> tuple[int, str]:
    """Code and reason with which the unit closes the connection."""
    with pytest.raises(ConnectionClosed) as closed:
        await asyncio.wait_for(browser.recv(), 60)
    assert closed.value.rcvd is not None
    return closed.value.rcvd.code, closed.value.rcvd.reason
