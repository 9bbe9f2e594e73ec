"""Exposure control on simulated cameras in their own time: located and controlled as in the daemon."""

import asyncio
from dataclasses import replace

import numpy as np
import pytest
from support.clock import stop
from support.measurements import beam_chain, beam_of
from support.unit_toml import TARGETS

from altd.acquisition.auto_exposure.control import ExposureControl, Refused
from altd.acquisition.auto_exposure.rule import HIGH, LOW, Content, sample_brightness
from altd.acquisition.locating import locate_frame
from altd.app.daemon import Daemon
from altd.config import Config, ExposureSettings, Measuring
from altd.instruments.beam.solver import Beam
from altd.measuring.calibration import Calibration
from altd.measuring.spot_locator import Located
from altd.reasons import Reason
from altd.records import Frame, Measurement, NoSpot, Spot
from hw_sim.beam import BeamPose, Laser
from hw_sim.camera import make_cameras
from hw_sim.faults import Fault
from hw_sim.unit import CAMERAS, FRONT, REAR, Unit, UnitConfig

WINDOW = 20
POSE = BeamPose(20.3, 11.2, 0.02, -0.03)
LARGEST_ERROR_MM = 0.03
"""Of one window, as test_accuracy.py demands it at the exposure of the calibration."""


class Loop:
    """The simulated unit with seed 3, measured with its exposure under control.

    A camera that reports nothing represents one without chunk data, which uses a setting two frames late.
    """

    def __init__(
        self,
        calibration: Calibration,
        power_mw: float = 3.0,
        lux: float = 200.0,
        bits: int = 8,
        start_ms: float = 2.0,
        tells: bool = True,
        longest_ms: float = 20.0,
    ) -> None:
        self.unit = Unit(UnitConfig(seed=3, lux=lux, bits=bits, laser=Laser(power_mw=power_mw)))
        self.unit.place(POSE)
        settings = ExposureSettings(exposure_ms=start_ms, longest_ms=longest_ms)
        self.exposure = {name: ExposureControl(settings, 20.0, WINDOW) for name in CAMERAS}
        self.chain = beam_chain(calibration, Measuring(window=WINDOW, pair_by="time"))
        self.cameras = make_cameras(self.unit, real_time=False)
        for camera in self.cameras:
            camera.open()
            self.exposure[camera.name].opened(camera)
        self.tells = tells
        self.seen: list[tuple[int, Frame, Spot | NoSpot]] = []
        self.measured: list[tuple[int, Measurement]] = []
        self.number = 0
        self._on_the_way: dict[str, list[Frame]] = {name: [] for name in CAMERAS}

    def run(self, exposures: int) -> int:
        """Take so many; returns the number of the first of them."""
        first = self.number
        for _ in range(exposures):
            for camera in self.cameras:
                exposure = self.exposure[camera.name]
                if exposure.is_due:
                    assert not isinstance(exposure.apply(camera), Refused)
                taken = exposure.mark(self._next(camera.name))
                for pair in self.chain.pairer.add(taken.camera, taken.sequence, taken.t_ns, taken):
                    measurement = self.chain.add(pair.converted(self.located))
                    self.measured += [(self.number, measurement)] if measurement else []
            self.number += 1
        return first

    def located(self, frame: Frame) -> Located:
        located = locate_frame(frame, self.chain.locators[frame.camera], self.exposure[frame.camera])
        if located.found is not None:
            self.seen.append((self.number, frame, located.found))
        return located

    def set_power(self, power_mw: float) -> None:
        self.unit.config = replace(self.unit.config, laser=Laser(power_mw=power_mw))

    def changes(self) -> list[int]:
        figures = [self.exposure[name].figures for name in CAMERAS]
        return [0 if known is None else known.changes for known in figures]

    def exposures_until_valid(self, since: int) -> int:
        """After how many exposures from ``since`` on every measurement is valid."""
        invalid = [number for number, m in self.measured if number >= since and not m.valid]
        return max(invalid) + 1 - since if invalid else 0

    def beams(self, since: int) -> list[Beam]:
        return [beam_of(m) for number, m in self.measured if number >= since and beam_of(m) is not None]

    def check_well(self, since: int) -> None:
        """From ``since`` on all is valid, in the band, nowhere clipped, and accurate."""
        assert self.exposures_until_valid(since) == 0
        for number, taken, spot in self.seen:
            if number >= since:
                sample = sample_brightness(taken, spot)
                assert sample.content is Content.SPOT
                assert LOW - 0.04 <= sample.level <= HIGH + 0.04
        errors = [(b.x_mm - POSE.x_mm, b.y_mm - POSE.y_mm) for b in self.beams(since)]
        assert np.abs(errors).max() <= LARGEST_ERROR_MM

    def _next(self, name: str) -> Frame:
        camera = next(camera for camera in self.cameras if camera.name == name)
        taken = camera.next_frame(1.0)
        if self.tells:
            return taken
        waiting = self._on_the_way[name]
        waiting.append(replace(taken, exposure_ms=None, gain_db=None))
        late = waiting.pop(0) if len(waiting) > 2 else waiting[0]
        return replace(late, sequence=taken.sequence, t_ns=taken.t_ns)


