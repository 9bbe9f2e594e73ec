"""The whole scan: altd drives a simulated Grbl table over a pseudo-terminal, simulated cameras look on."""

import asyncio
import itertools
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from support.scanning import QUICK_TABLE, nodes

from altd.acquisition import frame_sets
from altd.acquisition.scan.plan import Raster
from altd.acquisition.scan.scanner import ScanResult, ScanStoppedError
from altd.app.record import scanner_of
from altd.calibration.calibrating import calibrate
from altd.calibration.recorded_flat import flats_of
from altd.calibration.target_frames import target_frames
from altd.config import Scan
from altd.errors import BadInputError
from altd.mapping.inverse import InverseMap
from altd.recording.header import CameraHeader, RecordingHeader, UnitHeader
from altd.recording.reader import open_recording
from altd.recording.writer import RecordingWriter
from altd.records import Origin
from hw_sim.camera import make_cameras
from hw_sim.faults import Fault
from hw_sim.flat import record_flat
from hw_sim.grbl_table import GrblTable
from hw_sim.stage import Stage
from hw_sim.staged_scan import SimulatedLamps, scan_config
from hw_sim.unit import FRONT, REAR, Unit, UnitConfig

SMALL = Scan(columns=4, rows=4, pitch_mm=25.0, exposures=1, settle_s=0.02, led_pairs=0)


class Listener:
    """Keeps what the scan tells, and acts when it comes to a node."""

    def __init__(self) -> None:
        self.said: list[str] = []
        self.visited: list[str] = []
        self.at: dict[str, Callable[[], None]] = {}
        self.elsewhere: Callable[[], None] = lambda: None

    def report(self, line: str) -> None:
        self.said.append(line)

    def progress(self, done: int, total: int, doing: str) -> None:
        self.visited.append(doing)
        self.at.get(doing, self.elsewhere)()


async def scanned(
    unit: Unit, table: GrblTable, folder: Path, listener: Listener, scan: Scan = SMALL, **stage: object
) -> ScanResult:
    config = scan_config(unit, table.device, scan)
    assert config.stage is not None
    patient = {"answer_within_s": 20.0}  # a busy machine holds the table's thread up for seconds
    fast = config.stage.model_copy(update={"feed_mm_per_min": 100_000.0, **patient, **stage})
    config = config.model_copy(update={"stage": fast})
    cameras = {camera.name: camera for camera in make_cameras(unit)}
    return await scanner_of(config, folder, folder, listener, cameras, SimulatedLamps(unit)).run()


def mapped_mm(scan: Path, unit: Unit) -> np.ndarray:
    """The errors of a scan's calibration inside of the grid, against the simulator's lenses."""
    x_mm, y_mm = (a.ravel() for a in np.meshgrid(np.linspace(-44, 44, 25), np.linspace(-44, 44, 25)))
    mapped = []
    for target in calibrate([open_recording(scan)]).calibration.targets:
        px = np.column_stack(unit.imagers[target.name].view.lens.project(x_mm, y_mm))
        mapped.append(InverseMap(target.map).to_mm(px)[0] - np.column_stack([x_mm, y_mm]))
    return np.vstack(mapped)


def scan_directly(folder: Path, unit: Unit, scan: Scan) -> None:
    """The same grid without altd's scan: the beam is put there, and the frames are taken."""
    size = CameraHeader(width=752, height=480, bits=8)
    header = RecordingHeader(
        format="altd-recording/1",
        kind="scan",
        fps=20.0,
        cameras={FRONT: size, REAR: size},
        unit=UnitHeader(serial="SIM-11", target_distance_mm=280.0),
    )
    writer = RecordingWriter(folder, header)
    stage = Stage(np.random.default_rng(1))
    for number, (column, row, _) in enumerate(
        itertools.product(range(scan.columns), range(scan.rows), range(2))
    ):
        place = (column - 1.5) * scan.pitch_mm, (row - 1.5) * scan.pitch_mm
        if number % 2 == 0:
            unit.place(stage.place(*place))
        for camera in (FRONT, REAR):
            writer.write(unit.expose(camera, 5000 + number, 0), number, number / 20, place)
    writer.close()


