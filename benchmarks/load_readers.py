"""``python -m benchmarks.load_readers``: all who read a unit, in a process of their own.

``read MODBUS HTTP CONTROLLERS BROWSERS SECONDS``: a controller polls over Modbus TCP 20 times a second. A
browser does over the network what the page does: the stream, the status twice a second, and pictures, the
next when it has the last. What it shows costs its own computer, so none is drawn here. Prints as JSON how
long each poll took, ms, which pictures came when (the frame's number, Unix time in ms), and what else came.

``show HTTP BROWSERS SECONDS``: the page in Chromium, so many times at once. Prints a line when all of them
show pictures; after so many seconds, as JSON, which pictures were shown when, and what all of Chromium took:
cores, MB.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import sys
import time
from dataclasses import asdict, dataclass, field

from websockets.asyncio.client import connect

from benchmarks.chromium import chromium, processes, until_pictures
from benchmarks.poller import ANSWER_BYTES, READ

_SIZE = 1280, 900

_NOTE = """(() => {
    const shown = globalThis.shownPictures = [];
    globalThis.WebSocket = class extends WebSocket {
        constructor(...given) {
            super(...given);
            this.addEventListener("message", message => { this.came = message.data; });
        }
        send(text) {
            super.send(text);
            if (!(this.came instanceof ArrayBuffer)) return;
            const length = new DataView(this.came).getUint32(0);
            const { pictures } = JSON.parse(new TextDecoder().decode(new Uint8Array(this.came, 4, length)));
            // the page asks for the next one before it paints this one, which is seen in the frame after
            requestAnimationFrame(() => requestAnimationFrame(() => {
                const now = performance.timeOrigin + performance.now();
                for (const { sequence } of pictures) shown.push([sequence, now]);
            }));
        }
    };
})()"""


@dataclass(frozen=True, slots=True)
class Shown:
    """What all pages showed, and what their browser took meanwhile."""

    pictures: list[tuple[int, float]]
    cores: float
    memory_mb: float


async def _show(port: int, browsers: int, seconds: float) -> Shown:
    async with chromium() as browser:
        session = await browser.new_browser_cdp_session()
        pages = []
        for _ in range(browsers):
            page = await browser.new_page(viewport={"width": _SIZE[0], "height": _SIZE[1]})
            await page.add_init_script(_NOTE)
            await page.goto(f"http://127.0.0.1:{port}/")
            pages.append(page)
        for page in pages:
            await until_pictures(page)
            await page.evaluate("() => { shownPictures.length = 0; }")
        print("all show pictures", flush=True)
        begun_s, cpu_s = time.monotonic(), sum(each.cpu_s for each in await processes(session))
        await asyncio.sleep(seconds)
        alive = await processes(session)
        cores = (sum(each.cpu_s for each in alive) - cpu_s) / (time.monotonic() - begun_s)
        memory_mb = sum(each.pss_mb() for each in alive)
        pictures = [each for page in pages for each in await page.evaluate("() => shownPictures")]
    return Shown(pictures, cores, memory_mb)


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
    """Read or show, and print what came."""
    numbers, seconds = [int(number) for number in sys.argv[2:-1]], float(sys.argv[-1])
    if sys.argv[1] == "show":
        # Browsers run on computers of their own. Here they run in the idle class, so that they do not
        # slow down the daemon; as root Chromium would even run before all others.
        os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
        print(json.dumps(asdict(asyncio.run(_show(numbers[0], numbers[1], seconds)))))
    else:
        modbus_port, http_port, controllers, browsers = numbers
        print(json.dumps(asdict(asyncio.run(_run(modbus_port, http_port, controllers, browsers, seconds)))))
    return 0


if __name__ == "__main__":
    sys.exit(main())
