"""Statistics of a demo: measurements against the truth, frame sets, and the process itself."""

import math
import os
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from altd.app.daemon import Daemon
from altd.records import Measurement, counted
from hw_sim.beam import BeamPose
from hw_sim.unit import CAMERAS, Unit

MEMORY_SETTLED_S = 10.0
"""Time by which the memory has settled, s; later growth is a leak."""


@dataclass(frozen=True, slots=True)
class Quantity:
    """A measured quantity; ``unit`` is the suffix of its key and of its field in ``BeamPose``."""

    name: str
    unit: str
    decimals: int

    def measured(self, measurement: Measurement) -> float:
        """Value of a valid measurement."""
        return measurement.values[f"{self.name}_{self.unit}"].value

    def sigma(self, measurement: Measurement) -> float:
        """Published standard deviation of a valid measurement; NaN if unknown."""
        return measurement.values[f"{self.name}_{self.unit}"].sigma or math.nan

    def true(self, pose: BeamPose) -> float:
        """True value in the simulator."""
        return float(getattr(pose, f"{self.name}_{self.unit}"))


QUANTITIES = (
    Quantity("x", "mm", 3),
    Quantity("y", "mm", 3),
    Quantity("yaw", "deg", 4),
    Quantity("pitch", "deg", 4),
)


class _Squares:
    """Root mean square of a series of numbers."""

    def __init__(self) -> None:
        self._sum = 0.0
        self._count = 0

    def add(self, value: float) -> None:
        self._sum += value * value
        self._count += 1

    @property
    def rms(self) -> float:
        return math.sqrt(self._sum / self._count) if self._count else math.nan


def truth_of(unit: Unit, measurement: Measurement) -> BeamPose:
    """True value of a measurement: the machine's path at its time, without the drive's vibration.

    A controller steers by the machine's position, not by its vibration. The measurement is the mean over its
    window's frame sets, and its time is their middle. On a path that is straight for a second that mean
    equals the position at the middle (a curve of 20 mm in 3 minutes is off by 1 µm), so the path at that time
    is the truth. The vibration left in the mean is an error of the measurement, and its sigma, taken from the
    scatter of the frame sets, must cover it.
    """
    return unit.truth(measurement.t_ns, vibration=False)


class Figures:
    """Statistics of one run; every measurement is counted once, through a separate cursor."""

    def __init__(self, daemon: Daemon, unit: Unit, runs_here: str = "daemon and simulator together") -> None:
        self._daemon = daemon
        self._runs_here = runs_here
        self._unit = unit
        self._began_s = time.monotonic()
        self._cpu_began_s = time.process_time()
        self._differences = {quantity: _Squares() for quantity in QUANTITIES}
        self._in_sigmas = {quantity: _Squares() for quantity in QUANTITIES}
        self._last_sequence = -1
        self.frame_sets = 0
        """Frame sets that led to a measurement on the board, valid or not."""
        self.valid = 0
        self.settled_mib = math.nan

    async def follow(self) -> None:
        """Count every measurement until cancelled."""
        cursor = self._daemon.board.cursor()
        skipped = 0
        while True:
            measurement = await cursor.next()
            self.take(measurement, cursor.skipped - skipped)
            skipped = cursor.skipped

    def take(self, measurement: Measurement, skipped: int) -> None:
        """Count one measurement; ``skipped`` is the number of earlier measurements that were missed."""
        if measurement.sequence <= self._last_sequence:
            return  # silent cameras expose no frame set
        self._last_sequence = measurement.sequence
        self.frame_sets += 1 + skipped
        if not measurement.valid:
            return
        self.valid += 1 + skipped
        truth = truth_of(self._unit, measurement)
        for quantity in QUANTITIES:
            difference = quantity.measured(measurement) - quantity.true(truth)
            self._differences[quantity].add(difference)
            self._in_sigmas[quantity].add(difference / quantity.sigma(measurement))

    @property
    def seconds(self) -> float:
        """Time since the daemon was started."""
        return time.monotonic() - self._began_s

    @property
    def cpu_share(self) -> float:
        """CPU share of this process since the daemon was started; 1 is one core."""
        return (time.process_time() - self._cpu_began_s) / self.seconds

    @property
    def frames_dropped(self) -> int:
        """Frames that replaced an unused frame before pairing, or arrived too late for a frame set."""
        counters = self._counters("measuring")
        return counters.get("late_frames", 0) + sum(counters.get(f"dropped_{name}", 0) for name in CAMERAS)

    @property
    def pairs_lost(self) -> int:
        """Frame sets without a measurement from both frames, as the pairing counts them."""
        return self._daemon.chain.pairer.lost_pairs

    def note_memory(self) -> None:
        """Record the memory once it has settled; to be called regularly."""
        if math.isnan(self.settled_mib) and self.seconds >= MEMORY_SETTLED_S:
            self.settled_mib = memory_mib()

    def summary(self) -> Iterator[str]:
        """Summary of the run in a few lines."""
        settled = (
            ""
            if math.isnan(self.settled_mib)
            else f"{self.settled_mib:.1f} MiB after {MEMORY_SETTLED_S:g} s, "
        )
        share = f"{self.valid / self.frame_sets:.1%}" if self.frame_sets else "none"
        yield (
            f"{self.seconds:.1f} s, {counted(self.frame_sets, 'exposure')} measured, "
            f"{counted(self.pairs_lost, 'pair')} lost, {counted(self.frames_dropped, 'frame')} dropped"
        )
        yield f"valid: {self.valid} ({share}; the first half second only warms up)"
        yield (
            f"memory: {settled}{memory_mib():.1f} MiB at the end; "
            f"CPU: {self.cpu_share:.0%} of one core, {self._runs_here}"
        )
        yield "rms of          difference   difference / sigma"
        for quantity in QUANTITIES:
            yield (
                f"  {quantity.name:<6}{self._differences[quantity].rms:>14.{quantity.decimals + 1}f} "
                f"{quantity.unit:<4}{self._in_sigmas[quantity].rms:>13.2f}"
            )

    def _counters(self, component: str) -> Mapping[str, int]:
        return self._daemon.health.component(component).counters


def memory_mib() -> float:
    """Resident memory of this process."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGESIZE") / 2**20
