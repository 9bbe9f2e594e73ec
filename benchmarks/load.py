"""``python -m benchmarks.load`` (``make bench-load``): controllers and browsers at the real daemon.

With history and kept frames, as on a unit: what each kind of reader costs, how soon controllers are answered,
how old pictures are, and whether an exposure is lost. The cameras deliver from memory.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from altd.app.daemon import Daemon
from altd.app.history import history_about
from altd.config import KeptFrames
from benchmarks.cameras import Source
from benchmarks.daemon import SETTLE_S, lost
from benchmarks.material import FPS, Material, make_config, make_material
from hw_sim.ports import free_port

CONTROLLERS, BROWSERS = 10, 5
_PAIRS = 200
_MAX_HISTORY_BYTES = 400 * 10**6


@dataclass(frozen=True, slots=True)
class Readers:
    """Who reads, in a process of their own."""

    name: str
    controllers: int
    browsers: int


READERS = (
    Readers("nobody", 0, 0),
    Readers("controllers", CONTROLLERS, 0),
    Readers("browsers", 0, BROWSERS),
    Readers("both", CONTROLLERS, BROWSERS),
)


@dataclass(frozen=True, slots=True)
class LoadedFigures:
    """The daemon's process beside its readers; ``cpu_share`` is of one core, ``memory_mb`` at the end."""

    readers: Readers
    seconds: float
    pairs: int
    lost: int
    cpu_share: float
    memory_mb: float
    polls_ms: list[float]
    picture_ages_ms: list[float]
    events: int


async def measure(material: Material, readers: Readers, seconds: float, folder: Path) -> LoadedFigures:
    """Run a daemon and its readers."""
    modbus_port, http_port = free_port(), free_port()
    config = make_config(modbus_port, http_port).model_copy(
        update={"kept_frames": KeptFrames(folder=folder / "kept")}
    )
    source = Source(material, FPS)
    daemon = Daemon(config, material.calibration, source.cameras)
    about = history_about(config, material.calibration, daemon.board.quantities)
    daemon.past.keep_in(folder / "history.db", _MAX_HISTORY_BYTES, about)
    task = asyncio.create_task(daemon.run(), name="daemon")
    try:
        await asyncio.sleep(2 * SETTLE_S)
        counters = daemon.health.component("measuring").counters
        before, lost_before = counters.get("measurements", 0), lost(daemon)
        begun_s, cpu_s = time.monotonic(), time.process_time()
        arguments = [modbus_port, http_port, readers.controllers, readers.browsers, seconds]
        clients = await asyncio.create_subprocess_exec(
            sys.executable,
            "-m",
            "benchmarks.load_clients",
            *map(str, arguments),
            stdout=asyncio.subprocess.PIPE,
        )
        printed, _ = await clients.communicate()
        wall_s, cpu_s = time.monotonic() - begun_s, time.process_time() - cpu_s
        seen = json.loads(printed)
        return LoadedFigures(
            readers,
            wall_s,
            counters["measurements"] - before,
            lost(daemon) - lost_before,
            cpu_s / wall_s,
            _memory_mb(),
            seen["polls_ms"],
            seen["picture_ages_ms"],
            seen["events"],
        )
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


def _memory_mb() -> float:
    """What this process holds (proc(5), VmRSS)."""
    line = next(
        each for each in Path("/proc/self/status").read_text().splitlines() if each.startswith("VmRSS")
    )
    return int(line.split()[1]) / 1000


def _spread(values: list[float], *shares: int) -> str:
    if not values:
        return "      –" * len(shares)
    return "".join(f"{value:7.1f}" for value in np.percentile(values, shares))


def main(arguments: list[str] | None = None) -> int:
    """Print a row for each kind of readers."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.load", description=__doc__)
    parser.add_argument("--seconds", type=float, default=600.0, help="with all readers; a twentieth without")
    seconds = parser.parse_args(arguments).seconds
    material = make_material(_PAIRS, 1)
    print(
        f"{FPS:g} pairs/s of 752 × 480; {CONTROLLERS} controllers, {BROWSERS} browsers with pictures\n"
        "    readers      s  pairs  lost  core    MB   polls  p50 p99 max, ms       pictures  p50 p95 max, ms"
    )
    for readers in READERS:
        for_s = seconds if readers.name == "both" else max(seconds / 20, 5.0)
        with tempfile.TemporaryDirectory(prefix="altd-load-") as folder:
            figures = asyncio.run(measure(material, readers, for_s, Path(folder)))
        print(
            f"{readers.name:>11}{figures.seconds:7.0f}{figures.pairs:7}{figures.lost:6}{figures.cpu_share:6.2f}"
            f"{figures.memory_mb:6.0f}{len(figures.polls_ms):8}{_spread(figures.polls_ms, 50, 99, 100)}"
            f"{len(figures.picture_ages_ms):9}{_spread(figures.picture_ages_ms, 50, 95, 100)}",
            flush=True,
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
