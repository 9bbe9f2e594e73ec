"""``python -m benchmarks.memory`` (``make bench-memory``): memory of commands, by nodes and frames.

Each command runs in a separate process, one at a time; its peak is the kernel's (``ru_maxrss`` of wait4). A
process begins with the peak of its parent, so this module imports nothing large.
"""

import math
import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import astuple, dataclass, replace
from pathlib import Path

from altd.errors import BadInputError
from benchmarks.harness import Columns, Parser, child, end, module_command, write_json
from benchmarks.unit_toml import unit_toml

NODES = 30, 120, 480, 2000
FRAMES = 10, 1000, 10_000
EXPOSURES_A_NODE = 2
EXPOSURES_A_POSE = 5
FPS = 20.0
SEED = 1


@dataclass(frozen=True, slots=True)
class Figure:
    """Cost of one run of a command; ``size`` is the nodes of its scan, or the frames of its recording."""

    command: str
    size: int
    peak_mb: float
    seconds: float
    cpu_s: float


def main(arguments: list[str] | None = None) -> int:
    """Make the inputs, run the commands, print a line for each."""
    parser = Parser("benchmarks.memory", "Peak memory and time of altd's commands.")
    parser.counts("--nodes", NODES, "of the scans")
    parser.counts("--frames", FRAMES, "of the recordings")
    parser.count("--exposures", EXPOSURES_A_NODE, "a node")
    parser.json()
    options = parser.parse_args(arguments)
    table = Columns("command:<34", "nodes, frames:>14", "peak MB:>9.0f", "seconds:>9.1f", "CPU s:>8.1f")
    print(table.head)
    figures = []
    with tempfile.TemporaryDirectory(prefix="altd-bench-") as name:
        for figure in measure(Path(name), options.nodes, options.frames, options.exposures):
            figures.append(figure)
            print(table.row(*astuple(figure)), flush=True)
    write_json(options.json, figures)
    return 0


def measure(folder: Path, nodes: Sequence[int], frames: Sequence[int], exposures: int) -> Iterator[Figure]:
    """Run all commands in ``folder``, the smallest input first."""
    flat, scan, calibration = folder / "flat", folder / "scan", folder / "calibration.json"
    _hw_sim("flat", flat, 0)
    for count in sorted(nodes):
        yield _hw_sim("scan", scan, count, "--grid", _grid(count), "--exposures", exposures)
        yield _altd("calibrate --flat", count, flat, scan, "-o", calibration)
        yield _altd("calibrate", count, scan, "-o", calibration)
        shutil.rmtree(scan)
    if not nodes:
        _hw_sim("scan", scan, 0)
        _altd("calibrate", 0, scan, "-o", calibration)
    for count in sorted(frames):
        yield from _of_frames(folder, count, calibration)


def _of_frames(folder: Path, frames: int, calibration: Path) -> Iterator[Figure]:
    """Run the commands that make, measure and copy a recording of ``frames`` of two cameras."""
    played, copied, truth = folder / "played", folder / "copied", folder / "truth.json"
    poses = max(frames // 2 // EXPOSURES_A_POSE, 1)
    few = "--poses", poses, "--exposures", EXPOSURES_A_POSE, "--truth", truth
    yield _hw_sim("measure", played, frames, *few)
    window = "--window", EXPOSURES_A_POSE, "--every", EXPOSURES_A_POSE
    yield _altd("replay", frames, played, "--calibration", calibration, *window)
    config = folder / "altd.toml"
    camera = f'driver = "recording"\npath = "{played}"\npace = "fast"'
    config.write_text(unit_toml("SIM-1", "none.json", camera, camera))
    seconds = math.ceil(frames / FPS) + 1  # more frames than it plays
    record = "--config", config, "-o", copied, "--seconds", seconds
    yield replace(_altd("record", frames, *record), command="altd record, played at full speed")
    shutil.rmtree(played)
    shutil.rmtree(copied)


def _altd(command: str, size: int, *arguments: object) -> Figure:
    """Run a command of altd; ``command`` may end with its first option."""
    return _run(f"altd {command}", size, module_command("altd.cli", *command.split(), *arguments))


def _hw_sim(command: str, output: Path, size: int, *arguments: object) -> Figure:
    words = module_command("hw_sim", command, "-o", output, "--seed", SEED, *arguments)
    return _run(f"hw_sim {command}", size, words)


def _run(name: str, size: int, command: Sequence[str]) -> Figure:
    """Run a command to its end; raises RuntimeError with its output if it fails."""
    begun_s = time.monotonic()
    with child(command, stdout=subprocess.DEVNULL) as running:
        _, status, usage = os.wait4(running.process.pid, 0)
        seconds = time.monotonic() - begun_s
        running.process.returncode = os.waitstatus_to_exitcode(status)
        running.result()
    return Figure(name, size, usage.ru_maxrss / 1024, seconds, usage.ru_utime + usage.ru_stime)


def _grid(nodes: int) -> str:
    """Columns and rows for about this number of nodes, nearest to 5 : 4 as the area."""
    rows = min(
        (rows for rows in range(4, nodes // 4 + 1) if nodes % rows == 0),
        key=lambda rows: abs(math.log(nodes / rows**2 / 1.25)),
        default=0,
    )
    if not rows:
        raise BadInputError("--nodes", f"{nodes} nodes make no grid")
    return f"{nodes // rows},{rows}"


if __name__ == "__main__":
    end(main, "benchmarks.memory")
