"""``python -m benchmarks.load`` (``make bench-load``): clients of all interfaces at the real daemon.

History and kept frames are enabled, as on a unit; the cameras deliver from memory. The clients run in
separate processes, in the idle scheduling class. It prints the lost exposures and the CPU of the daemon's
process without clients, with clients of each interface alone, and with all of them. The difference from the
daemon without clients ("more") is the CPU of an interface, including the process of OPC UA. MQTT and OPC UA
are configured only where they have a client; the broker's CPU is not counted. "stolen" is the time for which
the hypervisor gave a core of this machine to another one (0 on a physical machine); the last lines list the
stolen time around each loss.

For each interface beside all others it prints the response time to requests and the age of messages. A
message states its capture time, and its age when it was sent. The clients compute the age at arrival as the
current time less the capture time, because they share the unit's clock. "behind" is the age at arrival less
the age in the message, that is, the time in the unit's buffers, a broker and the client, with an error of 1
ms from rounding. A value that waits in the unit before its message is made contributes to "age" alone.
Pictures have no age in their message; theirs counts from the exposure.
"""

import asyncio
import contextlib
import json
import os
import tempfile
import time
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.daemon import SETTLE_S, ServedUnit, lost, served_unit
from benchmarks.harness import Child, Columns, Parser, cpu_s, end, reporter
from benchmarks.load_readers import READING, Seen
from benchmarks.material import FPS, Material, make_material
from benchmarks.process_memory import resident_mb

_PAIRS = 200
CLIENTS = {"modbus_tcp": 10, "modbus_rtu": 3, "mqtt": 1, "opcua": 1, "browser": 2}
"""Number of clients of each kind; ``browser`` emulates the page, or is Chromium."""
ANSWER_AIM_MS, BEHIND_AIM_MS = 5.0, 150.0


@dataclass(frozen=True, slots=True)
class LoadedFigures:
    """The daemon's process with its clients; ``cpu_share`` is of one core, ``memory_mb`` at the end."""

    seconds: float
    pairs: int
    lost: int
    cpu_share: float
    stolen_s: float
    losses: list[str]
    """Time and size of each loss, and the stolen time in the second around it."""
    memory_mb: float
    seen: dict[str, Seen]
    picture_ages_ms: list[float]
    """Time from exposure to arrival or, with Chromium, to display."""


async def measure(
    material: Material, kinds: list[str], seconds: float, folder: Path, chromium: bool
) -> LoadedFigures:
    """Run a daemon and these clients; ``chromium`` shows the page instead of an emulated browser."""
    more = [kind for kind in ("mqtt", "opcua") if kind in kinds]
    async with contextlib.AsyncExitStack() as life:
        unit = await life.enter_async_context(served_unit(material, folder, CLIENTS["modbus_rtu"], more))
        clients = {kind: life.enter_context(_client(kind, unit, chromium)) for kind in kinds}
        for client in clients.values():
            await asyncio.to_thread(client.await_text, READING)
        await asyncio.sleep(SETTLE_S)
        counters = unit.daemon.health.component("measuring").counters
        before, lost_before = counters.get("measurements", 0), lost(unit.daemon)
        begun_s, used_s, stolen_s = time.monotonic(), _cpu_s(), _stolen_s()
        losses = await _losses(unit, seconds)
        wall_s, used_s, stolen_s = time.monotonic() - begun_s, _cpu_s() - used_s, _stolen_s() - stolen_s
        measured, lost_now = counters["measurements"] - before, lost(unit.daemon) - lost_before
        seen = {}
        for kind, client in clients.items():
            printed = await asyncio.to_thread(client.result)
            seen[kind] = Seen(**json.loads(printed.rpartition(READING)[2]))
        light_ms = (time.time_ns() - time.monotonic_ns() + unit.source.start_ns()) * 1e-6
        picture_ages_ms = [
            came_ms - light_ms - number * unit.source.period_ns * 1e-6
            for each in seen.values()
            for number, came_ms in each.pictures
        ]
        used = used_s / wall_s, stolen_s, losses, resident_mb()
        return LoadedFigures(wall_s, measured, lost_now, *used, seen, picture_ages_ms)


async def _losses(unit: ServedUnit, seconds: float) -> list[str]:
    """Wait for ``seconds``; record each loss with the time stolen in the second that ends with it."""
    losses, stolen_s = [], deque([_stolen_s()], maxlen=5)
    begun_s, lost_before = time.monotonic(), lost(unit.daemon)
    while (now_s := time.monotonic() - begun_s) < seconds:
        await asyncio.sleep(min(0.25, seconds - now_s))
        stolen_s.append(_stolen_s())
        if (lost_now := lost(unit.daemon)) > lost_before:
            took_ms = 1e3 * (stolen_s[-1] - stolen_s[0])
            losses.append(
                f"{now_s:.0f} s: {lost_now - lost_before} lost, {took_ms:.0f} ms stolen within a second"
            )
            lost_before = lost_now
    return losses


