"""The material: frame pairs of a simulated, moving and vibrating unit, rendered before anything is timed."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from altd.calibration.calibrating import calibrate
from altd.calibration.file import save_calibration
from altd.config import Config, HttpSettings, ModbusTcpSettings, Target, TelegramPortSettings, Unit
from altd.measuring.calibration import Calibration
from altd.recording.reader import open_recording
from altd.records import Frame
from hw_sim import unit as simulated
from hw_sim.beam import BeamPose
from hw_sim.flat import record_flat
from hw_sim.motion import Drive, Vibration
from hw_sim.recording import recording
from hw_sim.scan import record_scan
from hw_sim.stage import Stage

SEED = 1
FPS = 20.0
WINDOW = 20
FLAT_EXPOSURES = 8
CAMERAS = simulated.CAMERAS


@dataclass(frozen=True, slots=True)
class Material:
    """Pairs (front, rear) one period apart, and the calibration of the unit that they come from.

    ``calibration`` was made with flats, ``without_flats`` from the same scan alone.
    """

    pairs: tuple[tuple[Frame, Frame], ...]
    calibration: Calibration
    without_flats: Calibration

    def pair(self, sequence: int, t_ns: int) -> tuple[Frame, Frame]:
        """Frame set number ``sequence`` of an endless run: the pairs forth and back, so that no beam jumps.

        Each way is a playthrough of its own: its pictures come again by intent.
        """
        last = len(self.pairs) - 1
        front, rear = self.pairs[last - abs(last - sequence % (2 * last))]
        way = sequence // last
        return (
            replace(front, sequence=sequence, t_ns=t_ns, playthrough=way),
            replace(rear, sequence=sequence, t_ns=t_ns, playthrough=way),
        )


def make_material(pairs: int, exposures_a_node: int) -> Material:
    """Render the pairs and calibrate their unit by a scan of its own."""
    rendered = make_pairs(pairs)
    with tempfile.TemporaryDirectory(prefix="altd-bench-") as folder:
        scan = Path(folder, "scan")
        still = simulated.Unit(simulated.UnitConfig(seed=SEED))
        stage = Stage(np.random.default_rng(SEED))
        record_scan(scan, still, stage, exposures_a_node, lambda done, planned: None)
        flat = Path(folder, "flat")
        record_flat(flat, still, FLAT_EXPOSURES, lambda done, planned: None)
        scans = [open_recording(scan)]
        calibration = calibrate(scans, open_recording(flat)).calibration
        without_flats = calibrate(scans).calibration
    return Material(tuple(rendered), calibration, without_flats)


def make_pairs(count: int, pairs_per_s: float = FPS) -> list[tuple[Frame, Frame]]:
    """Pairs (front, rear) of the moving and shaking unit, from cameras of so many pairs a second."""
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


def make_config(
    modbus_port: int | None = None, http_port: int | None = None, telegram: Path | None = None
) -> Config:
    """An ordinary unit's config; the cameras are handed to the daemon by who makes it."""
    local = "127.0.0.1"
    return Config(
        unit=Unit(serial=f"SIM-{SEED}", calibration=Path("in-memory")),
        targets=(
            Target(name="front", z_mm=0.0, camera="front"),
            Target(name="rear", z_mm=280.0, camera="rear"),
        ),
        modbus_tcp=ModbusTcpSettings(host=local, port=modbus_port) if modbus_port else None,
        http=HttpSettings(host=local, port=http_port) if http_port else None,
        serial=(TelegramPortSettings(device=telegram, speaks="telegram", baud=115200, interval_s=0.1),)
        if telegram
        else (),
    )


def write_run_folder(folder: Path, calibration: Calibration, http_port: int, exposures: int) -> Path:
    """A config for ``altd run`` that plays a recording in real time, with all that it needs beside it."""
    still = simulated.Unit(simulated.UnitConfig(seed=SEED))
    with recording(folder / "recording", still, "measurement", exposures, lambda done, planned: None) as made:
        for _ in range(exposures):
            made.expose(BeamPose(4.0, -3.0, 0.02, -0.03))
    save_calibration(calibration, folder / "calibration.json")
    config = folder / "altd.toml"
    config.write_text(
        f'[unit]\nserial = "SIM-{SEED}"\ncalibration = "calibration.json"\n'
        f'[http]\nhost = "127.0.0.1"\nport = {http_port}\n'
        + "".join(
            f'[[targets]]\nname = "{name}"\nz_mm = {z_mm}\ncamera = "{name}"\n'
            f'[cameras.{name}]\ndriver = "recording"\npath = "recording"\nrepeat = true\n'
            for name, z_mm in (("front", 0.0), ("rear", 280.0))
        )
    )
    return config
