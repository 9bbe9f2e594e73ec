"""Browsers that never read and crowds that connect at once: they cost the daemon no exposure and no poll."""

import asyncio
import contextlib
import io
import json
import tarfile
import time
from collections.abc import AsyncIterator
from dataclasses import dataclass, replace

import numpy as np
import pytest
import pytest_asyncio
from support.greedy_clients import EMPTY_PING, HANDSHAKE, NEXT, crowd, get, polled, watched_machine
from support.led_unit import LedUnit, config, led_unit
from support.made_history import make_history
from support.ports import free_port
from websockets.asyncio.client import connect

from altd.app.keeping import FILE_NAME, history_about
from altd.config import HttpSettings, KeptFrames, ModbusTcpSettings
from altd.measuring.calibration import Calibration
from altd.publish.http.pictures import MAX_VIEWERS
from altd.publish.http.server import MAX_CONNECTIONS
from altd.records import Frame
from benchmarks.process_memory import resident_mb
from hw_sim.beam import BeamPose
from hw_sim.unit import CAMERAS, FRONT

pytestmark = [pytest.mark.alone, pytest.mark.asyncio(loop_scope="module")]

LONG_S = 2.0
"""Buffers are full, and all places taken, in the first second of it; no time-out of the server ends in it."""
PERIOD_S = 0.05
CROWD = 200
NOISE_OFFSETS = 100_003
MAX_GROWTH_MB = 60.0
POSE = BeamPose(x_mm=12.0, y_mm=-7.0, slope_x=0.026, slope_y=-0.035)
ALL = "/api/v1/trend?from=-86400&points=1000"


