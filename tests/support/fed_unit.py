"""A simulated unit for the guest: its calibration, and frames of a beam at rest to feed to video devices."""

from pathlib import Path

import numpy as np

from hw_sim.beam import BeamPose
from hw_sim.unit import CAMERAS, Unit, UnitConfig
from support.unit_toml import unit_toml

POSE = BeamPose(x_mm=12.0, y_mm=-7.0, slope_x=0.026, slope_y=-0.035)
"""The unit's task: the truth of every frame."""


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


def render_with_leds(seed: int, folder: Path, exposures: int) -> Path:
    """The same, with the frame LEDs off, and beside it as .npz what the lit LEDs change in these pictures.

    They change some pixels and no others, for an exposure has one noise. For each camera ``NAME_places``,
    (n,) of a flat picture, and ``NAME_lit``, (exposures, n), the grey values there.
    """
    path = render(seed, folder, exposures)
    dark = np.load(path)
    unit = Unit(UnitConfig(seed=seed))
    unit.place(POSE)
    unit.leds_on = True
    arrays = {}
    for index, camera in enumerate(CAMERAS):
        times_ns = [number * unit.config.period_ns for number in range(exposures)]
        lit = np.array([unit.expose(camera, number, t_ns).pixels for number, t_ns in enumerate(times_ns)])
        differs = (lit != dark[:, index]).any(axis=0)
        arrays[f"{camera}_places"] = np.flatnonzero(differs)
        arrays[f"{camera}_lit"] = lit[:, differs]
    np.savez(path.with_suffix(".npz"), **arrays)
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


def write_config(path: Path, seed: int, calibration: Path, fps: float, more: str = "") -> Path:
    """A unit with two Video4Linux cameras, on the network of its own machine alone; ``more`` are tables."""
    camera = 'driver = "v4l2"\ndevice = "/dev/v4l/by-path/{}"\nfps = {}'
    front, rear = (camera.format(name, fps) for name in ("front", "rear"))
    path.write_text(unit_toml(f"SIM-{seed}", calibration, front, rear, _MORE + more))
    return path
