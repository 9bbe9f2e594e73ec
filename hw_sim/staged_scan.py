"""``python -m hw_sim scan --stage``: altd's own scan of a simulated unit, its table on a pseudo-terminal.

It works as with a real unit: ``altd scan`` controls the table, which moves the laser, over Grbl, and takes
the frames that the cameras deliver meanwhile. An interrupted scan is resumed like a real one.
"""

from pathlib import Path

import numpy as np

from altd.app.record import scanner_of
from altd.cli.scan import ScanScreen, run_scan
from altd.config import Config, GrblStageSettings, Scan, Target
from altd.config import Unit as UnitTable
from hw_sim.camera import make_cameras
from hw_sim.grbl_table import GrblTable
from hw_sim.hardness import Hardness
from hw_sim.scan import STAGE_STREAM
from hw_sim.unit import FRONT, REAR, Unit, UnitConfig


class SimulatedLamps:
    """The frame LEDs of a simulated unit; see ``altd.ports.Lamps``."""

    def __init__(self, unit: Unit) -> None:
        self._unit = unit

    def open(self) -> None:
        """Switch the LEDs off."""
        self._unit.leds_on = False

    def switch(self, on: bool) -> None:
        """Switch the LEDs on or off, from the next frame set on."""
        self._unit.leds_on = on

    def close(self) -> None:
        """Switch the LEDs off."""
        self._unit.leds_on = False


def scan_config(unit: Unit, device: Path, scan: Scan) -> Config:
    """Config of an ordinary unit whose stage is at ``device``."""
    return Config(
        unit=UnitTable(serial=unit.config.serial, calibration=Path("calibration.json")),
        targets=(
            Target(name=FRONT, z_mm=0.0, camera=FRONT),
            Target(name=REAR, z_mm=unit.config.target_distance_mm, camera=REAR),
        ),
        stage=GrblStageSettings(driver="grbl", device=device, feed_mm_per_min=6000.0),
        scan=scan,
    )


def staged_scan(folder: Path, seed: int, frame_sets: int, hard: Hardness | None = None) -> int:
    """Scan the unit of ``seed`` with its table into ``folder``; return the status; raises BadInputError."""
    unit = Unit(UnitConfig(seed=seed, hard=hard))
    with GrblTable(unit, np.random.default_rng([seed, STAGE_STREAM])) as table:
        config = scan_config(unit, table.device, Scan(exposures=frame_sets, settle_s=0.2))
        cameras = {camera.name: camera for camera in make_cameras(unit)}
        screen = ScanScreen("hw_sim")
        scanner = scanner_of(config, folder, folder, screen, cameras, SimulatedLamps(unit))
        return run_scan(scanner, folder, screen)