async def test_the_scan_calibrates_as_well_as_one_without_a_stage(
    unit: Unit, table: GrblTable, tmp_path: Path
) -> None:
    listener = Listener()
    scan = Scan(columns=4, rows=4, pitch_mm=30.0, settle_s=0.02, led_pairs=2)
    result = await scanned(unit, table, tmp_path / "staged", listener, scan)
    assert result.refused == ()
    assert listener.said == [
        "no self-check: there is no calibration yet; the LED pairs of this scan will be its references"
    ]
    assert not unit.leds_on
    recording = open_recording(tmp_path / "staged")
    assert len(nodes(recording)) == 16
    pattern = [row.leds_on for row in recording.rows if row.position_mm is None and row.camera == REAR]
    assert pattern == [False, True] * 4
    assert [row.position_mm is None for row in recording.rows] == [True] * 8 + [False] * 64 + [True] * 8
    assert recording.header.note == "altd scan, simulated"
    assert {camera.origin for camera in recording.header.cameras.values()} == {Origin.SIMULATED}

    scan_directly(tmp_path / "direct", unit, scan)
    staged, direct = (mapped_mm(tmp_path / name, unit) for name in ("staged", "direct"))
    rms_staged, rms_direct, rms_between = (np.sqrt(np.mean(e**2)) for e in (staged, direct, staged - direct))
    assert rms_staged == pytest.approx(rms_direct, rel=0.1)
    assert rms_between < 0.003, "two stages of 0.002 mm and the noise of the frames"


async def test_a_unit_that_was_calibrated_is_checked_before_it_is_scanned_anew(
    unit_3: Path, quick_controller: None, tmp_path: Path
) -> None:
    unit, scan = Unit(UnitConfig(seed=3, fps=50.0)), SMALL.model_copy(update={"led_pairs": 2})
    unit.inject(Fault.REAR_CAMERA_MOVED)
    with GrblTable(unit, switches=False) as table:
        table.machine.settings |= QUICK_TABLE

        async def checked(listener: Listener) -> ScanResult:
            config = scan_config(unit, table.device, scan)
            calibrated = config.unit.model_copy(update={"calibration": unit_3 / "cal.json"})
            assert config.stage is not None
            stage = config.stage.model_copy(update={"feed_mm_per_min": 100_000.0, "start": "unlock"})
            config = config.model_copy(update={"unit": calibrated, "stage": stage})
            cameras = {camera.name: camera for camera in make_cameras(unit)}
            lamps = SimulatedLamps(unit)
            return await scanner_of(config, tmp_path, tmp_path / "scan", listener, cameras, lamps).run()

        with pytest.raises(
            ScanStoppedError, match=r"^the self-check is bad: rear: the picture moved by up to"
        ):
            await checked(Listener())
        unit.clear()
        listener = Listener()
        await checked(listener)
    assert listener.said == ["self-check: good"]
    kept = open_recording(tmp_path / "scan").header.self_check
    assert kept is not None
    assert kept.verdict == "good"


