"""Read all that the interfaces send of a unit, as text: over their own sockets and lines."""

import asyncio
import contextlib
import gc
import io
import json
import random
import sqlite3
import struct
import zipfile
from collections.abc import AsyncIterator, Callable, Iterator
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from asyncua import ua

from altd.config import (
    HttpSettings,
    ModbusRtuPortSettings,
    ModbusTcpSettings,
    MqttSettings,
    TelegramPortSettings,
)
from altd.files.documents import line_of
from altd.publish.http.publisher import HttpPublisher, LocalPublisher
from altd.publish.modbus.rtu import ModbusRtuPublisher
from altd.publish.modbus.tcp import ModbusTcpPublisher
from altd.publish.mqtt.edge_node import EdgeNodePublisher
from altd.publish.mqtt.publisher import MqttPublisher
from altd.publish.opcua.live import LiveUnit
from altd.publish.opcua.process import ServedUnit
from altd.publish.opcua.quality import Status
from altd.publish.serial.commands import COMMANDS
from altd.publish.serial.console import Console
from altd.publish.serial.plate_and_row import sentences_of
from altd.publish.serial.publisher import TelegramPublisher
from altd.status.measurement_json import as_object
from altd.status.state import TICK_S
from altd.tables import flat_row, measurement_columns, table_in
from altd.terminal.canvas import Canvas
from altd.terminal.documents import SelfCheckDocument, StatusDocument, TargetsDocument, checked, reading_of
from altd.terminal.knowledge import Knowledge
from altd.terminal.screen import PAGES, ScreenView, draw
from support.cli import altd_here
from support.golden_cases import Case, GoldenUnit
from support.modbus_rtu_wire import frame
from support.mqtt import ChosenBroker, Published
from support.serving import lines, serving
from support.wire import Wire
from tools.pages.example import NAMEPLATE

LOCAL: dict[str, Any] = {"host": "127.0.0.1", "port": 0}
REGISTERS = {"measurement": (0, 120), "checked": (200, 80), "unit": (300, 50), "condition": (400, 60)} | {
    "relative": (500, 30), "near": (600, 106), "far": (720, 106)
}  # fmt: skip
MODBUS = {name: struct.pack(">BHH", 3, *place) for name, place in REGISTERS.items()} | {
    "input": struct.pack(">BHH", 4, 0, 120),
    "discrete": struct.pack(">BHH", 2, 0, 7),
    "identification": bytes([43, 14, 3, 0]),
    "beyond": struct.pack(">BHH", 3, 110, 20),
}
NO_TIME = datetime(2026, 1, 1, tzinfo=UTC)
Parts = AsyncIterator[tuple[str, str]]


@dataclass
class Bench:
    folder: Path
    stack: contextlib.AsyncExitStack
    servers: dict[str, tuple[ServedUnit, str]] = field(default_factory=dict)
    paths: list[str] = field(default_factory=list)
    seen: set[tuple[str, str]] = field(default_factory=set)

    def is_first(self, unit: GoldenUnit, interface: str) -> bool:
        """Whether no unit of this kind was seen before: what each unit of it sends is read of one."""
        before = len(self.seen)
        self.seen.add((interface, f"{unit.serial} {unit.quantities}"))
        return len(self.seen) > before

    async def paths_at(self, port: int) -> list[str]:
        """The paths that the OpenAPI document names, without those of one recording."""
        if not self.paths:
            described = json.loads((await got("/api/v1/openapi.json", port))[1])["paths"]
            self.paths += [
                each for each, methods in described.items() if "get" in methods and "{" not in each
            ]
        return self.paths


def hexadecimal(data: bytes) -> str:
    rows = (data[first : first + 16] for first in range(0, len(data), 16))
    return "\n".join(f"{16 * place:04x}: {row.hex(' ', 2)}" for place, row in enumerate(rows))


