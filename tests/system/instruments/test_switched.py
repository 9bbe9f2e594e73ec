"""A unit with a switched front target: scanned, calibrated, measured, replayed; beside one of two cameras."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from support.cli import altd_here
from support.made_once import loaded_once

from altd.app.daemon import Daemon
from altd.app.record import scanner_of
from altd.calibration.calibrating import calibrate
from altd.calibration.file import save_calibration
from altd.config import Config, KeptFrames, Scan, SelfCheckSettings, Target
from altd.config import Unit as UnitTable
from altd.devices.gpio import GpiodSwitchesSettings
from altd.measuring.calibration import Calibration
from altd.recording.reader import open_recording
from altd.records import Measurement
from hw_sim.beam import BeamPose
from hw_sim.camera import RealTimeLamps, make_cameras
from hw_sim.grbl_table import GrblTable
from hw_sim.motion import Vibration
from hw_sim.row.front_glass import FrontGlass
from hw_sim.row.glass import GlassConfig
from hw_sim.staged_scan import SimulatedLamps, scan_config
from hw_sim.unit import CAMERAS, FRONT, REAR, Unit, UnitConfig
from studies.bench import rms
from studies.switched import SWITCHED, TWO, calibration_of, errors_of, measurements_of

SEED = 303
POSE = BeamPose(18.0, -11.0, 0.03, -0.05)
GLASS = GlassConfig()
SWITCHES = GpiodSwitchesSettings(
    driver="gpiod", chip="simulated", lines=("GLASS",), settle_s=0.4, exposures=5
)
TARGETS = (
    Target(name=FRONT, z_mm=0.0, camera=FRONT, switched=True),
    Target(name=REAR, z_mm=280.0, camera=REAR),
)


@pytest.fixture(scope="module")
def calibration() -> Calibration:
    return loaded_once(f"switched-{SEED}", partial(calibration_of, SEED, GLASS))


def codes(measurement: Measurement) -> set[str]:
    return {str(fault) for fault in measurement.status}


@pytest.mark.parametrize(("vibration", "limit"), [(None, 1.3), (Vibration(), 2.0)], ids=["rest", "shaking"])
def test_it_measures_nearly_as_well_as_a_unit_of_two_cameras(
    calibration: Calibration, vibration: Vibration | None, limit: float
) -> None:
    two = loaded_once(f"two-cameras-{SEED}", partial(calibration_of, SEED, None))
    of_two = errors_of(two, TWO, vibration, SEED, poses=6)
    of_glass = errors_of(calibration, SWITCHED, vibration, SEED, poses=6)
    assert rms(of_glass.errors[:, :2]) < limit * rms(of_two.errors[:, :2])
    assert 0.3 < rms(of_glass.ratios[:, :2]) < 1.4  # of twelve values


def test_a_slow_glass_is_named_and_gives_no_number(calibration: Calibration) -> None:
    unit = Unit(UnitConfig(seed=SEED, switched=replace(GLASS, slow=8.0)))
    unit.place(POSE)
    slow = [of for of in measurements_of(calibration, unit, SWITCHED, 1) if "front_slow" in codes(of)]
    assert slow
    assert not any(measurement.valid for measurement in slow)


class Running:
    """A daemon with a unit whose front glass it switches."""

    def __init__(self, config: Config, calibration: Calibration) -> None:
        self.unit = Unit(UnitConfig(seed=SEED, switched=GLASS))
        self.unit.place(POSE)
        lamps = RealTimeLamps()
        cameras = {camera.name: camera for camera in make_cameras(self.unit, lamps=lamps)}
        glass = FrontGlass(self.unit)
        self.daemon = Daemon(config, calibration, cameras, lamps=lamps, rehearsal=True, switches=glass)

    async def run(self, during: Callable[[Running], Awaitable[None]]) -> None:
        running = asyncio.create_task(self.daemon.run())
        try:
            async with asyncio.timeout(120.0):
                await during(self)
        finally:
            running.cancel()
            await asyncio.gather(running, return_exceptions=True)

    async def until(self, condition: Callable[[Measurement], bool]) -> Measurement:
        cursor = self.daemon.board.cursor()
        while not condition(measurement := await cursor.next()):
            pass
        return measurement


@pytest.mark.real_time
async def test_the_daemon_switches_the_glass_checks_itself_and_keeps_frames_that_replay(
    calibration: Calibration, tmp_path: Path
) -> None:
    path = tmp_path / "cal.json"
    save_calibration(calibration, path)
    config = Config(
        unit=UnitTable(serial=calibration.unit_serial, calibration=path),
        targets=TARGETS,
        switches=SWITCHES,
        self_check=SelfCheckSettings(exposures=2),
        kept_frames=KeptFrames(folder=tmp_path / "kept", before_s=25.0, after_s=0.0, on_fault=False),
    )

    async def during(running: Running) -> None:
        measurement = await running.until(lambda measurement: measurement.valid)
        for key, deg in (("yaw_deg", POSE.yaw_deg), ("pitch_deg", POSE.pitch_deg)):
            value = measurement.values[key]
            assert abs(value.value - deg) < 4.0 * (value.sigma or 0.0)
        check = running.daemon.unit.self_check
        await running.until(lambda _: check.latest is not None)
        assert check.latest is not None
        assert check.latest.check.verdict == "good", check.latest
        await running.until(lambda of: of.valid and of.sequence > measurement.sequence + 300)
        await running.daemon.unit.recordings.provider.keep("test")
        assert running.unit.glass is not None
        running.unit.glass.config = replace(GLASS, stuck="opaque")
        stuck = await running.until(lambda measurement: "front_stuck_opaque" in codes(measurement))
        assert codes(stuck) == {"rear_spot_missing", "front_stuck_opaque", "simulated", "rehearsal"}
        assert stuck.values == {}

    await Running(config, calibration).run(during)
    (kept,) = filter(Path.is_dir, (tmp_path / "kept").iterdir())
    replayed = altd_here("replay", kept, "--calibration", path)
    assert replayed.status == 0, replayed.err
    valid = [line for line in replayed.objects if line["valid"]]
    assert valid
    assert all(abs(line["yaw_deg"] - POSE.yaw_deg) < 5.0 * line["sigma"]["yaw_deg"] for line in valid)


async def test_the_scan_shows_each_target_in_turn_and_calibrates_it(tmp_path: Path) -> None:
    unit = Unit(UnitConfig(seed=SEED, switched=GLASS))
    small = Scan(columns=4, rows=4, pitch_mm=25.0, exposures=1, settle_s=0.02, led_pairs=0)
    with GrblTable(unit, np.random.default_rng(1)) as table:
        config = scan_config(unit, table.device, small)
        assert config.stage is not None
        stage = config.stage.model_copy(update={"feed_mm_per_min": 100_000.0})
        config = config.model_copy(update={"stage": stage, "targets": TARGETS, "switches": SWITCHES})
        cameras = {camera.name: camera for camera in make_cameras(unit)}
        scanner = scanner_of(
            config, tmp_path, tmp_path / "scan", _Quiet(), cameras, SimulatedLamps(unit), FrontGlass(unit)
        )
        result = await scanner.run()
    assert result.refused == ()
    assert result.exposures == 2 * 16
    recording = open_recording(tmp_path / "scan")
    assert recording.header.is_switched
    assert {len(list(recording.rows.of(camera))) for camera in CAMERAS} == {16}
    found = calibrate([recording]).calibration
    assert found.target_names == (FRONT, REAR)
    assert all(target.residual_max_mm < 0.05 for target in found.targets)


class _Quiet:
    def report(self, line: str) -> None:
        """Not shown."""

    def progress(self, done: int, total: int, doing: str) -> None:
        """Not shown."""
