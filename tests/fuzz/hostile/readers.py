"""Regular readers of the unit while it is attacked."""

import asyncio
import json
import time
import zlib

from fuzz.hostile.pictures import PATH, complaint_of_pictures
from fuzz.hostile.requests import Address, connected
from fuzz.hostile.tally import Tally
from websockets.asyncio.client import connect
from websockets.exceptions import WebSocketException

from tools.pages.example import MEASURED

_POLL_TIMEOUT_S = 5.0


async def poll(address: Address, tally: Tally) -> None:
    """Read the measurement once, as a program does, and check it."""
    began_s = time.monotonic()
    heard = b""
    try:
        async with asyncio.timeout(_POLL_TIMEOUT_S):
            reader, writer = await asyncio.open_connection(sock=await asyncio.to_thread(connected, address))
            writer.write(b"GET /api/v1/measurement HTTP/1.1\r\nHost: unit\r\n\r\n")
            heard = await reader.read()
            writer.close()
    except (OSError, TimeoutError) as error:
        tally.wrong.append(f"the poller got nothing: {error!r}")
        return
    body = heard.partition(b"\r\n\r\n")[2]
    line, _, crc = body.rpartition(b', "crc32": ')
    if crc != b'"%08X"}' % zlib.crc32(line) or json.loads(body)["x_mm"] != MEASURED.number("x_mm"):
        tally.wrong.append(f"the poller read {heard[:200]!r}")
        return
    tally.polled(time.monotonic() - began_s)


async def look(address: tuple[str, int], tally: Tally, ended: asyncio.Event) -> None:
    """Be a browser that looks at the pictures until the end, over one connection."""
    host, port = address
    try:
        async with connect(f"ws://{host}:{port}{PATH}", compression=None) as socket:
            await socket.recv()
            while not ended.is_set():
                async with asyncio.timeout(_POLL_TIMEOUT_S):
                    await socket.send("next")
                    message = await socket.recv()
                why = complaint_of_pictures(message) if isinstance(message, bytes) else "a text"
                if why:
                    tally.wrong.append(f"the browser was shown {why}")
                else:
                    tally.pictures += 1
    except (OSError, TimeoutError, WebSocketException) as error:
        tally.wrong.append(f"the browser that looked was lost: {error!r}")
