"""The real daemon on cameras that deliver from memory: CPU, latency and losses."""

import asyncio
import contextlib
import json
import os
import subprocess
import time
from collections.abc import AsyncIterator, Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from altd.app.daemon import Daemon
from altd.config import Config
from altd.errors import unwrap_group
from altd.records import FloatArray
from benchmarks.harness import child, reporter
from benchmarks.interfaces import broker, interfaces
from benchmarks.material import CAMERAS, FPS, WINDOW, Material, Source, make_config
from benchmarks.stages import pure_rate

SETTLE_S = 1.2
"""Time until the window is full and every client is connected."""


@dataclass(frozen=True, slots=True)
class Latency:
    """A duration, ms; for a value, from the delivery of its pair's last frame to its arrival at a reader."""

    count: int
    p50_ms: float
    p99_ms: float
    max_ms: float


@dataclass(frozen=True, slots=True)
class LoadFigures:
    """Cost of the daemon's process, all threads; a share of 1 is one core."""

    name: str
    seconds: float
    pairs: int
    lost: int
    cpu_share: float
    cpu_ms_a_pair: float | None
    latency: Latency | None
    answers: dict[str, int]
    """Figures of the connected clients."""


@dataclass(frozen=True, slots=True)
class RateFigures:
    """The daemon on one core at several rates, and the chain's own rate, pairs/s."""

    core: int
    chain_alone: float
    loads: list[LoadFigures]
    others_share: float
    """CPU share of other processes on that core; while they run, frames of this process wait."""


def measure_load(material: Material, name: str, pairs_per_s: float, seconds: float) -> LoadFigures:
    """Measure the daemon without interfaces."""
    return asyncio.run(_load(material, name, pairs_per_s, seconds, make_config(), dict))


def measure_served(
    material: Material, name: str, seconds: float, has_broker: bool, has_clients: bool
) -> LoadFigures:
    """Measure with all interfaces, and with clients of Modbus TCP, HTTP and telegram in another process.

    Without clients the telegrams go to the null device. Without a broker the unit tries to connect to one.
    """
    with interfaces() as unit, broker(unit.mqtt_port, has_broker):
        places = unit.modbus_port, unit.http_port, unit.telegram
        polling = reporter("benchmarks.poller", *places, pass_fds=[unit.telegram])
        discarding = child(["/bin/cat"], stdin=unit.telegram, stdout=subprocess.DEVNULL)
        with polling if has_clients else discarding as clients:

            def dismiss() -> dict[str, int]:
                told: dict[str, int] = json.loads(clients.result()) if has_clients else {}
                return told

            config = make_config(**unit.tables)
            return asyncio.run(_load(material, name, FPS, seconds, config, dismiss))


def measure_rates(material: Material, rates: Sequence[float], seconds: float) -> RateFigures:
    """Measure the daemon without interfaces on one core, ``seconds`` at each rate below the chain's own."""
    allowed = os.sched_getaffinity(0)
    core = max(allowed)
    _pin({core})
    busy_s, own_s, wall_s = _busy_s(core), time.process_time(), time.monotonic()
    try:
        alone = pure_rate(material, min(seconds, 1.5))
        loads = [
            measure_load(material, f"one core, {rate:g} pairs/s", rate, seconds)
            for rate in rates
            if rate < alone
        ]
        busy_s, own_s, wall_s = _busy_s(core) - busy_s, time.process_time() - own_s, time.monotonic() - wall_s
        return RateFigures(core, alone, loads, max(busy_s - own_s, 0.0) / wall_s)
    finally:
        _pin(allowed)


async def _load(
    material: Material,
    name: str,
    pairs_per_s: float,
    seconds: float,
    config: Config,
    dismiss: Callable[[], dict[str, int]],
) -> LoadFigures:
    source = Source(material, pairs_per_s)
    async with running(source, config) as daemon, watched(daemon, source) as waits_ns:
        cursor = daemon.board.cursor()
        while pairs_per_s and not (await cursor.next()).valid:
            pass  # interfaces start first, some of them in a second
        await asyncio.sleep(SETTLE_S)
        seen, cpu_s, wall_s = len(waits_ns), time.process_time(), time.monotonic()
        await asyncio.sleep(seconds)
        waits_ms = np.array(waits_ns[seen:]) * 1e-6
        cpu_s, wall_s = time.process_time() - cpu_s, time.monotonic() - wall_s
        answers = await asyncio.to_thread(dismiss)
        pairs_lost = lost(daemon) if pairs_per_s else 0
    latency = latency_of(waits_ms) if len(waits_ms) else None
    each_ms = 1e3 * cpu_s / len(waits_ms) if len(waits_ms) else None
    return LoadFigures(name, wall_s, len(waits_ms), pairs_lost, cpu_s / wall_s, each_ms, latency, answers)


def latency_of(waits_ms: FloatArray) -> Latency:
    """Statistics of at least one wait."""
    p50_ms, p99_ms = (float(value) for value in np.percentile(waits_ms, (50, 99)))
    return Latency(len(waits_ms), p50_ms, p99_ms, float(waits_ms.max()))


@contextlib.asynccontextmanager
async def watched(daemon: Daemon, source: Source) -> AsyncIterator[list[int]]:
    """Read as any client does within the block; yield the ages of valid values' frames at arrival, ns."""
    waits_ns: list[int] = []

    async def watch() -> None:
        cursor = daemon.board.cursor()
        while True:
            measurement = await cursor.next()
            now_ns = time.monotonic_ns()
            if measurement.valid:
                waits_ns.append(now_ns - source.handed_ns[measurement.sequence])

    watching = asyncio.create_task(watch())
    try:
        yield waits_ns
    finally:
        watching.cancel()


def lost(daemon: Daemon) -> int:
    """Frames that were dropped or late, and exposures after the first half window without a value."""
    counters = daemon.health.component("measuring").counters
    dropped = sum(counters.get(f"dropped_{camera}", 0) for camera in CAMERAS)
    useless = counters.get("measurements", 0) - counters.get("valid", 0) - (WINDOW // 2 - 1)
    return dropped + counters.get("late_frames", 0) + max(useless, 0)


@contextlib.asynccontextmanager
async def running(source: Source, config: Config) -> AsyncIterator[Daemon]:
    """Run a daemon on the cameras of a source within the block.

    The block ends if the daemon does. Raises BadInputError for what the daemon refuses.
    """
    daemon = Daemon(config, source.material.calibration, source.cameras, rehearsal=True)
    try:
        async with asyncio.TaskGroup() as tasks:
            task = tasks.create_task(daemon.run(), name="daemon")
            yield daemon
            task.cancel()
    except BaseExceptionGroup as group:
        raise unwrap_group(group, BaseException) or group from None


def _busy_s(core: int) -> float:
    """Busy time of a core since the machine started, for all processes (proc(5), /proc/stat)."""
    line = next(
        line for line in Path("/proc/stat").read_text().splitlines() if line.startswith(f"cpu{core} ")
    )
    user, nice, system, _, _, irq, softirq, steal = (int(ticks) for ticks in line.split()[1:9])
    return (user + nice + system + irq + softirq + steal) / os.sysconf("SC_CLK_TCK")


def _pin(cores: set[int]) -> None:
    """Pin every thread of this process, including waiting ones."""
    for thread in Path("/proc/self/task").iterdir():
        with contextlib.suppress(ProcessLookupError):
            os.sched_setaffinity(int(thread.name), cores)