async def test_an_alarm_stops_the_scan_and_homing_lets_it_go_on(
    unit: Unit, table: GrblTable, tmp_path: Path
) -> None:
    listener = Listener()
    listener.at["node x 37.5 y -12.5 mm"] = table.hit_limit  # the fifth
    with pytest.raises(ScanStoppedError, match=r"^node x 37.5 y -12.5 mm: .*ALARM:1, a limit switch was hit"):
        await scanned(unit, table, tmp_path / "scan", listener)
    assert not (tmp_path / "scan").exists()
    half = nodes(open_recording(tmp_path / "scan.unfinished"))
    assert len(half) == 4

    other = SMALL.model_copy(update={"pitch_mm": 20.0})
    with pytest.raises(BadInputError, match=r"was begun with scan.pitch_mm = 25.0, now it is 20.0"):
        await scanned(unit, table, tmp_path / "scan", Listener(), other)

    listener = Listener()
    result = await scanned(unit, table, tmp_path / "scan", listener)
    assert listener.said == [f"going on with {tmp_path / 'scan'}.unfinished: 4 of 16 nodes are done"]
    assert "looking at node x 37.5 y -37.5 mm again" in listener.visited
    assert result.exposures == 16
    whole = open_recording(tmp_path / "scan")
    assert nodes(whole)[:4] == half
    assert len(nodes(whole)) == len(whole.rows) / 2 == 16
    assert not (tmp_path / "scan.unfinished").exists()


async def test_cancellation_brings_the_stage_to_a_stand(unit: Unit, table: GrblTable, tmp_path: Path) -> None:
    listener = Listener()
    task = asyncio.create_task(scanned(unit, table, tmp_path / "scan", listener))

    def cancel_on_the_way() -> None:
        table.machine.settings |= {110: "300", 111: "300"}
        asyncio.get_running_loop().call_later(0.3, task.cancel)

    listener.at["node x -12.5 y -37.5 mm"] = cancel_on_the_way
    with pytest.raises(asyncio.CancelledError):
        await task
    assert table.machine.state == "Idle"
    x_mm = table.machine.planner.place_mm[0] + 100.0
    assert -37.5 < x_mm < -12.5
    assert len(nodes(open_recording(tmp_path / "scan.unfinished"))) == 1


async def test_a_scan_is_not_resumed_after_the_stage_has_slipped(unit: Unit, tmp_path: Path) -> None:
    with GrblTable(unit, switches=False) as table:
        table.machine.settings |= QUICK_TABLE
        listener = Listener()

        def blink() -> None:
            table.lose_power()
            table.power_on()

        listener.at["node x 12.5 y -12.5 mm"] = blink
        with pytest.raises(ScanStoppedError, match=r"node x 12.5 y -12.5 mm: .* restarted \(power\?\)"):
            await scanned(unit, table, tmp_path / "scan", listener, start="unlock")
        # the table now takes the place where it lost its power for its zero
        with pytest.raises(ScanStoppedError) as caught:
            await scanned(unit, table, tmp_path / "scan", Listener(), start="unlock")
        assert "node x 37.5 y -12.5 mm" in str(caught.value)
        assert len(nodes(open_recording(tmp_path / "scan.unfinished"))) == 5

        table.zero_by_hand(-0.6, 0.0)
        with pytest.raises(
            ScanStoppedError, match=r"spot lies \d\.\d px from where it was before the interr"
        ):
            await scanned(unit, table, tmp_path / "scan", Listener(), start="unlock")


async def test_a_bad_node_is_refused_named_and_survived(unit: Unit, table: GrblTable, tmp_path: Path) -> None:
    listener = Listener()
    loop = asyncio.get_running_loop()

    def shade() -> None:
        unit.inject(Fault.NO_LASER)
        loop.call_later(0.15, unit.clear)

    listener.elsewhere = unit.clear
    listener.at["node x 37.5 y 12.5 mm"] = lambda: unit.inject(Fault.REAR_SPOT_MISSING)
    listener.at["node x -37.5 y 12.5 mm"] = shade  # for a moment only: it is tried again
    scan = SMALL.model_copy(update={"retries": 20})
    result = await scanned(unit, table, tmp_path / "scan", listener, scan)
    why = "node x 37.5 y 12.5 mm: rear spot_missing (nothing is brighter than the background)"
    assert result.refused == (why,)
    assert listener.said == [why.replace(" mm:", " mm refused:")]
    recording = open_recording(tmp_path / "scan")
    assert len(nodes(recording)) == 15
    assert (37.5, 12.5) not in nodes(recording)
    assert len(calibrate([recording]).calibration.targets) == 2
    refused = json.loads((tmp_path / "scan" / "scan.json").read_text())["refused"]
    assert list(refused.values()) == ["rear spot_missing (nothing is brighter than the background)"]


