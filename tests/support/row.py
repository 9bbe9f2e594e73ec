"""Simulated rows of glass targets: calibrated from their scans, recorded, and replayed in this process."""

import json
import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from altd.app.row_replay import RowReplay
from altd.calibration.calibrating import calibrate
from altd.config import RowSettings
from altd.measuring.calibration import Calibration
from altd.recording.reader import open_recording
from hw_sim.beam import BeamPose
from hw_sim.row.record import record_rounds, record_scans
from hw_sim.row.row import Row, RowConfig
from support.made_once import loaded_once

SETTINGS = RowSettings(stable=("t1", "t5"), baseline_rounds=2)


@cache
def calibrated(seed: int, z_mm: tuple[float, ...] = RowConfig().z_mm) -> Calibration:
    """Of the row with that seed, by one scan a target."""
    return loaded_once(f"row-{seed}-{len(z_mm)}", partial(_calibrated, RowConfig(seed=seed, z_mm=z_mm)))


def _calibrated(config: RowConfig) -> Calibration:
    with TemporaryDirectory() as folder:
        scans = record_scans(Path(folder), Row(config))
        return calibrate([open_recording(path) for path in scans]).calibration


@dataclass
class Monitored:
    """Results and truth, round by round."""

    lines: list[dict[str, Any]]
    truth: dict[str, list[dict[str, tuple[float, float]]]]

    def statuses(self, number: int) -> set[str]:
        return set(self.lines[number]["status"])

    def target(self, number: int, name: str) -> dict[str, Any]:
        found: dict[str, Any] = self.lines[number]["targets"][name]
        return found

    def errors(self, names: tuple[str, ...], first: int) -> np.ndarray:
        """(dx, dy) minus truth of these targets from a round on, and their sigmas: rows of 4."""
        rows = []
        for line, moved in zip(self.lines[first:], self.truth["moved"][first:], strict=True):
            for name in names:
                of = line["targets"][name]
                if of["dx_mm"] is not None:
                    off = [of[f"d{axis}_mm"] - moved[name][k] for k, axis in enumerate("xy")]
                    rows.append([*off, of["sigma"]["dx_mm"], of["sigma"]["dy_mm"]])
        return np.array(rows)


def drifting(length_s: float) -> Callable[[float], BeamPose]:
    """A beam that drifts by 2 mm and 0.1 mrad in x, half of it in y, smoothly over that time."""

    def pose(t_s: float) -> BeamPose:
        share = 0.5 - 0.5 * math.cos(math.pi * min(max(t_s / length_s, 0.0), 1.0))
        return BeamPose(2.0 * share, share, 1e-4 * share, 0.5e-4 * share)

    return pose


def stepping(at_s: float, mm: tuple[float, float]) -> Callable[[float], tuple[float, float]]:
    """A place that moves at once."""
    return lambda t_s: mm if t_s >= at_s else (0.0, 0.0)


@dataclass
class Monitoring:
    """Recording and measurement of a row."""

    config: RowConfig = field(default_factory=RowConfig)
    rounds: int = 8
    settings: RowSettings = SETTINGS
    recorded: dict[str, Any] = field(default_factory=dict)
    spoil: Callable[[Path], None] = lambda path: None

    def run(self, folder: Path) -> Monitored:
        """Record and measure."""
        truth = record_rounds(folder / "rounds", Row(self.config), self.rounds, **self.recorded)
        self.spoil(folder / "rounds")
        recording = open_recording(folder / "rounds")
        names = self.config.names
        cameras = dict(zip(names, names, strict=True))
        replay = RowReplay(recording, calibrated(self.config.seed), self.settings, cameras)
        lines = [json.loads(json.dumps(replay.as_object(each))) for each in replay.measurements()]
        return Monitored(lines, truth)


def monitored(folder: Path, seed: int = 1, rounds: int = 8, **more: Any) -> Monitored:
    """A row at rest, but for what is given: keys of RowConfig."""
    return Monitoring(replace(RowConfig(seed=seed), **more), rounds).run(folder)
