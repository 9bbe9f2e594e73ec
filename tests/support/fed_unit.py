"""A simulated unit for the guest: its calibration, and frames of a beam at rest to feed to video devices."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hw_sim.beam import BeamPose
from hw_sim.unit import CAMERAS, Unit, UnitConfig
from support.cli import altd

POSE = BeamPose(x_mm=12.0, y_mm=-7.0, slope_x=0.026, slope_y=-0.035)
"""What the unit is to measure: the truth of every frame."""


def calibrate(seed: int, folder: Path) -> Path:
    """Scan and calibrate the unit as a technician does; returns the calibration file."""
    calibration = folder / "calibration.json"
    assert altd("scan", "-o", folder / "scan", "--seed", seed, module="hw_sim").status == 0
    assert altd("calibrate", folder / "scan", "-o", calibration).status == 0
    return calibration


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


CONFIG = """
[unit]
serial = "SIM-{seed}"
calibration = "{calibration}"

[[targets]]
name = "front"
z_mm = 0.0
camera = "front"

[[targets]]
name = "rear"
z_mm = 280.0
camera = "rear"

[cameras.front]
driver = "v4l2"
device = "/dev/v4l/by-path/front"
fps = {fps}

[cameras.rear]
driver = "v4l2"
device = "/dev/v4l/by-path/rear"
fps = {fps}

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
    path.write_text(CONFIG.format(seed=seed, calibration=calibration, fps=fps))
    return path
