"""A simulated unit on the bench: recorded by ``hw_sim``, calibrated and measured by altd's command line."""

import contextlib
import io
import json
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from altd.cli.main import main as altd
from altd.records import FloatArray
from hw_sim.beam import BeamPose
from hw_sim.flat import record_flat
from hw_sim.hardness import HARD
from hw_sim.measure import record_measurement
from hw_sim.recording import Progress as Exposures
from hw_sim.scan import STAGE_STREAM, USUAL, Grid, record_scan
from hw_sim.stage import Stage
from hw_sim.unit import Unit
from studies.result import HARDER, Progress

SIMULATORS = {"": None, HARDER: HARD}
"""Endings of rows' names, each with the effects of the simulator that the rows are from."""

FLAT_EXPOSURES = 20
"""Lit, and as many dark: the simulator's own default."""

QUANTITIES = ("x_mm", "y_mm", "yaw_deg", "pitch_deg")


@dataclass(frozen=True, slots=True, eq=False)
class Readings:
    """Measurement lines as arrays, NaN in the rows of invalid ones.

    ``values`` and ``sigmas`` (n, 4): x mm, y mm, yaw °, pitch °; ``front_mm`` and ``rear_mm`` (n, 2);
    ``t_s`` (n,); ``reasons`` those of the invalid lines.
    """

    values: FloatArray
    sigmas: FloatArray
    front_mm: FloatArray
    rear_mm: FloatArray
    t_s: FloatArray
    reasons: tuple[str, ...]

    @property
    def valid(self) -> npt.NDArray[np.bool_]:
        """Whether each line holds a measurement, (n,)."""
        return np.asarray(np.isfinite(self.values).all(axis=1))


class Bench:
    """One unit's calibration, and recordings measured with it. Files live until the bench is closed."""

    def __init__(self, folder: Path, progress: Progress, what: str) -> None:
        self._folder = folder
        self._progress = progress
        self._what = what
        self._count = 0

    @property
    def calibration_file(self) -> Path:
        """The calibration, once it was made."""
        return self._folder / "calibration.json"

    def calibrate(self, unit: Unit, exposures: int = 2, *, flat: bool = False) -> dict[str, Any]:
        """Scan the unit, fit its maps (``altd calibrate``); the calibration file's content.

        With ``flat`` its targets are also recorded in even light, and the spots located through that.
        """
        more: tuple[object, ...] = ()
        if flat:
            evenly_lit = self._new("flat")
            record_flat(evenly_lit, unit, FLAT_EXPOSURES, self._exposures("flat"))
            more = ("--flat", evenly_lit)
        recording = self.scan(unit, exposures)
        content = self.calibrate_from(recording, *more)
        shutil.rmtree(recording)
        return content

    def scan(self, unit: Unit, exposures: int, grid: Grid = USUAL) -> Path:
        """A recording of the unit's scan."""
        recording = self._new("scan")
        stage = Stage(np.random.default_rng([unit.config.seed, STAGE_STREAM]))
        record_scan(recording, unit, stage, exposures, self._exposures("scan"), grid)
        return recording

    def calibrate_from(self, scan: Path, *more: object) -> dict[str, Any]:
        """Fit the maps of a scan (``altd calibrate``, with ``more`` arguments); the file's content."""
        self._progress(f"{self._what}: calibrate")
        run_altd("calibrate", scan, "-o", self.calibration_file, *more)
        content: dict[str, Any] = json.loads(self.calibration_file.read_text())
        return content

    def record(self, unit: Unit, poses: Sequence[BeamPose], exposures: int) -> Path:
        """A recording of the poses, back to back."""
        recording = self._new("poses")
        record_measurement(recording, unit, poses, exposures, self._exposures("measure"))
        return recording

    def replay(self, recording: Path, window: int, every: int) -> Readings:
        """Measurements of altd on a recording (``altd replay``)."""
        self._progress(f"{self._what}: replay")
        lines = run_altd(
            "replay", recording, "--calibration", self.calibration_file, "--window", window, "--every", every
        )
        return _readings([json.loads(line) for line in lines.splitlines()])

    def measure(self, unit: Unit, poses: Sequence[BeamPose], exposures: int) -> Readings:
        """One measurement a pose, each the mean of its exposures."""
        recording = self.record(unit, poses, exposures)
        readings = self.replay(recording, exposures, exposures)
        shutil.rmtree(recording)
        return readings

    def _new(self, kind: str) -> Path:
        self._count += 1
        return self._folder / f"{kind}-{self._count}"

    def _exposures(self, kind: str) -> Exposures:
        def show(done: int, planned: int) -> None:
            if done % 20 == 0:
                self._progress(f"{self._what}: {kind} {done}/{planned} exposures")

        return show


@contextlib.contextmanager
def bench(progress: Progress, what: str) -> Iterator[Bench]:
    """A bench whose files are gone at the end."""
    with tempfile.TemporaryDirectory(prefix="hw_sim-study-") as folder:
        yield Bench(Path(folder), progress, what)


def run_altd(*arguments: object) -> str:
    """The output of an altd command. Raises RuntimeError when it fails; its complaint is on stderr."""
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        status = altd([str(argument) for argument in arguments])
    if status:
        raise RuntimeError(f"altd {arguments[0]} ended with status {status}")
    return out.getvalue()


def truth_of(poses: Sequence[BeamPose]) -> FloatArray:
    """X mm, y mm, yaw °, pitch ° of the poses, (n, 4)."""
    return np.array([(pose.x_mm, pose.y_mm, pose.yaw_deg, pose.pitch_deg) for pose in poses])


def rms(values: FloatArray) -> float:
    """Root of the mean square of what is not NaN."""
    return float(np.sqrt(np.nanmean(np.square(values))))


def pooled_std(values: FloatArray) -> FloatArray:
    """Standard deviation of repeated readings (places, repeats, quantities), pooled over the places.

    A place where a reading is missing, NaN, does not count.
    """
    whole = values[np.isfinite(values).all(axis=(1, 2))]
    return np.asarray(np.sqrt(whole.var(axis=1, ddof=1).mean(axis=0)))


def _readings(lines: Sequence[dict[str, Any]]) -> Readings:
    def pair(line: dict[str, Any], target: str) -> tuple[float | None, float | None]:
        point = line.get(target) or {}
        return point.get("x_mm"), point.get("y_mm")

    return Readings(
        values=_array([[line[name] for name in QUANTITIES] for line in lines]),
        sigmas=_array([[line["sigma"][name] for name in QUANTITIES] for line in lines]),
        front_mm=_array([pair(line, "front") for line in lines]),
        rear_mm=_array([pair(line, "rear") for line in lines]),
        t_s=_array([line["t_s"] for line in lines]),
        reasons=tuple(reason for line in lines if not line["valid"] for reason in line["status"]),
    )


def _array(values: object) -> FloatArray:
    """Numbers with None as NaN."""
    return np.array(values, dtype=np.float64)
