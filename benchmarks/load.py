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

from benchmarks.daemon import SETTLE_S, lost, served_unit
from benchmarks.material import FPS, Material, make_material
from benchmarks.process_memory import resident_mb

CONTROLLERS, BROWSERS = 10, 5
_PAIRS = 200


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
    """Since the light, when it was there or, by Chromium, when it was drawn."""
    chromium_cores: float | None
    chromium_mb: float | None


async def measure(
    material: Material, readers: Readers, seconds: float, folder: Path, real: bool
) -> LoadedFigures:
    """Run a daemon and its readers; ``real``: the browsers are Chromium, else they only read as it does."""
    async with served_unit(material, folder) as unit:
        daemon, browsers = unit.daemon, readers.browsers if real else 0
        showing = await _started("show", unit.http_port, browsers, seconds) if browsers else None
        if showing is not None and showing.stdout is not None:
            await showing.stdout.readline()
        await asyncio.sleep(2 * SETTLE_S)
        counters = daemon.health.component("measuring").counters
        before, lost_before = counters.get("measurements", 0), lost(daemon)
        begun_s, cpu_s = time.monotonic(), time.process_time()
        ports = unit.modbus_port, unit.http_port
        clients = await _started("read", *ports, readers.controllers, readers.browsers - browsers, seconds)
        printed, _ = await clients.communicate()
        wall_s, cpu_s = time.monotonic() - begun_s, time.process_time() - cpu_s
        measured, lost_now = counters["measurements"] - before, lost(daemon) - lost_before
        seen = json.loads(printed)
        shown = json.loads((await showing.communicate())[0]) if showing is not None else {}
        light_ms = (time.time_ns() - time.monotonic_ns() + unit.source.start_ns()) * 1e-6
        return LoadedFigures(
            readers,
            wall_s,
            measured,
            lost_now,
            cpu_s / wall_s,
            resident_mb(),
            seen["polls_ms"],
            [
                came_ms - light_ms - number * unit.source.period_ns * 1e-6
                for number, came_ms in shown.get("pictures", seen["pictures"])
            ],
            shown.get("cores"),
            shown.get("memory_mb"),
        )


async def _started(what: str, *arguments: float) -> asyncio.subprocess.Process:
    return await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "benchmarks.load_readers", what, *map(str, arguments)),
        stdout=asyncio.subprocess.PIPE,
    )


def _spread(values: list[float], *shares: int) -> str:
    if not values:
        return "      –" * len(shares)
    return "".join(f"{value:7.1f}" for value in np.percentile(values, shares))


def main(arguments: list[str] | None = None) -> int:
    """Print a row for each kind of readers."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.load", description=__doc__)
    parser.add_argument("--seconds", type=float, default=600.0, help="with all readers; a twentieth without")
    parser.add_argument(
        "--browsers",
        choices=("emulated", "chromium"),
        default="emulated",
        help="emulated: read as the page does, draw nothing",
    )
    options = parser.parse_args(arguments)
    material = make_material(_PAIRS, 1)
    print(
        f"{FPS:g} pairs/s of 752 × 480; {CONTROLLERS} controllers, {BROWSERS} browsers ({options.browsers}) "
        "with pictures\n"
        "    readers      s  pairs  lost  core    MB   polls  p50 p99 max, ms       pictures  p50 p95 max, ms"
        "  Chromium: cores, MB"
    )
    for readers in READERS:
        seconds = options.seconds if readers.name == "both" else max(options.seconds / 20, 5.0)
        with tempfile.TemporaryDirectory(prefix="altd-load-") as folder:
            real = options.browsers == "chromium"
            figures = asyncio.run(measure(material, readers, seconds, Path(folder), real))
        chromium = ""
        if figures.chromium_cores is not None:
            chromium = f"{figures.chromium_cores:10.2f}{figures.chromium_mb:8.0f}"
        print(
            f"{readers.name:>11}{figures.seconds:7.0f}{figures.pairs:7}{figures.lost:6}{figures.cpu_share:6.2f}"
            f"{figures.memory_mb:6.0f}{len(figures.polls_ms):8}{_spread(figures.polls_ms, 50, 99, 100)}"
            f"{len(figures.picture_ages_ms):9}{_spread(figures.picture_ages_ms, 50, 95, 100)}{chromium}",
            flush=True,
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
