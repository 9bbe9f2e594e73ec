"""``python -m benchmarks.load_readers KIND PLACE...``: clients of one kind in a process, one for each place.

``modbus_tcp`` and ``modbus_rtu`` poll 20 times a second, at a TCP port or at a descriptor of a serial line;
``mqtt`` subscribes to every measurement at a broker's port, ``opcua`` to ``x_mm`` each 50 ms. ``browser`` has
the network traffic of the page: the stream, the status twice a second, and pictures, each requested when the
last has arrived; it draws none, because drawing loads the client's computer. ``chromium`` shows the page
itself.

It prints a line when all clients read and, when its standard input ends, the figures since then, as JSON. The
process runs in the idle scheduling class: clients have their own computers and must not take the daemon's
time.
"""

import asyncio
import json
import logging
import os
import struct
import sys
import time
from collections.abc import Awaitable, Callable, Coroutine
from dataclasses import asdict, dataclass, field
from datetime import datetime
from typing import Any

import aiomqtt
from asyncua import Client
from websockets.asyncio.client import connect

from benchmarks.chromium import chromium, processes, until_pictures
from benchmarks.poller import ANSWER_BYTES, READ
from hw_sim.inclinometer import crc

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


READING = "all read"
"""Line that is printed when all clients read."""
_HOST = "127.0.0.1"
_POLLS_PER_S = 20.0
_STATUS_INTERVAL_S = 0.5
_OPCUA_INTERVAL_MS = 50.0
_SETTLE_S = 1.0


@dataclass
class Seen:
    """Figures of all clients of a process. Without ``chromium`` the cost stays 0."""

    answers_ms: list[float] = field(default_factory=list)
    """Time from each request to its answer."""
    ages_ms: list[tuple[float, float]] = field(default_factory=list)
    """Age of each message at arrival, and its excess over the stated age."""
    pictures: list[tuple[int, float]] = field(default_factory=list)
    """Numbers of the frames, and when they arrived or were drawn, Unix time in ms."""
    cores: float = 0.0
    memory_mb: float = 0.0
    """Memory of all processes of Chromium at the end; ``cores`` is their CPU."""

    def note_age(self, captured_ms: float, age_ms: float) -> None:
        """Record a message with this capture time, Unix time in ms, and this age, both rounded to 1 ms."""
        arrived_ms = 1e3 * time.time() - captured_ms
        self.ages_ms.append((arrived_ms, arrived_ms - age_ms))

    def note_registers(self, registers: bytes) -> None:
        """Record a Modbus answer from address 0: age at 6, UTC at 10, its milliseconds at 12."""
        age_ms, utc_s, utc_ms = struct.unpack_from(">H6xIH", registers, 12)
        self.note_age(1e3 * utc_s + utc_ms, age_ms)

    def note_json(self, line: bytes) -> None:
        """Record a measurement in JSON."""
        told = json.loads(line)
        self.note_age(1e3 * datetime.fromisoformat(told["time"]).timestamp(), 1e3 * told["age_s"])


async def _show(ports: list[int]) -> Seen:
    async with chromium() as browser:
        session = await browser.new_browser_cdp_session()
        pages = []
        for port in ports:
            page = await browser.new_page(viewport={"width": _SIZE[0], "height": _SIZE[1]})
            await page.add_init_script(_NOTE)
            await page.goto(f"http://127.0.0.1:{port}/")
            pages.append(page)
        for page in pages:
            await until_pictures(page)
            await page.evaluate("() => { shownPictures.length = 0; }")
        print(READING, flush=True)
        begun_s, cpu_s = time.monotonic(), sum(each.cpu_s for each in await processes(session))
        await asyncio.to_thread(sys.stdin.read)
        alive = await processes(session)
        cores = (sum(each.cpu_s for each in alive) - cpu_s) / (time.monotonic() - begun_s)
        memory_mb = sum(each.pss_mb() for each in alive)
        pictures = [each for page in pages for each in await page.evaluate("() => shownPictures")]
    return Seen(pictures=pictures, cores=cores, memory_mb=memory_mb)


async def _poll(ask: Callable[[], Awaitable[bytes]], first_s: float, seen: Seen) -> None:
    """Poll until cancelled; ``ask`` returns the registers, ``first_s`` spreads clients over a period."""
    due_s = time.monotonic() + first_s
    while True:
        await asyncio.sleep(max(due_s - time.monotonic(), 0.0))
        due_s += 1 / _POLLS_PER_S
        begun_ns = time.monotonic_ns()
        registers = await ask()
        seen.answers_ms.append((time.monotonic_ns() - begun_ns) * 1e-6)
        seen.note_registers(registers)


async def modbus_tcp(port: int, first_s: float, seen: Seen) -> None:
    """Poll over Modbus TCP."""
    reader, writer = await asyncio.open_connection(_HOST, port)

    async def ask() -> bytes:
        writer.write(READ)
        answer = await reader.readexactly(ANSWER_BYTES)
        if answer[7] != 4:
            raise ConnectionError(answer.hex())
        return answer[9:]

    await _poll(ask, first_s, seen)


