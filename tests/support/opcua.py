"""A unit's OPC UA server in the process of a test, its lines, and asyncua's client."""

import asyncio
import contextlib
import json
import os
import subprocess
from collections.abc import AsyncIterator
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path
from typing import Any

from asyncua import Client, ua
from asyncua.server.address_space import AttributeValue, NodeData

from altd.config import OpcUaSettings
from altd.history.history import History
from altd.instruments.beam.instrument import QUANTITIES
from altd.ports import Clock
from altd.publish.opcua.process import ServedUnit
from altd.publish.opcua.publisher import OpcUaPublisher
from altd.publish.opcua.quality import Status
from altd.publish.opcua.server import LimitedServer
from altd.publish.opcua.start import Start
from altd.records import Measurement, Quantities
from altd.runtime.clock import SystemClock
from altd.status.board import Board
from altd.status.health import Health
from altd.status.measurement_json import checked_line, with_proof
from altd.status.models import state_of
from altd.status.proof import Identity, Stamps
from altd.status.state import UnitState
from altd.status.target_area import TargetArea
from altd.status.unit import PublishedUnit, UnitFacts
from altd.tcp_port import listen
from support.foreign import need_npm, need_program
from support.places import ROOT
from tools.pages.example import MEASURED, SERIAL

STALE_AFTER_S = 1.0
AREAS = tuple(
    TargetArea(name, z_mm, ((-70.0, -55.0), (70.0, -55.0), (70.0, 55.0), (-70.0, 55.0)))
    for name, z_mm in (("front", 0.0), ("rear", 280.0))
)


@dataclass
class OpcUaUnit:
    """A board, its health, and the lines that the daemon makes of them."""

    clock: Clock = field(default_factory=SystemClock)
    settings: OpcUaSettings = field(default_factory=lambda: OpcUaSettings(host="127.0.0.1", port=0))
    history: History = field(default_factory=lambda: History(None, "there is none"))
    quantities: Quantities = QUANTITIES
    areas: tuple[TargetArea, ...] = AREAS
    rehearsal: bool = False
    stale_after_s: float = STALE_AFTER_S
    identity: Identity = field(default_factory=lambda: Identity.drawn(SERIAL))

    def __post_init__(self) -> None:
        about = self.quantities, self.identity
        self.board = Board(self.clock, self.stale_after_s, *about, rehearsal=self.rehearsal)
        self.health = Health(self.clock)
        facts, state = (
            UnitFacts(serial=SERIAL, version="0.1.0"),
            UnitState(self.board, self.health, self.clock),
        )
        self.published = PublishedUnit(self.board, self.health, facts, self.areas, state.read)
        self.component = self.health.component("opcua")
        self.publisher = OpcUaPublisher(self.settings, self.published, self.component, self.history)
        self.stamps = Stamps(self.board, "test")

    @property
    def start(self) -> Start:
        return Start.from_line(self.publisher._start().to_line())  # noqa: SLF001

    def measure(self, sequence: int = 160, of: Measurement = MEASURED, **changes: Any) -> None:
        """Put a measurement of half a second ago on the board."""
        now_ns = self.clock.monotonic_ns()
        now = {"t_ns": now_ns - 500_000_000, "last_exposure_ns": now_ns, "quantities": self.quantities}
        made = replace(of, sequence=sequence, **now)
        self.board.publish(replace(made, time=self.clock.utc(now_ns - 500_000_000), **changes))

    def line(self) -> bytes:
        """The current reading of the board."""
        measurement = self.board.read()
        assert measurement is not None
        return checked_line(self.board, measurement, self.stamps.next()).encode() + b"\n"

    def state_line(self) -> bytes:
        report = self.published.state()
        return with_proof(state_of(report).as_object(), self.board, self.stamps.next()).encode() + b"\n"

    @contextlib.asynccontextmanager
    async def served(self) -> AsyncIterator[ServedUnit]:
        """The server in this process; a test gives it its lines."""
        listener = listen("127.0.0.1", 0)
        self.publisher.port = listener.getsockname()[1]
        unit = ServedUnit(self.start, listener, self.clock.monotonic_ns)
        with _standard_nodes_kept():
            await unit.begin()
        try:
            yield unit
        finally:
            await unit.end()
            listener.close()

    @property
    def url(self) -> str:
        return f"opc.tcp://127.0.0.1:{self.publisher.port}/altd"