async def modbus(unit: GoldenUnit, bench: Bench) -> Parts:
    component, settings = unit.health.component("modbus_tcp"), ModbusTcpSettings(**LOCAL)
    tcp = ModbusTcpPublisher(settings, unit.published, component)
    async with serving(tcp):
        reader, writer = await asyncio.open_connection("127.0.0.1", tcp.port)
        for name, request in MODBUS.items():
            if name == "input" and not bench.is_first(unit, "modbus"):
                continue  # the same registers as "measurement"
            writer.write(struct.pack(">HHHB", 7, 0, 1 + len(request), 1) + request)
            head = await reader.readexactly(6)
            yield f"tcp {name}", hexadecimal(head + await reader.readexactly(head[5]))
        writer.transport.abort()
    with laid() as wire:
        line = ModbusRtuPortSettings(device=wire.device, speaks="modbus_rtu", baud=115200, word_order="CDAB")
        async with serving(ModbusRtuPublisher(line, unit.published, unit.health.component("serial a"))):
            for name, request in (("checked", MODBUS["checked"]), ("server id", b"\x11")):
                wire.send(frame(request, 1))
                answer = await wire.receive(lambda data: len(data) > 2 and len(data) == 5 + data[2])
                yield f"rtu {name}", hexadecimal(answer)


@contextlib.contextmanager
def laid() -> Iterator[Wire]:
    wire = Wire.laid()
    try:
        yield wire
    finally:
        wire.hang_up()


async def telegram(unit: GoldenUnit, bench: Bench) -> Parts:
    about = replace(NAMEPLATE, unit=unit.identity.unit, serial=unit.serial)
    is_beam = unit.quantities.instrument == "beam"
    checked = {"checked": True, "sigma_now": is_beam, "identify_every_s": 60.0}
    plain = sentences_of(unit.quantities.instrument, len(unit.areas))
    for name, sentences, settings in (("plain", plain, {}), ("checked", plain + 2 + is_beam, checked)):
        with laid() as wire:
            port = TelegramPortSettings(device=wire.device, speaks="telegram", baud=115200, **settings)
            component = unit.health.component(f"serial {name}")
            async with serving(TelegramPublisher(port, unit.board, component, unit.clock, about)):
                sent = await wire.receive(lines(1 + sentences))
                yield name, sent.decode("ascii")


async def console(unit: GoldenUnit, bench: Bench) -> Parts:
    shown = Console(unit.published, unit.past)
    yield "welcome", shown.welcome().decode("ascii")
    further = ("history day", "history month", "watch 0.5", "watch 0", "status x")
    for line in (*COMMANDS, "status all", *(further if bench.is_first(unit, "console") else ())):
        said = shown.feed(f"{line}\r".encode())
        while shown.is_finding:
            said += await shown.found()
        while said.endswith(b"--"):
            said += shown.feed(b" ")
        yield line, (said + shown.tick() + (shown.feed(b"x\b") if shown.watching_s else b"")).decode("ascii")