@pytest.mark.parametrize(
    ("power_mw", "lux", "bits", "start_ms"),
    [
        (1.0, 0.0, 8, 0.02),
        (1.0, 1000.0, 12, 20.0),
        (1.0, 200.0, 8, 20.0),
        (3.0, 0.0, 12, 20.0),
        (3.0, 1000.0, 8, 0.02),
        (5.0, 0.0, 8, 20.0),
        (5.0, 1000.0, 8, 20.0),
        (5.0, 200.0, 12, 0.02),
    ],
)
def test_it_settles_from_both_ends_and_then_rests(
    calibration_of_unit_3: Calibration, power_mw: float, lux: float, bits: int, start_ms: float
) -> None:
    loop = Loop(calibration_of_unit_3, power_mw, lux, bits, start_ms)
    loop.run(30)
    settled = loop.changes()
    assert max(settled) <= 4
    loop.run(40)
    assert loop.changes() == settled
    loop.check_well(since=30)


def test_a_camera_that_tells_nothing_and_lags_settles_too(calibration_of_unit_3: Calibration) -> None:
    loop = Loop(calibration_of_unit_3, start_ms=20.0, tells=False)
    loop.run(45)
    settled = loop.changes()
    loop.run(40)
    assert loop.changes() == settled
    loop.check_well(since=45)


def test_where_the_exposure_may_not_be_longer_gain_does_it_and_goes_first(
    calibration_of_unit_3: Calibration,
) -> None:
    loop = Loop(calibration_of_unit_3, power_mw=1.0, start_ms=1.0, longest_ms=1.0)
    loop.run(60)
    loop.check_well(since=40)
    dim = [loop.exposure[name].setpoint for name in CAMERAS]
    assert [setting.exposure_ms for setting in dim] == [1.0, 1.0]
    assert all(6.0 < setting.gain_db < 12.0 for setting in dim)
    loop.set_power(5.0)
    loop.run(100)
    loop.check_well(since=140)
    bright = [loop.exposure[name].setpoint for name in CAMERAS]
    assert all(setting.gain_db == 0.0 and setting.exposure_ms < 1.0 for setting in bright)


@pytest.mark.parametrize(("before_mw", "after_mw"), [(1.0, 5.0), (5.0, 1.0), (3.0, 1.0), (2.0, 5.0)])
def test_a_step_of_the_laser_s_power_is_followed_and_costs_less_than_two_seconds(
    calibration_of_unit_3: Calibration, before_mw: float, after_mw: float
) -> None:
    loop = Loop(calibration_of_unit_3, before_mw)
    loop.run(50)
    loop.set_power(after_mw)
    step = loop.run(60)
    settled = loop.changes()
    loop.run(40)
    assert loop.changes() == settled
    loop.check_well(since=step + 60)
    assert sum(not m.valid for number, m in loop.measured if number >= step) <= 40
    errors = [(b.x_mm - POSE.x_mm, b.y_mm - POSE.y_mm) for b in loop.beams(30)]
    assert np.abs(errors).max() <= LARGEST_ERROR_MM  # while it changes, too


