"""``python -m benchmarks.measure`` (``make bench``): the figures, with their targets."""

import dataclasses
import http.client
import json
import logging
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import cv2

from altd.calibration.file import save_calibration
from altd.measuring.calibration import Calibration
from benchmarks.daemon import LoadFigures, RateFigures, measure_load, measure_rates, measure_served
from benchmarks.harness import (
    Columns,
    Parser,
    child,
    end,
    machine,
    module_command,
    quiet,
    show,
    write_json,
)
from benchmarks.interfaces import BROKER
from benchmarks.material import FPS, SEED, WINDOW, Material, make_material, make_pairs
from benchmarks.stages import CHAIN, RATES_HZ, StageFigures, measure_inside, measure_stages
from benchmarks.unit_toml import unit_toml
from hw_sim import unit as simulated
from hw_sim.beam import BeamPose
from hw_sim.ports import free_port
from hw_sim.recording import recording

_TIMEOUT_S = 15.0
_IMPORTS = "import altd.cli.main, altd.config, altd.app.daemon, altd.publish.http.publisher"


@dataclass(frozen=True, slots=True)
class StartFigures:
    """Seconds from process start, medians over ``runs``.

    ``least_s`` of the time to the first valid value is the wait for exposures: half a window.
    """

    runs: int
    imports_s: float
    first_answer_s: float
    first_valid_s: float
    least_s: float


