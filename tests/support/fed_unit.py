"""A simulated unit for the guest: its calibration, and frames of a beam at rest to feed to video devices."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hw_sim.beam import BeamPose
from hw_sim.unit import CAMERAS, Unit, UnitConfig
from support.unit_toml import unit_toml

POSE = BeamPose(x_mm=12.0, y_mm=-7.0, slope_x=0.026, slope_y=-0.035)
"""What the unit is to measure: the truth of every frame."""


def render(seed: int, folder: Path, exposures: int) -> Path:
    """Expose the unit's cameras so often; returns the file of frames, (exposures, cameras, rows, columns)."""
    unit = Unit(UnitConfig(seed=seed))
    unit.place(POSE)
    frames = [
        [unit.expose(camera, number, number * unit.config.period_ns).pixels for camera in CAMERAS]
        for number in range(exposures)
    ]
    path = folder / "frames.npy"
    np.save(path, np.array(frames))
    return path


_MORE = """\
[measuring]
pair_by = "time"

[modbus_tcp]
host = "127.0.0.1"
port = 502

[http]
host = "127.0.0.1"
port = 8080
"""


def write_config(path: Path, seed: int, calibration: Path, fps: float) -> Path:
    """A unit with two Video4Linux cameras, on the network of its own machine alone."""
    front, rear = (
        f'driver = "v4l2"\ndevice = "/dev/v4l/by-path/{name}"\nfps = {fps}' for name in ("front", "rear")
    )
    path.write_text(unit_toml(f"SIM-{seed}", calibration, front, rear, _MORE))
    return path
