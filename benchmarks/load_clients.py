"""``python -m benchmarks.load_clients MODBUS HTTP CONTROLLERS BROWSERS SECONDS``: all who read a unit.

A controller polls over Modbus TCP 20 times a second. A browser does over the network what the page does: the
stream, the status twice a second, and pictures, the next when it has the last. What it shows costs its own
computer, so none is drawn here. Prints as JSON how long each poll took, ms, which pictures came when (the
frame's number, Unix time in ms), and what else came.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import sys
import time
from dataclasses import asdict, dataclass, field

from websockets.asyncio.client import connect

from benchmarks.poller import ANSWER_BYTES, READ

_HOST = "127.0.0.1"
_POLLS_PER_S = 20.0
_LOOK_S = 0.5


@dataclass
class Seen:
    """What all of them got."""

    polls_ms: list[float] = field(default_factory=list)
    pictures: list[tuple[int, float]] = field(default_factory=list)
    events: int = 0
    answers: int = 0


async def control(port: int, number: int, controllers: int, seen: Seen) -> None:
    """Poll for ever; the controllers are spread over a period."""
    reader, writer = await asyncio.open_connection(_HOST, port)
    due_s = time.monotonic() + number / controllers / _POLLS_PER_S
    while True:
        await asyncio.sleep(max(due_s - time.monotonic(), 0.0))
        due_s += 1 / _POLLS_PER_S
        begun_ns = time.monotonic_ns()
        writer.write(READ)
        answer = await reader.readexactly(ANSWER_BYTES)
        if answer[7] != 4:
            raise ConnectionError(answer.hex())
        seen.polls_ms.append((time.monotonic_ns() - begun_ns) * 1e-6)


async def stream(port: int, seen: Seen) -> None:
    """Read events for ever."""
    reader, writer = await asyncio.open_connection(_HOST, port)
    writer.write(b"GET /api/v1/stream HTTP/1.1\r\nHost: localhost\r\n\r\n")
    while data := await reader.read(1 << 16):
        seen.events += data.count(b"\ndata: ")


async def look(port: int, seen: Seen) -> None:
    """Ask for the status for ever."""
    while True:
        reader, writer = await asyncio.open_connection(_HOST, port)
        writer.write(b"GET /api/v1/status HTTP/1.1\r\nHost: localhost\r\n\r\n")
        answer = await reader.read(-1)
        writer.close()
        seen.answers += answer.startswith(b"HTTP/1.1 200")
        await asyncio.sleep(_LOOK_S)


async def watch(port: int, seen: Seen) -> None:
    """Take pictures for ever."""
    async with connect(f"ws://{_HOST}:{port}/api/v1/pictures", compression=None, max_size=None) as socket:
        await socket.recv()
        while True:
            await socket.send("next")
            message = await socket.recv()
            assert isinstance(message, bytes)  # noqa: S101  the protocol says so
            header = json.loads(message[4 : 4 + int.from_bytes(message[:4], "big")])
            seen.pictures += [(picture["sequence"], 1e3 * time.time()) for picture in header["pictures"]]


async def _run(modbus_port: int, http_port: int, controllers: int, browsers: int, seconds: float) -> Seen:
    seen = Seen()
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(seconds), asyncio.TaskGroup() as tasks:
            for number in range(controllers):
                tasks.create_task(control(modbus_port, number, controllers, seen))
            for _ in range(browsers):
                for part in (stream, look, watch):
                    tasks.create_task(part(http_port, seen))
            await asyncio.Event().wait()
    return seen


def main() -> int:
    """Read, and print what came."""
    modbus_port, http_port, controllers, browsers = map(int, sys.argv[1:5])
    seen = asyncio.run(_run(modbus_port, http_port, controllers, browsers, float(sys.argv[5])))
    print(json.dumps(asdict(seen)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
