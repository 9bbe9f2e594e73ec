"""``python -m studies.vibration_daemon``: the daemon on GigE Vision cameras of a machine that vibrates.

The frequency changes while the daemon runs. ``unshare -rn python -m studies.vibration_daemon FILE`` measures
for 23 minutes in a network namespace of its own and writes the figures as JSON; ``--draw SVG`` draws them.
The page of the study ``vibration`` states the largest.
"""

import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from altd.cli.arguments import Parser
from altd.files.writing import write_file
from altd.process.endings import run_to_end
from benchmarks.harness import Child, child, write_json
from benchmarks.live.parts import (
    FRONT,
    REAR,
    SEED,
    calibrate,
    cameras_command,
    ip,
    measuring_daemon,
    off_the_daemons_core,
)
from benchmarks.live.watch import Watch
from studies.plot import FOURTH, OURS, THESIS, as_svg, panels, plain_decades, style

LARGEST_MM = 0.3
CELLS = (
    *((hz, mm) for mm in (0.05, 0.1) for hz in (20, 25, 40, 60, 100)),
    *(
        (hz, LARGEST_MM)
        for hz in (1, 5, 10, 19, 20, 21, 25, 40, 41, 50, 59, 60, 61, 80, 99, 100, 101, 120, 130)
    ),
)
"""Frequency, Hz, and amplitude, mm, in x and in y; the smallest first, since sigma remembers a larger one."""
DROPPED_SHARE = 0.4
"""Of the time at a frequency: sigma still remembers the one before."""
START_S = 60.0
FIGURES = Path(__file__).parents[1] / "docs/studies/vibration-daemon.json"
_LARGEST = "largest", "largest_of_angles"


@dataclass(frozen=True, slots=True)
class Cameras:
    """Cameras and settings of a run of the daemon; ``share`` of the time at a frequency suffices."""

    trigger: str
    stated_mm: float
    share: float


RUNS = {
    "uneven": Cameras("software", 0.0, 1.0),
    "even": Cameras("free", 0.0, 0.5),
    "even, stated": Cameras("free", LARGEST_MM, 0.5),
}
"""Even sampling remembers no scatter. A vibration is stated for the cells of its amplitude alone."""


@dataclass(frozen=True, slots=True)
class Cell:
    """Error/sigma of the valid values of one vibration, x and y, yaw and pitch, against the unit at rest."""

    run: str
    hertz: float
    amplitude_mm: float
    valid: int
    invalid: int
    exposures_lost: int
    """Number of valid values of windows that lack exposures."""
    rms: float | None
    largest: float | None
    rms_of_angles: float | None
    largest_of_angles: float | None

    def __str__(self) -> str:
        """One line of progress."""
        found = "no valid value" if self.rms is None else f"rms {self.rms:.2f}, largest {self.largest:.2f}"
        return (
            f"{self.run}: {self.hertz:g} Hz, {self.amplitude_mm:g} mm: {found} sigma; {self.valid} valid, "
            f"{self.invalid} invalid, {self.exposures_lost} with exposures lost"
        )


def cell_of(run: str, hertz: float, amplitude_mm: float, measurements: Iterable[dict[str, Any]]) -> Cell:
    """Judge the measurements of one vibration. The beam at rest is in the middle: the truth is 0."""
    every = list(measurements)
    valid = [one for one in every if one["valid"]]
    lost = sum("exposures_lost" in one["status"] for one in valid)
    figures: list[float | None] = []
    for keys in (("x_mm", "y_mm"), ("yaw_deg", "pitch_deg")):
        in_sigmas = np.array([one[key] / one["sigma"][key] for one in valid for key in keys])
        if not len(in_sigmas):
            figures += [None, None]
            continue
        figures += [float(np.sqrt(np.square(in_sigmas).mean())), float(np.abs(in_sigmas).max())]
    return Cell(run, hertz, amplitude_mm, len(valid), len(every) - len(valid), lost, *figures)


def measured(
    name: str, cells: Sequence[tuple[float, float]], seconds: float, folder: Path, calibration: Path
) -> Iterator[Cell]:
    """Run the daemon once, and change the vibration of its cameras while it measures."""
    run = RUNS[name]
    stated = f"[measuring]\nvibration_mm = {run.stated_mm}\n" if run.stated_mm else ""
    command, log = cameras_command(SEED, "--listen"), folder / f"{name}.log"
    with child(command, log, stdin=subprocess.PIPE) as cameras:
        cameras.await_text("Ctrl-C ends it")
        with measuring_daemon(folder, calibration, (FRONT, REAR), stated, run.trigger) as (_, watch):
            watch.first(lambda seen: seen.valid, 0.0, START_S)
            while watch.status()["components"]["measuring"]["sampling"] is None:
                time.sleep(0.5)
            for hertz, amplitude_mm in cells:
                if run.stated_mm in {0.0, amplitude_mm}:
                    seen = _vibrating(cameras, watch, hertz, amplitude_mm, seconds * run.share)
                    yield cell_of(name, hertz, amplitude_mm, seen)