@dataclass
class Unit:
    running: LedUnit
    http: int
    modbus: int
    began_mb: float

    @property
    def counted(self) -> dict[str, int]:
        """The losses on the way from the exposures to the board."""
        counters = self.running.daemon.health.component("measuring").counters
        lost = {
            name: count for name, count in counters.items() if name.startswith("dropped") or "late" in name
        }
        return {**lost, "without a value": counters["measurements"] - counters["valid"]}

    @property
    def refused(self) -> int:
        """Connections that were closed at once."""
        (faces,) = (each for each in self.running.daemon.health if each.name.startswith("http "))
        return faces.counters.get("connections_refused", 0)

    async def ask(self, path: str) -> tuple[int, bytes]:
        """Status and body; a status of 0: the connection was closed unanswered."""
        async with asyncio.timeout(10):
            reader, writer = await asyncio.open_connection("127.0.0.1", self.http)
            try:
                writer.write(get(path).replace(b"1.1", b"1.0"))
                head, _, body = (await reader.read()).partition(b"\r\n\r\n")
            except ConnectionError:
                return 0, b""
            finally:
                writer.close()
        return int(head[9:12] or b"0"), body

    async def answers(self, path: str) -> bytes:
        """Ask until it is answered: places become free when the unit notices that their clients have left."""
        async with asyncio.timeout(10):
            while True:
                status, body = await self.ask(path)
                if status == 200:
                    return body
                await asyncio.sleep(0.1)


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def unit(
    calibration_of_unit_3: Calibration, tmp_path_factory: pytest.TempPathFactory
) -> AsyncIterator[Unit]:
    """With a day of history and a recording, so that there is much to be asked for; one for all tests."""
    folder = tmp_path_factory.mktemp("unit")
    make_history(folder / FILE_NAME, int(time.time()) // 3600 * 3600, days=1, unit="SIM-3")
    http, modbus = free_port(), free_port()
    settings = config(measuring={"window": 4}).model_copy(
        update={
            "http": HttpSettings(host="127.0.0.1", port=http, names=("unit",)),
            "modbus_tcp": ModbusTcpSettings(host="127.0.0.1", port=modbus),
            "kept_frames": KeptFrames(before_s=2, after_s=1, memory_mb=40, folder=folder / "kept"),
        }
    )

    def keep(running: LedUnit) -> None:
        about = history_about(settings, calibration_of_unit_3, running.daemon.board.quantities)
        running.daemon.past.keep_in(folder / FILE_NAME, 400 * 10**6, about)

    async with led_unit(calibration_of_unit_3, settings, keep) as running:
        running.unit.place(POSE)
        await running.measured(valid=True)
        simplify_cameras(running)
        await asyncio.sleep(2.5)
        await running.daemon.unit.recordings.provider.keep("for a test")
        await running.measured(valid=True)
        yield Unit(running, http, modbus, resident_mb())


def simplify_cameras(running: LedUnit) -> None:
    """Let the cameras vary one exposure each by noise of a count: the interpreter is the daemon's alone."""
    made = {camera: running.seen.expose(camera, 0, 0) for camera in CAMERAS}
    shape = made[FRONT].pixels.shape
    noise = np.random.default_rng(5).integers(0, 2, shape[0] * shape[1] + NOISE_OFFSETS, np.uint8)

    def expose(camera: str, sequence: int, t_ns: int) -> Frame:
        of, first = made[camera], sequence * 7919 % NOISE_OFFSETS
        pixels = of.pixels + noise[first:][: of.pixels.size].reshape(shape)
        return replace(of, sequence=sequence, t_ns=t_ns, pixels=pixels)

    running.seen.expose = expose


@contextlib.asynccontextmanager
async def harmless(unit: Unit) -> AsyncIterator[None]:
    """Within, no exposure is lost, every poll is answered by a valid measurement, and memory is bounded.

    What a stall of the machine may have taken from any program does not count.
    """
    await asyncio.sleep(0.5)  # lets the counters state what the end of the test before took from the loop
    before = unit.counted
    with watched_machine() as stalls:
        async with polled(unit.modbus) as poller:
            yield
    lost = {name: count - before[name] for name, count in unit.counted.items()}
    stalled = stalls.periods(PERIOD_S)
    assert max(lost.values()) <= stalled, (lost, stalls)
    assert len(poller.answers) > LONG_S / 0.2
    assert sum(not status & 1 for status, _ in poller.answers) <= stalled, (poller.answers, stalls)
    numbers = [number for _, number in poller.answers]
    assert numbers == sorted(numbers), "an older measurement came after a newer one"
    assert resident_mb() - unit.began_mb < MAX_GROWTH_MB, "of all that came so far"


async def served_well(unit: Unit) -> None:
    """A browser gets all that there is."""
    assert json.loads(await unit.answers("/api/v1/measurement"))["valid"] is True
    assert len(json.loads(await unit.answers(ALL))["t_s"]) > 600
    name = json.loads(await unit.answers("/api/v1/recordings"))["recordings"][0]["name"]
    with tarfile.open(fileobj=io.BytesIO(await unit.answers(f"/api/v1/recordings/{name}"))) as archive:
        assert f"{name}/recording.json" in archive.getnames()
    async with asyncio.timeout(20):
        while True:
            async with connect(f"ws://127.0.0.1:{unit.http}/api/v1/pictures", compression=None) as browser:
                with contextlib.suppress(ConnectionError):
                    await browser.recv()
                    await browser.send("next")
                    assert len(await browser.recv()) > 5000
                    return


@pytest.mark.parametrize("wish", ["pictures", "stream", "recording", "trend"])
async def test_browsers_that_never_read_harm_nobody(unit: Unit, wish: str) -> None:
    name = json.loads(await unit.answers("/api/v1/recordings"))["recordings"][0]["name"]
    asks = {
        "pictures": [HANDSHAKE, NEXT * 50],
        "stream": [get("/api/v1/stream")],
        "recording": [get(f"/api/v1/recordings/{name}")],
        "trend": [get(ALL)],
    }[wish]
    async with harmless(unit), crowd(unit.http, MAX_VIEWERS - 1, *asks):
        assert (await unit.ask("/api/v1/measurement"))[0] == 200
        await asyncio.sleep(LONG_S)
    await served_well(unit)


@pytest.mark.parametrize(
    ("opening", "more"),
    [
        (HANDSHAKE, EMPTY_PING * 10_000),
        (HANDSHAKE, b"\x01\x80\x00\x00\x00\x00" + b"\x00\x80\x00\x00\x00\x00" * 10_000),
        (
            get("/api/v1/stream").replace(b"\r\n\r\n", b"\r\nTransfer-Encoding: chunked\r\n\r\n"),
            b"1\r\nx\r\n" * 10_000,
        ),
    ],
    ids=["pings", "fragments", "chunks"],
)
async def test_who_sends_without_end_and_never_reads_harms_nobody(
    unit: Unit, opening: bytes, more: bytes
) -> None:
    async with harmless(unit), crowd(unit.http, 5, opening, more=more):
        await asyncio.sleep(LONG_S)
    await served_well(unit)


@pytest.mark.parametrize(
    "opening", [b"", b"GET / HTTP/1.1\r\nHost: un", HANDSHAKE], ids=["silent", "half", "websocket"]
)
async def test_200_that_connect_at_once_and_stay_harm_nobody(unit: Unit, opening: bytes) -> None:
    before = unit.refused
    async with harmless(unit), crowd(unit.http, CROWD, opening):
        await asyncio.sleep(LONG_S)
    assert unit.refused - before >= CROWD - MAX_CONNECTIONS
    await served_well(unit)
