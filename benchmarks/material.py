"""The material: frame pairs of a simulated, moving and vibrating unit, rendered before the measurement.

Cameras deliver it from memory, and record the delivery times.
"""

from __future__ import annotations

import tempfile
import threading
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from altd.calibration.calibrating import calibrate
from altd.config import Config, Target, Unit
from altd.measuring.calibration import Calibration
from altd.ports import CameraTimeoutError
from altd.recording.reader import open_recording
from altd.records import Frame, Origin
from benchmarks.harness import quiet
from hw_sim import unit as simulated
from hw_sim.beam import BeamPose
from hw_sim.flat import record_flat
from hw_sim.motion import Drive, Vibration
from hw_sim.scan import record_scan
from hw_sim.stage import Stage

SEED = 1
FPS = 20.0
WINDOW = 20
FLAT_EXPOSURES = 8
CAMERAS = simulated.CAMERAS


@dataclass(frozen=True, slots=True)
class Material:
    """Pairs (front, rear) one period apart, and the calibration of their unit.

    ``calibration`` was made with flats, ``without_flats`` from the same scan alone.
    """

    pairs: tuple[tuple[Frame, Frame], ...]
    calibration: Calibration
    without_flats: Calibration

    def pair(self, sequence: int, t_ns: int) -> tuple[Frame, Frame]:
        """Frame set number ``sequence`` of an endless run: the pairs back and forth, so that no beam jumps.

        Each pass is a separate playthrough, because its pictures repeat intentionally.
        """
        last = len(self.pairs) - 1
        pair = self.pairs[last - abs(last - sequence % (2 * last))]
        turn = sequence // last
        front, rear = (replace(each, sequence=sequence, t_ns=t_ns, playthrough=turn) for each in pair)
        return front, rear


def make_material(pairs: int, exposures_a_node: int) -> Material:
    """Render the pairs and calibrate their unit from its own scan."""
    rendered = make_pairs(pairs)
    with tempfile.TemporaryDirectory(prefix="altd-bench-") as folder:
        scan = Path(folder, "scan")
        still = simulated.Unit(simulated.UnitConfig(seed=SEED))
        stage = Stage(np.random.default_rng(SEED))
        record_scan(scan, still, stage, exposures_a_node, quiet)
        flat = Path(folder, "flat")
        record_flat(flat, still, FLAT_EXPOSURES, quiet)
        scans = [open_recording(scan)]
        calibration = calibrate(scans, open_recording(flat)).calibration
        without_flats = calibrate(scans).calibration
    return Material(tuple(rendered), calibration, without_flats)


def make_pairs(count: int, pairs_per_s: float = FPS) -> list[tuple[Frame, Frame]]:
    """Pairs (front, rear) of the moving and vibrating unit, at ``pairs_per_s``."""
    unit = simulated.Unit(
        simulated.UnitConfig(seed=SEED, fps=pairs_per_s, vibration=Vibration(), drive=Drive())
    )
    unit.place(BeamPose(4.0, -3.0, 0.02, -0.03))
    pairs = []
    for sequence in range(count):
        t_ns = sequence * unit.config.period_ns
        front, rear = (unit.expose(camera, sequence, t_ns) for camera in CAMERAS)
        pairs.append((front, rear))
    return pairs


def make_config(**tables: Any) -> Config:
    """Config of an ordinary unit with these tables; the caller passes the cameras to the daemon.

    Unknown tables are omitted, so that the same benchmark also measures an older altd.
    """
    return Config(
        unit=Unit(serial=f"SIM-{SEED}", calibration=Path("in-memory")),
        targets=(
            Target(name="front", z_mm=0.0, camera="front"),
            Target(name="rear", z_mm=280.0, camera="rear"),
        ),
        **{name: table for name, table in tables.items() if name in Config.model_fields},
    )


_LEAD_NS = 50_000_000
"""Time from the opening of the first camera to the first frame set; both threads wait by then."""


class Source:
    """One trigger for all cameras: frame set k at ``start + k`` periods. At 0 pairs/s there are no frames."""

    def __init__(self, material: Material, pairs_per_s: float) -> None:
        self.material = material
        self.period_ns = round(1e9 / pairs_per_s) if pairs_per_s else 0
        self.handed_ns: list[int] = []
        """Time at which the last frame of each frame set was delivered."""
        self._start_ns: int | None = None
        self._lock = threading.Lock()

    @property
    def cameras(self) -> dict[str, MemoryCamera]:
        """New cameras of this source, by name."""
        return {name: MemoryCamera(self, index) for index, name in enumerate(CAMERAS)}

    def start_ns(self) -> int:
        """Time of the exposure of frame set 0, fixed by the first call."""
        with self._lock:
            if self._start_ns is None:
                self._start_ns = time.monotonic_ns() + _LEAD_NS
            return self._start_ns

    def note(self, sequence: int) -> None:
        """Record the delivery of a frame of this frame set."""
        with self._lock:
            if sequence == len(self.handed_ns):
                self.handed_ns.append(0)
            self.handed_ns[sequence] = time.monotonic_ns()


class MemoryCamera:
    """Camera (``altd.ports.Camera``) that delivers late frames at once, as a driver's queue does."""

    waits = False
    origin = Origin.SIMULATED
    playback = False
    exposure_range = None
    identity = None

    def __init__(self, source: Source, index: int) -> None:
        self.name = CAMERAS[index]
        self._source = source
        self._index = index
        self._next = 0

    def open(self) -> None:
        """Open the camera."""
        self._source.start_ns()

    def next_frame(self, timeout_s: float) -> Frame:
        """The next frame, at its time; its pixels are shared, not copied."""
        source = self._source
        t_ns = source.start_ns() + self._next * source.period_ns
        wait_s = (t_ns - time.monotonic_ns()) * 1e-9
        if not source.period_ns or wait_s > timeout_s:
            time.sleep(timeout_s)
            raise CameraTimeoutError(f"{self.name}: nothing within {timeout_s:g} s")
        if wait_s > 0:
            time.sleep(max((t_ns - time.monotonic_ns()) * 1e-9, 0.0))
        frame = source.material.pair(self._next, t_ns)[self._index]
        source.note(self._next)
        self._next += 1
        return frame

    def set_exposure(self, exposure_ms: float, gain_db: float) -> None:
        """Do nothing; never called because there is no range."""

    def close(self) -> None:
        """Do nothing: there is nothing to release."""
