"""``python -m benchmarks.measure`` (``make bench``): the figures, with the aims beside them."""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import platform
import sys
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from benchmarks.bench_table import Figures, lines
from benchmarks.daemon import measure_load, measure_rate
from benchmarks.material import FPS, make_material, make_pairs
from benchmarks.stages import measure_stages
from benchmarks.startup import measure_start

FAST_PAIRS_PER_S = 300.0
"""Of the cameras that the highest rate is measured with: the faster, the less moves from pair to pair."""
IDLE, BARE, FACES = "cameras silent", "no publishers", "Modbus, HTTP, serial"


@dataclass(frozen=True, slots=True)
class Effort:
    """How much of everything."""

    pairs: int
    exposures_a_node: int
    rounds: int
    idle_s: float
    load_s: float
    probe_s: float
    probes: int
    hold_s: float
    starts: int


FULL = Effort(240, 2, 6, 5.0, 21.0, 1.5, 6, 10.0, 3)
QUICK = Effort(60, 1, 2, 0.3, 1.5, 0.3, 3, 1.0, 1)


def main(arguments: list[str] | None = None) -> int:
    """Measure, print, and write the same figures to ``--json``."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.measure", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="15 s instead of two minutes; coarser")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures there too")
    options = parser.parse_args(arguments)
    figures = measure(QUICK if options.quick else FULL, options.quick)
    print("\n".join(lines(figures)))
    if options.json:
        options.json.write_text(json.dumps(dataclasses.asdict(figures), indent=1) + "\n")
    return 0


def measure(effort: Effort, quick: bool) -> Figures:
    """Everything, one after the other, in this process and its children."""
    cv2.setNumThreads(1)  # as the daemon does
    machine = _machine()
    _say("rendering the frames")
    material = make_material(effort.pairs, effort.exposures_a_node)
    _say("stages")
    stages = measure_stages(material, effort.rounds)
    loads = []
    for name, pairs_per_s, seconds in (
        (IDLE, 0.0, effort.idle_s),
        (BARE, FPS, effort.load_s),
        (FACES, FPS, effort.load_s),
    ):
        _say(f"daemon, {name}")
        loads.append(measure_load(material, name, pairs_per_s, seconds, faces=name == FACES))
    _say("highest rate")
    fast = dataclasses.replace(material, pairs=tuple(make_pairs(effort.pairs, FAST_PAIRS_PER_S)))
    rate = measure_rate(fast, effort.probe_s, effort.probes, effort.hold_s)
    _say("start of altd run")
    start = measure_start(material, effort.starts)
    _say("")
    return Figures(quick, effort.pairs, stages, loads, rate, start, machine)


def _say(what: str) -> None:
    """On a terminal, what is going on."""
    if sys.stderr.isatty():
        sys.stderr.write(f"\r\033[K{what}")
        sys.stderr.flush()


def _machine() -> dict[str, str]:
    model = [line for line in Path("/proc/cpuinfo").read_text().splitlines() if line.startswith("model name")]
    return {
        "cpu": model[0].split(":", 1)[1].strip() if model else platform.machine(),
        "cores": str(len(os.sched_getaffinity(0))),
        "load before": f"{os.getloadavg()[0]:.2f}",
        "python": platform.python_version(),
        "numpy": np.__version__,
        "opencv": cv2.__version__,
    }


if __name__ == "__main__":
    sys.exit(main())