async def got(path: str, port: int = 0, socket: Path | None = None) -> tuple[str, bytes]:
    """The head of an answer, without what differs each time, and its body; of a stream one event."""
    opened = (
        asyncio.open_connection("127.0.0.1", port) if socket is None else asyncio.open_unix_connection(socket)
    )
    reader, writer = await opened
    writer.write(f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n".encode())
    head = (await reader.readuntil(b"\r\n\r\n")).decode()
    is_stream = "text/event-stream" in head
    body = await (reader.readuntil(b"\n\n") if is_stream else reader.read())
    writer.transport.abort()
    return "\n".join(
        each for each in head.strip().split("\r\n") if not each.startswith(("date: ", "content-length: "))
    ), body


async def http(unit: GoldenUnit, bench: Bench) -> Parts:
    publisher = HttpPublisher(
        HttpSettings(**LOCAL),
        unit.published,
        unit.health.component("http"),
        unit.history,
        unit.health.events,
    )
    async with serving(publisher):
        is_first, paths = bench.is_first(unit, "http"), await bench.paths_at(publisher.port)
        for path in paths:
            if ("stream" in path and unit.board.read() is None) or (path in OF_EACH_UNIT and not is_first):
                continue  # a stream sends nothing yet
            head, body = await got(path, publisher.port)
            yield (
                path.removeprefix("/api/v1") or path,
                f"{head}\n\n{text_of(body)}".replace(f"port {publisher.port}", "port PORT"),
            )


OF_EACH_UNIT = {
    "/",
    "/healthz",
    *(f"/api/v1/{name}" for name in ("", "openapi.json", "session", "recordings")),
}
OF_EACH_UNIT |= {f"/api/v1/{name}" for name in ("calibration/file", "calibration/report", "diagnostics")}


def text_of(body: bytes) -> str:
    if body.startswith(b"<!"):  # the page's own files are no bytes of a measurement
        return "\n".join(line for line in body.decode().splitlines() if '"key"' in line)
    if not body.startswith(b"PK"):
        return body.decode()
    with zipfile.ZipFile(io.BytesIO(body)) as archive:
        return "\n".join(f"== {name}\n{archive.read(name).decode()}" for name in archive.namelist())


async def local(unit: GoldenUnit, bench: Bench) -> Parts:
    path = bench.folder / "socket"
    async with serving(LocalPublisher(path, unit.published, unit.health.component("local"), unit.history)):
        for arguments in [("status",), ("status", "--json")][: 1 + bench.is_first(unit, "local")]:
            said = await asyncio.to_thread(altd_here, *arguments, "--socket", path)
            yield "altd " + " ".join(arguments), f"{said.status}\n{said.out}{said.err}"
        names = ("self-check", "targets", "measurement", "status")
        documents = {name: json.loads((await got(f"/api/v1/{name}", socket=path))[1]) for name in names}
    knowledge, check = Knowledge(), checked(SelfCheckDocument, documents["self-check"])
    knowledge.set_documents(check, checked(TargetsDocument, documents["targets"]))
    try:
        reading = reading_of(documents["measurement"], unit.quantities)
    except ValueError as error:
        yield "altd watch", str(error)
        return
    for second in range(2):
        knowledge.set_reading(reading, float(second))
    knowledge.set_status(checked(StatusDocument, documents["status"]), 1.0)
    for page, (name, _) in enumerate(PAGES):
        canvas = Canvas(24, 80, is_utf8=bool(page % 2))
        draw(knowledge, 1.2, ScreenView(page), canvas)
        yield f"altd watch, {name}", canvas.text()


async def mqtt(unit: GoldenUnit, bench: Bench) -> Parts:
    """At a broker: a second of JSON, a measurement in JSON, a second of Sparkplug."""
    for name, kind, settings in (
        ("summary", MqttPublisher, {"home_assistant": "homeassistant"}),
        ("measurement", MqttPublisher, {"every_measurement": True}),
        ("NDATA", EdgeNodePublisher, {"sparkplug": {"group": "plant"}}),
    ):
        if (shown := unit.board.read()) is None and name == "measurement":
            continue
        async with ChosenBroker() as broker:
            chosen = MqttSettings.model_validate({"host": "127.0.0.1", "port": broker.port} | settings)
            made: Any = kind(chosen, unit.published, unit.health.component("mqtt"), random.Random(1))
            async with serving(made), asyncio.timeout(60):
                sent: list[Published] = []
                if name != "measurement":
                    await unit.clock.advance(0.5)  # type: ignore[attr-defined]
                    unit.live(TICK_S, shown)
                    await unit.clock.advance(1.0 - 0.5 - TICK_S)  # type: ignore[attr-defined]
                if name == "NDATA":  # one ping after its birth, and one a second
                    await broker.pings.get(), await broker.pings.get()
                while not (name == "NDATA" or (sent and name in sent[-1].topic)):
                    sent.append(await broker.published.get())
            await asyncio.wait_for(broker.ends.get(), 60)
            sent += [broker.published.get_nowait() for _ in range(broker.published.qsize())]
        if name != "measurement":  # the others are as before a summary
            yield f"CONNECT for {name}", hexadecimal(broker.connects[0])
        for number, each in enumerate(sent if name != "measurement" else sent[-2:-1]):
            about = f"qos {each.qos}, retain {each.retain}, expiry {each.expiry_s} s"
            content = hexadecimal(each.data) if name == "NDATA" else each.payload
            yield f"{name} {number} {each.topic.rpartition('/')[2]}", f"{each.topic}\n{about}\n{content}"


async def opcua(unit: GoldenUnit, bench: Bench) -> Parts:
    """By the lines that the daemon sends its server. A server of each kind of unit is made once."""
    start = unit.start
    kind = str(replace(start, port=0, history=None))
    if kind not in bench.servers:
        server = await bench.stack.enter_async_context(unit.served())
        bench.servers[kind] = server, _space_of(server)
        gc.freeze()  # its 60,000 objects stay for the test: to look for garbage in them takes seconds
    (server, space), clock = bench.servers[kind], unit.clock
    live = LiveUnit(server.nodes, start, clock.monotonic_ns, lambda: clock.utc(clock.monotonic_ns()))  # type: ignore[return-value, arg-type]
    for key in server.nodes.keys:
        await server.nodes.write(key, None, Status.BAD_WAITING_FOR_INITIAL_DATA, None, NO_TIME)
    if bench.is_first(unit, "opcua"):
        yield "nodes", space
    if unit.board.read() is not None:
        await live.take(unit.line())
    await live.take(unit.state_line())
    yield "values", await _values_of(server)
    unit.live(1.5)
    await live.withdraw_stale()
    yield "values 1.5 s later", await _values_of(server)


def _space_of(server: ServedUnit) -> str:
    space, lines = server.server.iserver.aspace, list[str]()
    for node in sorted((each for each in space.keys() if each.NamespaceIndex == 2), key=str):  # noqa: SIM118
        is_live = node.Identifier in server.nodes.keys
        for name, known in sorted(space[node].attributes.items()):
            if known.value is not None and not (is_live and name is ua.AttributeIds.Value):
                lines.append(f"{node.Identifier} {name.name} {known.value.Value}")
    return "\n".join(lines)


async def _values_of(server: ServedUnit) -> str:
    lines = []
    for key in sorted(server.nodes.keys):
        data = await server.server.get_node(f"ns=2;s={key}").read_data_value(raise_on_bad_status=False)
        lines.append(
            f"{key}: {data.Value.Value!r} {Status(data.StatusCode.value).name} {data.SourceTimestamp}"
        )
    return "\n".join(lines)


async def tables(unit: GoldenUnit, bench: Bench) -> Parts:
    if (shown := unit.board.read()) is not None:
        document, targets, path = as_object(shown), list(shown.targets), bench.folder / "table.csv"
        yield "replay.jsonl", line_of(document)
        with table_in(path, "csv", measurement_columns(unit.quantities, targets, of_scan=False), {}) as add:
            add(flat_row(document))
        yield "replay.csv", path.read_text()
    assert unit.history.path is not None
    with contextlib.closing(sqlite3.connect(unit.history.path)) as store:
        names = [
            name
            for (name,) in store.execute(
                "SELECT name FROM sqlite_master WHERE type = 'table' AND name != 'facts'"
            )
        ]
        yield (
            "history",
            "\n".join(f"{name} {row}" for name in names for row in store.execute(f"SELECT * FROM {name}")),
        )


INTERFACES: dict[str, Callable[[GoldenUnit, Bench], Parts]] = {
    each.__name__: each for each in (modbus, telegram, console, http, local, mqtt, opcua, tables)
}


async def bytes_of(case: Case, bench: Bench) -> dict[str, str]:
    """All that the interfaces send of a case, by the name of the interface and of the part."""
    path = bench.folder / "history.db"
    case.record(path)
    found = {}
    for name, interface in INTERFACES.items():
        unit = case.made(path)
        async with contextlib.aclosing(interface(unit, bench)) as parts:  # type: ignore[type-var]
            async for part, text in parts:
                found[f"{name}: {part}"] = text.replace(str(bench.folder), "FOLDER")
        await unit.history.end()
    for each in bench.folder.glob("history.db*"):
        each.unlink()
    return found