async def modbus_rtu(descriptor: int, first_s: float, seen: Seen) -> None:
    """Poll over Modbus RTU; a pseudo terminal transfers bytes at once, regardless of its baud rate."""
    reader = asyncio.StreamReader()
    pipe = os.fdopen(descriptor, "rb", buffering=0, closefd=False)
    await asyncio.get_running_loop().connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), pipe)
    request = b"\1" + READ[7:]

    async def ask() -> bytes:
        os.write(descriptor, request + crc(request))
        answer = await reader.readexactly(ANSWER_BYTES - 4)
        if answer[1] != 4 or crc(answer[:-2]) != answer[-2:]:
            raise ConnectionError(answer.hex())
        return answer[3:-2]

    await _poll(ask, first_s, seen)


async def mqtt(port: int, _: float, seen: Seen) -> None:
    """Receive every measurement from a broker."""
    async with aiomqtt.Client(_HOST, port, protocol=aiomqtt.ProtocolVersion.V5) as client:
        await client.subscribe("altd/+/measurement", qos=1)
        async for message in client.messages:
            assert isinstance(message.payload, bytes)  # noqa: S101  MQTT knows no other payload
            seen.note_json(message.payload)


async def browser(port: int, _: float, seen: Seen) -> None:
    """Read as a browser that shows the page."""
    async with asyncio.TaskGroup() as tasks:
        for part in (_stream, _status, _pictures):
            tasks.create_task(part(port, seen))


async def _stream(port: int, seen: Seen) -> None:
    reader, writer = await asyncio.open_connection(_HOST, port)
    writer.write(b"GET /api/v1/stream HTTP/1.1\r\nHost: localhost\r\n\r\n")
    while line := await reader.readline():
        if line.startswith(b"data: "):
            seen.note_json(line[6:])


async def _status(port: int, _: Seen) -> None:
    while True:
        reader, writer = await asyncio.open_connection(_HOST, port)
        writer.write(b"GET /api/v1/status HTTP/1.1\r\nHost: localhost\r\n\r\n")
        answer = await reader.read(-1)
        writer.close()
        if not answer.startswith(b"HTTP/1.1 200"):
            raise ConnectionError(answer[:80])
        await asyncio.sleep(_STATUS_INTERVAL_S)


async def _pictures(port: int, seen: Seen) -> None:
    async with connect(f"ws://{_HOST}:{port}/api/v1/pictures", compression=None, max_size=None) as socket:
        await socket.recv()
        while True:
            await socket.send("next")
            message = await socket.recv()
            assert isinstance(message, bytes)  # noqa: S101  by the protocol
            header = json.loads(message[4 : 4 + int.from_bytes(message[:4], "big")])
            seen.pictures += [(picture["sequence"], 1e3 * time.time()) for picture in header["pictures"]]


class _Changes:
    """Records the age of each change of a variable; a server also states its time of sending."""

    def __init__(self, seen: Seen) -> None:
        self._seen = seen

    def datachange_notification(self, _node: Any, _value: Any, data: Any) -> None:
        """Handle a change; called by asyncua."""
        found = data.monitored_item.Value
        captured_ms = 1e3 * found.SourceTimestamp.timestamp()
        self._seen.note_age(captured_ms, 1e3 * found.ServerTimestamp.timestamp() - captured_ms)


async def opcua(port: int, _: float, seen: Seen) -> None:
    """Subscribe to a number."""
    logging.getLogger("asyncua").setLevel(logging.ERROR)  # asyncua requests longer lifetimes than granted
    async with Client(f"opc.tcp://{_HOST}:{port}/altd") as client:
        namespace = await client.get_namespace_index("urn:altd:unit")
        (unit,) = [
            node
            for node in await client.nodes.objects.get_children()
            if (await node.read_browse_name()).NamespaceIndex == namespace
        ]
        subscription = await client.create_subscription(_OPCUA_INTERVAL_MS, _Changes(seen))
        await subscription.subscribe_data_change(await unit.get_child(f"{namespace}:x_mm"))
        await asyncio.Event().wait()


KINDS: dict[str, Callable[[int, float, Seen], Coroutine[Any, Any, None]]] = {
    "modbus_tcp": modbus_tcp,
    "modbus_rtu": modbus_rtu,
    "mqtt": mqtt,
    "opcua": opcua,
    "browser": browser,
}


async def _read(kind: str, places: list[int]) -> Seen:
    seen = Seen()
    async with asyncio.TaskGroup() as tasks:
        clients = [
            tasks.create_task(KINDS[kind](place, number / len(places) / _POLLS_PER_S, seen))
            for number, place in enumerate(places)
        ]
        await asyncio.sleep(_SETTLE_S)
        seen.answers_ms.clear()
        seen.ages_ms.clear()
        seen.pictures.clear()
        print(READING, flush=True)
        await asyncio.to_thread(sys.stdin.read)
        for client in clients:
            client.cancel()
    return seen


def main() -> int:
    """Read, and print the figures."""
    os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
    kind, places = sys.argv[1], [int(place) for place in sys.argv[2:]]
    print(json.dumps(asdict(asyncio.run(_show(places) if kind == "chromium" else _read(kind, places)))))
    return 0


if __name__ == "__main__":
    sys.exit(main())