async def test_without_light_the_scan_stops_and_goes_on_with_light(
    unit: Unit, table: GrblTable, tmp_path: Path
) -> None:
    listener = Listener()
    listener.at["node x -12.5 y 12.5 mm"] = lambda: unit.inject(Fault.NO_LASER)
    scan = SMALL.model_copy(update={"retries": 0})
    with pytest.raises(ScanStoppedError) as caught:
        await scanned(unit, table, tmp_path / "scan", listener, scan)
    assert "4 of 16 nodes are refused, the others do not form a sufficient grid" in str(caught.value)
    assert "front spot_missing" in str(caught.value)
    assert len(listener.said) == 4
    unit.clear()
    listener = Listener()
    listener.elsewhere = unit.clear
    listener.at["node x -12.5 y 12.5 mm"] = lambda: unit.inject(Fault.NO_LASER)  # the others are good now
    result = await scanned(unit, table, tmp_path / "scan", listener, scan)
    assert [line.split(":")[0] for line in result.refused] == ["node x -12.5 y 12.5 mm"]
    assert len(nodes(open_recording(tmp_path / "scan"))) == 15


async def test_a_flat_made_with_the_laser_is_resumed_and_shows_what_a_lamp_shows(
    unit: Unit, table: GrblTable, tmp_path: Path
) -> None:
    grid = SMALL.model_copy(
        update={"pitch_mm": 14.0, "flat_pitch_mm": 6.0, "flat_margin_mm": 6.0, "retries": 0}
    )
    await scanned(unit, table, tmp_path / "scan", Listener(), grid)
    raster = Raster.over(grid)
    listener = Listener()
    # in the margin, where a node may be dark
    listener.at["node x -27 y 9 mm"] = lambda: unit.inject(Fault.NO_LASER)
    with pytest.raises(ScanStoppedError, match=r"10 nodes in a row are refused; .* x 15 y 15 mm: front"):
        await scanned(unit, table, tmp_path / "flat", listener, raster)
    unit.clear()
    with pytest.raises(BadInputError, match=r"was begun with scan.columns = 10, now it is 4"):
        await scanned(unit, table, tmp_path / "flat", Listener(), grid)
    listener = Listener()
    result = await scanned(unit, table, tmp_path / "flat", listener, raster)
    assert listener.said == [f"going on with {tmp_path / 'flat'}.unfinished: 63 of 100 nodes are done"]
    assert (result.exposures, result.refused) == (100, ())

    flat = open_recording(tmp_path / "flat")
    assert (flat.header.kind, flat.header.limits, len(nodes(flat))) == ("flat", None, 100)
    record_flat(tmp_path / "lamp", unit, 5, lambda done, total: None)
    targets = target_frames([open_recording(tmp_path / "scan")])
    of_laser, of_lamp = (flats_of(open_recording(tmp_path / name), targets) for name in ("flat", "lamp"))
    for name in (FRONT, REAR):
        lit = of_laser[name].response > 0
        seen = np.corrcoef(of_laser[name].response[lit], of_lamp[name].response[lit])[0, 1]
        assert seen > 0.9, name


async def test_a_silent_camera_stops_the_scan(
    unit: Unit, table: GrblTable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(frame_sets, "FRAME_SET_TIMEOUT_S", 3.0)
    listener = Listener()
    listener.at["node x -12.5 y -37.5 mm"] = lambda: unit.inject(Fault.FRONT_SILENT)
    with pytest.raises(ScanStoppedError, match=r"^node x -12.5 y -37.5 mm: camera front: no frame for"):
        await scanned(unit, table, tmp_path / "scan", listener)
    assert len(nodes(open_recording(tmp_path / "scan.unfinished"))) == 1