def _client(kind: str, unit: ServedUnit, chromium: bool) -> contextlib.AbstractContextManager[Child]:
    found = unit.interfaces
    port = {
        "modbus_tcp": found.modbus_port,
        "mqtt": found.mqtt_port,
        "opcua": found.opcua_port,
        "browser": found.http_port,
    }
    places = found.rtu if kind == "modbus_rtu" else [port[kind]] * CLIENTS[kind]
    program = "chromium" if chromium and kind == "browser" else kind
    return reporter("benchmarks.load_readers", program, *places, pass_fds=found.rtu)


def _cpu_s() -> float:
    """CPU time so far of the daemon's process and of the process for OPC UA."""
    pids = [
        int(pid)
        for children in Path("/proc/self/task").glob("*/children")
        for pid in children.read_text().split()
        if b"altd.publish.opcua" in Path("/proc", pid, "cmdline").read_bytes()
    ]
    return time.process_time() + sum(map(cpu_s, pids))


def _stolen_s() -> float:
    """Stolen time of all cores since the machine started (Linux, ``Documentation/filesystems/proc.rst``)."""
    return int(Path("/proc/stat").read_text().split(maxsplit=9)[8]) / os.sysconf("SC_CLK_TCK")


def _percentiles(values_ms: Sequence[float]) -> str:
    if not len(values_ms):
        return " " * 24
    return "".join(f"{value:8.1f}" for value in np.percentile(values_ms, (50, 99, 100)))


def lines(figures: LoadedFigures) -> Iterator[str]:
    """Answers and ages of each interface, as lines."""
    spread = f"{'p50':>8}{'p99':>8}{'max':>8}"
    yield f"{'with all, ms':>14}{'answers':>10}{spread}{'behind':>10}{spread}{'age':>6}{spread}"
    for kind, seen in figures.seen.items():
        yield (
            f"{CLIENTS[kind]:>3} {kind:<10}{len(seen.answers_ms):>10}{_percentiles(seen.answers_ms)}"
            f"{len(seen.ages_ms):>10}{_percentiles([behind_ms for _, behind_ms in seen.ages_ms])}"
            f"{'':6}{_percentiles([age_ms for age_ms, _ in seen.ages_ms])}"
        )
    ages_ms = figures.picture_ages_ms
    yield f"{'pictures':>14}{'':34}{len(ages_ms):>10}{'':30}{_percentiles(ages_ms)}"
    yield f"{'aim':>14}{ANSWER_AIM_MS:>26g}{BEHIND_AIM_MS:>34g}"
    yield from figures.losses
    for seen in figures.seen.values():
        if seen.cores:
            yield f"Chromium: {seen.cores:.2f} cores, {seen.memory_mb:.0f} MB"


def main(arguments: list[str] | None = None) -> int:
    """Print a row for each set of clients, then the figures of each interface beside all others."""
    parser = Parser("benchmarks.load", __doc__)
    parser.number("--seconds", 600.0, "with all clients; a twentieth without and alone")
    parser.add_argument(
        "--browsers",
        choices=("emulated", "chromium"),
        default="emulated",
        help="emulated: read as the page does, draw nothing",
    )
    options = parser.parse_args(arguments)
    material = make_material(_PAIRS, 1)
    print(f"{FPS:g} pairs/s of 752 × 480, browsers {options.browsers}")
    table = Columns(
        *("clients:>14", "s:>7.0f", "pairs:>8", "lost:>6", "core:>8.3f", "more:>+8.3f", "MB:>6.0f"),
        "stolen s:>10.2f",
    )
    print(table.head)
    unread_share = None
    for name, kinds in ("none", []), *((kind, [kind]) for kind in CLIENTS), ("all", list(CLIENTS)):
        seconds = options.seconds if name == "all" else options.seconds / 20
        with tempfile.TemporaryDirectory(prefix="altd-load-") as folder:
            is_real = options.browsers == "chromium"
            figures = asyncio.run(measure(material, kinds, seconds, Path(folder), is_real))
        unread_share = figures.cpu_share if unread_share is None else unread_share
        counts, share = (figures.seconds, figures.pairs, figures.lost), figures.cpu_share
        more = share - unread_share, figures.memory_mb, figures.stolen_s
        print(table.row(name, *counts, share, *more), flush=True)
    print("\n".join(lines(figures)))
    return 0


if __name__ == "__main__":
    end(main, "benchmarks.load")