@pytest.mark.parametrize(
    ("off", "power_mw", "lux"), [(20, 1.0, 0.0), (20, 5.0, 1000.0), (100, 1.0, 1000.0), (100, 5.0, 0.0)]
)
def test_a_laser_that_was_off_is_measured_within_two_seconds(
    calibration_of_unit_3: Calibration, off: int, power_mw: float, lux: float
) -> None:
    loop = Loop(calibration_of_unit_3, lux=lux)
    loop.run(50)
    settled = loop.changes()
    loop.unit.inject(Fault.NO_LASER)
    dark = loop.run(off)
    searched = loop.changes()
    assert (searched == settled) is (off < 2 * WINDOW)  # one that blinks finds all as it was
    assert all(m.valid is False for number, m in loop.measured if number >= dark + 3)
    loop.unit.clear()
    loop.set_power(power_mw)
    back = loop.run(80)
    loop.check_well(since=back + 40)


def test_while_the_laser_is_off_the_search_ends(calibration_of_unit_3: Calibration) -> None:
    loop = Loop(calibration_of_unit_3, lux=1000.0)
    loop.unit.inject(Fault.NO_LASER)
    loop.run(100)
    searched = loop.changes()
    loop.run(60)
    assert loop.changes() == searched
    last = [m for _, m in loop.measured][-1]
    assert {fault.reason for fault in last.status} - {Reason.SIMULATED} == {Reason.SPOT_MISSING}


def test_a_flooded_picture_is_exposed_less_and_all_is_well_when_the_flood_ends(
    calibration_of_unit_3: Calibration,
) -> None:
    loop = Loop(calibration_of_unit_3)
    loop.run(50)
    loop.unit.inject(Fault.WHITE)
    loop.run(100)
    lowest = [loop.exposure[name].setpoint.exposure_ms for name in CAMERAS]
    assert all(0.02 <= exposure_ms < 0.02 * 1.05 for exposure_ms in lowest), (
        "a change by less than 5 % is none"
    )
    loop.unit.clear()
    back = loop.run(80)
    loop.check_well(since=back + 40)


def test_a_beam_that_wanders_over_the_targets_changes_nothing(calibration_of_unit_3: Calibration) -> None:
    """Print, fall-off and speckle move the level; the band must hold them."""
    loop = Loop(calibration_of_unit_3)
    loop.run(50)
    settled = loop.changes()
    for x_mm in np.linspace(-50.0, 50.0, 120):
        loop.unit.place(BeamPose(float(x_mm), 0.6 * float(x_mm), 0.0, 0.0))
        loop.run(1)
    assert loop.changes() == settled


async def test_the_daemon_controls_its_live_cameras_and_shows_it_in_health(
    calibration_of_unit_3: Calibration,
) -> None:
    camera = {"driver": "aravis", "device": "stands for the simulated one", "exposure": {"exposure_ms": 20.0}}
    config = Config.model_validate(
        {
            "unit": {"serial": "SIM-3", "calibration": "unused.json"},
            "targets": TARGETS,
            "cameras": {FRONT: camera, REAR: camera},
            "measuring": {"pair_by": "time"},
        }
    )
    unit = Unit(UnitConfig(seed=3))
    cameras = {camera.name: camera for camera in make_cameras(unit)}
    daemon = Daemon(config, calibration_of_unit_3, cameras, rehearsal=True)
    running = asyncio.create_task(daemon.run())
    board = daemon.board.cursor()
    async with asyncio.timeout(30):
        while not (await board.next()).valid:
            pass
    await stop(running)
    for name in CAMERAS:
        health = daemon.health.component(f"camera {name}")
        assert health.figures["exposure_control"] == "auto"
        assert LOW - 0.04 <= float(health.figures["level"]) <= HIGH + 0.04
        assert 0.5 < float(health.figures["exposure_ms"]) < 3.0
        assert health.counters["exposure_changes"] >= 2