def _vibrating(
    cameras: Child, watch: Watch, hertz: float, amplitude_mm: float, seconds: float
) -> list[dict[str, Any]]:
    assert cameras.process.stdin is not None  # noqa: S101  a pipe, as requested
    cameras.process.stdin.write(f"line {hertz:g} {amplitude_mm:g}\n".encode())
    cameras.process.stdin.flush()
    time.sleep(DROPPED_SHARE * seconds)
    first = len(watch.seen)
    time.sleep((1.0 - DROPPED_SHARE) * seconds)
    if watch.failure is not None:
        raise watch.failure
    return [seen.measurement for seen in watch.seen[first:]]


def draw(cells: Sequence[dict[str, Any]]) -> str:
    """Return the picture: error/sigma of x and y against the frequency, rms filled, largest hollow."""
    with style():
        figure, (axis,) = panels(width=7.0, height=3.6)
        for (name, _), colour in zip(RUNS.items(), (OURS, THESIS, FOURTH), strict=True):
            for amplitude_mm, marker in ((0.05, "^"), (0.1, "s"), (LARGEST_MM, "o")):
                of = [each for each in cells if (each["run"], each["amplitude_mm"]) == (name, amplitude_mm)]
                of = [each for each in of if each["rms"] is not None]
                if not of:
                    continue
                hertz = [each["hertz"] for each in of]
                for key, filled in (("rms", "full"), ("largest", "none")):
                    label = f"{name}, {amplitude_mm:g} mm" if key == "rms" else None
                    marks = axis.plot(hertz, [each[key] for each in of], marker, color=colour, label=label)
                    marks[0].set(markersize=3.5, fillstyle=filled)
        axis.axhline(1.0, color="black", linewidth=0.6)
        axis.axhline(5.0, color="black", linewidth=0.6, linestyle=":")
        axis.set_yscale("log")
        axis.set_xlabel("frequency of the vibration, Hz")
        axis.set_ylabel("error/sigma: rms filled, largest hollow")
        plain_decades(axis.yaxis)
        axis.legend(ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    return as_svg(figure, "vibration-daemon")


def summary() -> str:
    """Return what was measured last, and the picture, for the page of the study ``vibration``."""
    cells = json.loads(FIGURES.read_text())
    worst = {
        run: [max(cell[key] for cell in cells if cell["run"] == run and cell["valid"]) for key in _LARGEST]
        for run in RUNS
    }
    told = [
        f"{run}: {x_y:.1f} sigma in x or y, {angles:.1f} in yaw or pitch"
        for run, (x_y, angles) in worst.items()
    ]
    return (
        "**In the daemon** on two emulated GigE Vision cameras, 8 to 15 s for each of "
        f"{len({(cell['hertz'], cell['amplitude_mm']) for cell in cells})} vibrations in x and y; software "
        "triggers (uneven), cameras that run freely (even), and these with `vibration_mm` stated. Largest "
        f"errors: {'; '.join(told)}. Measured by `python -m studies.vibration_daemon`.\n\n"
        "![Error/sigma of the daemon over frequency](vibration-daemon.svg)"
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure all runs and write each cell at once, or draw a file of them."""
    parser = Parser(prog="python -m studies.vibration_daemon", description=__doc__)
    parser.add_argument("file", type=Path, metavar="FILE", help="figures, as JSON")
    parser.add_argument("--draw", type=Path, metavar="SVG", help="measure nothing; draw the file's figures")
    parser.add_argument("--seconds", type=float, default=25.0, help="at each frequency (default 25)")
    parser.add_argument("--hertz", type=float, nargs="+", help="measure these frequencies alone")
    options = parser.parse_args(arguments)
    if options.draw:
        write_file(options.draw, draw(json.loads(options.file.read_text())).encode())
        return 0
    ip("link", "set", "lo", "up")
    ip("address", "add", f"{REAR}/32", "dev", "lo")
    chosen = [cell for cell in CELLS if not options.hertz or cell[0] in options.hertz]
    found: list[dict[str, Any]] = []
    with off_the_daemons_core(), tempfile.TemporaryDirectory(prefix="altd-vibration-") as name:
        calibration = calibrate(SEED, Path(name))
        for run in RUNS:
            for cell in measured(run, chosen, options.seconds, Path(name), calibration):
                print(cell, flush=True)
                found.append(asdict(cell))
                write_json(options.file, found)
    return 0


if __name__ == "__main__":
    sys.exit(run_to_end(main, lambda: "studies.vibration_daemon"))
