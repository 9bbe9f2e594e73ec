"""The self-check before a scan: what it says, what it stops, and what the recording keeps of it."""

import re
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest
from support import led_frames
from support.clock import FakeClock
from support.led_frames import Motion, Scene
from support.led_scan import LedCamera, ScanLamps, StillStage, Told, scan_settings

from altd.acquisition.frame_sets import FrameSets
from altd.acquisition.scan.leds import KnownUnit, ScanLeds
from altd.acquisition.scan.scanner import Scanner, ScanResult, ScanStoppedError
from altd.app.record import known_unit_of
from altd.calibration.file import save_calibration
from altd.measuring.calibration import Calibration
from altd.ports import StageAlarmError
from altd.recording.reader import Recording, open_recording
from altd.records import CameraIdentity
from altd.status.health import Health

STANDING = Scene()
MOVED = Scene(motion=Motion(u_px=0.6, v_px=-0.2, turn_deg=0.1))
MOVED_SAID = r"rear: the picture moved by up to 0\.23\d mm"
"""At 4 px/mm 0.15 mm, and 0.1° at 50 mm from the middle 0.087 mm."""
DARK = Scene(levels=(0.0,) * 6)


@dataclass
class Bench:
    """A unit of known calibration that is to be scanned; the rear camera sees ``rear``."""

    folder: Path
    rear: Scene = STANDING
    calibration: Calibration | None = field(default_factory=led_frames.unit)
    rear_serial: str | None = None
    moves: int = 1
    """So many movements, to the middle of the grid and to nodes, then the stage stops."""
    lamps: ScanLamps = field(default_factory=ScanLamps)
    told: Told = field(default_factory=Told)

    async def scan(self, **settings: object) -> ScanResult:
        clock, path = FakeClock.of_loop(), self.folder / "cal.json"
        if self.calibration is not None:
            save_calibration(self.calibration, path)
        config = scan_settings(path, **settings)
        cameras = {
            "front": LedCamera("front", STANDING, self.lamps, clock),
            "rear": LedCamera("rear", self.rear, self.lamps, clock, self.rear_serial),
        }
        leds = ScanLeds(self.lamps, known_unit_of(config, cameras))
        sets = FrameSets(list(cameras.values()), config.measuring, Health(clock))
        stage = StillStage(self._move)
        scanner = Scanner(config, self.folder / "scan", sets, stage, leds, self.told)
        return await clock.run(scanner.run())

    async def begin(self, **settings: object) -> Recording:
        """Scan as far as the stage goes; what is kept of it."""
        with pytest.raises(ScanStoppedError, match=r"ALARM:1$"):
            await self.scan(**settings)
        return open_recording(self.folder / "scan.unfinished")

    @property
    def has_kept(self) -> bool:
        return (self.folder / "scan.unfinished").exists()

    def _move(self, _x_mm: float, _y_mm: float) -> None:
        self.moves -= 1
        if self.moves < 0:
            raise StageAlarmError("ALARM:1")