def measure_start(material: Material, runs: int) -> StartFigures:
    """Start ``altd run`` on a recording that plays in real time, and poll until it has a value."""
    with tempfile.TemporaryDirectory(prefix="altd-bench-") as name:
        port = free_port()
        config = _write_run_folder(Path(name), material.calibration, port, exposures=WINDOW)
        starts = [_start(config, port) for _ in range(runs)]
        imports = [_import_s() for _ in range(runs)]
    return StartFigures(
        runs,
        statistics.median(imports),
        statistics.median(answer for answer, _ in starts),
        statistics.median(valid for _, valid in starts),
        (WINDOW // 2 - 1) / FPS,
    )


def _write_run_folder(folder: Path, calibration: Calibration, http_port: int, exposures: int) -> Path:
    """Write a config for ``altd run`` that plays a recording in real time, with all files that it needs."""
    still = simulated.Unit(simulated.UnitConfig(seed=SEED))
    with recording(folder / "recording", still, "measurement", exposures, quiet) as made:
        for _ in range(exposures):
            made.expose(BeamPose(4.0, -3.0, 0.02, -0.03))
    save_calibration(calibration, folder / "calibration.json")
    config = folder / "altd.toml"
    camera = 'driver = "recording"\npath = "recording"\nrepeat = true'
    settings = unit_toml(f"SIM-{SEED}", "calibration.json", camera, camera)
    config.write_text(f'{settings}\n[http]\nhost = "127.0.0.1"\nport = {http_port}\n')
    return config


def _start(config: Path, port: int) -> tuple[float, float]:
    """Time to the first answer of any kind, and to the first valid measurement, s."""
    begun_s = time.monotonic()
    first_answer_s = None
    with child(module_command("altd.cli", "run", "--rehearsal", "--config", config)) as daemon:
        while (passed_s := time.monotonic() - begun_s) < _TIMEOUT_S and daemon.process.poll() is None:
            valid = _ask(port)
            if valid is not None and first_answer_s is None:
                first_answer_s = time.monotonic() - begun_s
            if valid and first_answer_s is not None:
                return first_answer_s, time.monotonic() - begun_s
            time.sleep(0.005)
        raise TimeoutError(f"altd run had no valid measurement after {passed_s:.1f} s:\n{daemon.output}")


def _ask(port: int) -> bool | None:
    """Whether the latest measurement is valid; None without an answer."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=2.0)
    try:
        connection.request("GET", "/api/measurement")
        answer = connection.getresponse()
        return answer.status == 200 and bool(json.loads(answer.read())["valid"])
    except ConnectionError:
        return None
    finally:
        connection.close()


def _import_s() -> float:
    """Time of the imports of ``altd run`` in a new interpreter, without the interpreter's own start."""
    code = f"import time; t = time.perf_counter(); {_IMPORTS}; print(time.perf_counter() - t)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True)  # noqa: S603
    return float(done.stdout)


CPU_AIM_MS = 2.0
STAGE_AIMS = {
    "coarse search": "< 150 µs a frame",
    "mapping, one point": "< 40 µs a point",
    "whole chain": "< 1400 µs a pair",
}
LATENCY_AIM_MS = 10.0
START_AIM_S = 3.0


@dataclass(frozen=True, slots=True)
class Figures:
    """All figures of a run."""

    quick: bool
    pairs: int
    stages: list[StageFigures]
    inside_us: dict[str, list[float]]
    """Time of each stage within the chain, µs a pair, at each of ``RATES_HZ``."""
    loads: list[LoadFigures]
    rates: RateFigures
    start: StartFigures
    machine: dict[str, str]


def lines(figures: Figures) -> Iterator[str]:
    """Lines of the table."""
    yield (
        f"altd bench{', quick' if figures.quick else ''}: a pair is two frames of 752 × 480, 8 bits;"
        f" {figures.pairs} different pairs of hw_sim (seed {SEED}) in memory"
    )
    yield ""
    yield from _stages(figures.stages, figures.inside_us)
    yield ""
    yield from _loads(figures.loads)
    yield ""
    yield from _rates(figures.rates)
    yield ""
    yield from _start_lines(figures.start)
    yield ""
    yield ", ".join(f"{what} {value}" for what, value in figures.machine.items())


_STAGES = Columns(
    *("stage:<34", "calls:>6", "median µs:>11.1f", "p99 µs:>9.1f", "µs a pair:>11.0f", "× copy:>8.1f"),
    *(f"at {rate}/s:>10.0f" for rate in RATES_HZ),
    "   aim:",
)


def _stages(stages: list[StageFigures], inside_us: Mapping[str, list[float]]) -> Iterator[str]:
    yield _STAGES.head
    blank = [""] * len(RATES_HZ)
    alone = [stage.name for stage in stages]
    for stage in stages:
        if stage.name == CHAIN:
            more = {name: times_us for name, times_us in inside_us.items() if name not in alone}
            yield from (_STAGES.row(name, *[""] * 5, *times_us) for name, times_us in more.items())
        name = f"  of it {stage.name}" if stage.part_of else stage.name
        a_pair_us = stage.calls_a_pair * stage.median_us
        figures = name, stage.calls_a_pair, stage.median_us, stage.p99_us, a_pair_us, stage.passes
        aim = f"   {STAGE_AIMS.get(stage.name, '')}"
        yield _STAGES.row(*figures, *inside_us.get(stage.name, blank), aim)
    yield "at so many pairs/s: mean CPU µs a pair of each stage in the running chain, frames not in a cache"


_LOADS = Columns(
    *(
        f"daemon, {FPS:g} pairs/s:<24",
        "CPU % of a core:>16.2f",
        "CPU ms a pair:>15.2f",
        "pairs:>7",
        "lost:>6",
    ),
    *("p50 ms:>9.2f", "p99 ms:>8.2f", "max ms:>8.2f"),
)


def _loads(loads: list[LoadFigures]) -> Iterator[str]:
    yield _LOADS.head
    yield from _load_rows(loads)
    yield _LOADS.row("aim", "", f"< {CPU_AIM_MS:g}", "", 0, "", f"< {LATENCY_AIM_MS:g}")
    yield "p50, p99, max: from the pair's last frame handed over to the value in a reader's hands"
    attached = next((load.answers for load in loads if load.answers), {})
    yield "clients were given " + ", ".join(f"{count} {what}" for what, count in attached.items())


def _load_rows(loads: list[LoadFigures]) -> Iterator[str]:
    for load in loads:
        figures: tuple[object, ...] = ()
        if (wait := load.latency) is not None:
            figures = load.cpu_ms_a_pair, load.pairs, load.lost, wait.p50_ms, wait.p99_ms, wait.max_ms
        yield _LOADS.row(load.name, 100 * load.cpu_share, *figures)


def _rates(rates: RateFigures) -> Iterator[str]:
    yield from _load_rows(rates.loads)
    yield (
        f"the chain alone, back to back: {rates.chain_alone:.0f} pairs/s;"
        f" other processes took {rates.others_share:.0%} of that core meanwhile"
    )


def _start_lines(start: StartFigures) -> Iterator[str]:
    yield (
        f"altd run, from process start: imports {start.imports_s:.2f} s, first HTTP answer"
        f" {start.first_answer_s:.2f} s, first valid measurement {start.first_valid_s:.2f} s"
        f" (aim < {START_AIM_S:g} s; {start.least_s:.2f} s of it half a window of exposures)"
    )


FAST_PAIRS_PER_S = 300.0
"""Rate of the cameras of ``LOSS_RATES_HZ``: the higher, the less moves from pair to pair."""
LOSS_RATES_HZ = 50.0, 100.0, 150.0, 200.0
"""Rates at which losses are counted."""
IDLE, BARE = "cameras silent", "no publishers"
SERVED = [("all interfaces, unread", False, False), ("the same with clients", bool(BROKER), True)]
if BROKER:
    SERVED.insert(1, ("the same with a broker", True, False))
"""Rows with all interfaces: name, whether there is an MQTT broker, and whether clients read."""


@dataclass(frozen=True, slots=True)
class Effort:
    """Extent of each part."""

    pairs: int
    exposures_a_node: int
    rounds: int
    idle_s: float
    load_s: float
    rate_s: float
    starts: int


FULL = Effort(240, 2, 6, 5.0, 21.0, 10.0, 3)
QUICK = Effort(60, 1, 2, 0.3, 1.5, 0.5, 1)


def main(arguments: list[str] | None = None) -> int:
    """Measure, print, and write the same figures to ``--json``."""
    parser = Parser("benchmarks.measure", __doc__)
    parser.add_argument("--quick", action="store_true", help="15 s instead of two minutes; coarser")
    parser.json()
    options = parser.parse_args(arguments)
    figures = measure(QUICK if options.quick else FULL, options.quick)
    print("\n".join(lines(figures)))
    write_json(options.json, figures)
    return 0


def measure(effort: Effort, quick: bool) -> Figures:
    """Measure everything, one after another, in this process and its children."""
    cv2.setNumThreads(1)  # as in the daemon
    logging.getLogger().addHandler(logging.NullHandler())  # the broker is missing intentionally
    of_machine = machine()
    show("rendering the frames")
    material = make_material(effort.pairs, effort.exposures_a_node)
    show("stages")
    stages = measure_stages(material, effort.rounds)
    show("stages in the chain")
    inside_us = measure_inside(material)
    loads = []
    for name, pairs_per_s, seconds in (IDLE, 0.0, effort.idle_s), (BARE, FPS, effort.load_s):
        show(f"daemon, {name}")
        loads.append(measure_load(material, name, pairs_per_s, seconds))
    for name, has_broker, has_clients in SERVED:
        show(f"daemon, {name}")
        loads.append(measure_served(material, name, effort.load_s, has_broker, has_clients))
    show("losses by rate")
    fast = dataclasses.replace(material, pairs=tuple(make_pairs(effort.pairs, FAST_PAIRS_PER_S)))
    rates = measure_rates(fast, LOSS_RATES_HZ, effort.rate_s)
    show("start of altd run")
    start = measure_start(material, effort.starts)
    show("")
    return Figures(quick, effort.pairs, stages, inside_us, loads, rates, start, of_machine)


if __name__ == "__main__":
    end(main, "benchmarks.measure")