_kept: list[NodeData] = []


@contextlib.contextmanager
def _standard_nodes_kept() -> Any:
    """asyncua makes the standard's nodes again for each server, which takes a second."""
    load = LimitedServer.load_standard_address_space

    async def load_kept(server: LimitedServer, shelf_file: Path | None = None) -> None:
        if not _kept:
            await load(server, shelf_file)
            _kept.extend(_copied(server.aspace[node]) for node in server.aspace.keys())  # noqa: SIM118
        for node in _kept:
            server.aspace[node.nodeid] = _copied(node)

    LimitedServer.load_standard_address_space = load_kept  # type: ignore[method-assign]
    try:
        yield
    finally:
        LimitedServer.load_standard_address_space = load  # type: ignore[method-assign]


def _copied(node: NodeData) -> NodeData:
    copied = NodeData(node.nodeid)
    copied.attributes = {name: AttributeValue(known.value) for name, known in node.attributes.items()}
    copied.references = list(node.references)
    return copied


@contextlib.asynccontextmanager
async def connected(url: str, **session: Any) -> AsyncIterator[Client]:
    """asyncua's client with a session."""
    client = Client(url, timeout=200, watchdog_intervall=200)  # not lost while the machine is busy
    if "user" in session:
        client.set_user(session["user"])
        client.set_password(session["password"])
    if "security" in session:
        await client.set_security_string(session["security"])
    async with client:
        yield client


@dataclass(frozen=True)
class Written:
    """A value as a client gets it."""

    value: Any
    status: Status
    source: datetime | None


async def read(client: Client, *keys: str) -> dict[str, Written]:
    """Nodes of the unit, in one request."""
    nodes = [client.get_node(f"ns=2;s={key}") for key in keys]
    found = await client.read_attributes(nodes, ua.AttributeIds.Value)
    return {
        key: Written(data.Value.Value, Status(data.StatusCode.value), data.SourceTimestamp)
        for key, data in zip(keys, found, strict=True)
    }


async def by_node(url: str, **asked: Any) -> dict[str, Any]:
    """The answer of node-opcua; ``opcua_client.js`` has what may be asked."""
    node, keys = need_program("node", "nodejs"), need_npm("node-opcua-client") / "node_modules/.keys"
    process = await asyncio.create_subprocess_exec(
        *(node, ROOT / "tests/support/opcua_client.js", url, json.dumps(asked, default=str)),
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
        env=os.environ | {"XDG_CONFIG_HOME": str(keys)},
    )
    async with asyncio.timeout(90):
        out, err = await process.communicate()
    lines = out.decode().strip().splitlines()
    assert lines, err.decode()
    answer: dict[str, Any] = json.loads(lines[-1])
    return answer


async def read_by_node(port: int, *keys: str) -> dict[str, Any]:
    """The nodes that node-opcua reads of a daemon, once its server has started and has a measurement."""
    async with asyncio.timeout(400):  # a server that gives way starts late on a busy machine
        while True:
            answer = await by_node(f"opc.tcp://127.0.0.1:{port}/altd", keys=keys)
            found: dict[str, Any] = answer.get("read", {})
            if found and "BadWaitingForInitialData" not in {each["status"] for each in found.values()}:
                return found


def made_certificate(folder: Path, name: str, uri: str) -> tuple[Path, Path]:
    """A self-signed RSA certificate and its key, as docs/opcua.md makes them."""
    certificate, key = folder / f"{name}.pem", folder / f"{name}.key"
    line = [need_program("openssl"), "req", "-x509", "-newkey", "rsa:2048", "-noenc", "-days", "30"]
    line += ["-subj", f"/CN={name}", "-addext", f"subjectAltName=URI:{uri},IP:127.0.0.1"]
    line += ["-addext", "keyUsage=digitalSignature,nonRepudiation,keyEncipherment,dataEncipherment"]
    line += ["-addext", "extendedKeyUsage=serverAuth,clientAuth"]
    subprocess.run([*line, "-keyout", key, "-out", certificate], check=True, capture_output=True)
    key.chmod(0o600)
    return certificate, key