async def test_a_unit_that_stands_as_it_did_is_scanned_and_the_recording_says_so(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    kept = (await bench.begin()).header.self_check
    assert bench.told.said == ["self-check: good"]
    assert kept is not None
    assert (kept.verdict, kept.reasons, kept.notes) == ("good", (), ())
    assert bench.lamps.switched == [False, True, False, True, False], "it costs no exposure more"


async def test_a_camera_that_has_moved_stops_the_scan_before_anything_is_kept(tmp_path: Path) -> None:
    bench = Bench(tmp_path, MOVED)
    with pytest.raises(ScanStoppedError) as stopped:
        await bench.scan()
    said = str(stopped.value)
    assert re.match(f"the self-check is bad: {MOVED_SAID}", said)
    assert said.endswith('to calibrate the unit as it is now, set [scan] when_bad = "warning"')
    assert bench.told.said == []
    assert not bench.lamps.lit
    assert not bench.has_kept


async def test_who_calibrates_a_unit_as_it_stands_now_scans_it_all_the_same(tmp_path: Path) -> None:
    bench = Bench(tmp_path, MOVED)
    kept = (await bench.begin(when_bad="warning")).header.self_check
    (line,) = bench.told.said
    assert re.match(f"self-check: bad: {MOVED_SAID}", line)
    assert kept is not None
    assert kept.verdict == "bad"
    assert re.match(MOVED_SAID, kept.reasons[0])


async def test_leds_that_stay_dark_are_said_and_the_scan_goes_on(tmp_path: Path) -> None:
    bench = Bench(tmp_path, DARK)
    kept = (await bench.begin()).header.self_check
    assert bench.told.said == ["self-check: unknown: rear: no LED can be used; LED 1, 2, 3, 4, 5, 6: dark"]
    assert kept is not None
    assert kept.verdict == "unknown"


async def test_lamps_that_cannot_be_had_stop_the_scan(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    bench.lamps.refuses = "GPIO chip 'unit': 'LED_A' taken by 'torch'"
    with pytest.raises(
        ScanStoppedError, match="opening the lamps: GPIO chip 'unit': 'LED_A' taken by 'torch'"
    ):
        await bench.scan()


async def test_without_a_calibration_the_pairs_become_its_references(tmp_path: Path) -> None:
    bench = Bench(tmp_path, calibration=None)
    recording = await bench.begin()
    assert bench.told.said == [
        "no self-check: there is no calibration yet; the LED pairs of this scan will be its references"
    ]
    assert recording.header.self_check is None
    assert [row.leds_on for row in recording.rows if row.camera == "rear"] == [False, True] * 2


async def test_another_camera_than_was_calibrated_has_not_moved(tmp_path: Path) -> None:
    """A technician who has put in a new camera scans to calibrate it."""
    front, rear = led_frames.unit().targets
    known = replace(led_frames.unit(), targets=(front, replace(rear, camera=CameraIdentity("R-1"))))
    bench = Bench(tmp_path, MOVED, known, rear_serial="R-2")
    await bench.begin()
    assert bench.told.said == [
        "self-check: unknown: rear was calibrated with another camera: its serial is 'R-2', expected 'R-1'"
    ]


async def test_a_scan_that_goes_on_keeps_what_its_check_said(tmp_path: Path) -> None:
    await Bench(tmp_path, moves=5).begin()
    later = Bench(tmp_path, moves=100)
    result = await later.scan()
    assert result.refused == ()
    assert later.told.said == [f"going on with {tmp_path / 'scan.unfinished'}: 4 of 16 nodes are done"]
    kept = open_recording(tmp_path / "scan").header.self_check
    assert kept is not None
    assert kept.verdict == "good"


@pytest.mark.parametrize(
    ("spoil", "why"),
    [
        (lambda known: replace(known, unit_serial="TEST-2"), "TEST-2"),
        (
            lambda known: replace(
                known, targets=tuple(replace(target, leds_px=np.zeros((0, 2))) for target in known.targets)
            ),
            "the calibration has no LED references for front, rear",
        ),
        (lambda known: replace(known, targets=known.targets[:1]), "does not know target 'rear'"),
    ],
    ids=["other unit", "no references", "one target"],
)
def test_a_calibration_that_tells_nothing_of_this_unit_is_said(
    spoil: object, why: str, tmp_path: Path
) -> None:
    path = tmp_path / "cal.json"
    save_calibration(spoil(led_frames.unit()), path)  # type: ignore[operator]
    lamps = ScanLamps()
    cameras = {name: LedCamera(name, STANDING, lamps, FakeClock()) for name in ("front", "rear")}
    known = known_unit_of(scan_settings(path), cameras)
    assert not isinstance(known, KnownUnit)
    assert why in known


def test_a_file_that_is_no_calibration_is_said(tmp_path: Path) -> None:
    path = tmp_path / "cal.json"
    path.write_text("{")
    known = known_unit_of(scan_settings(path), {})
    assert isinstance(known, str)
    assert str(path) in known
