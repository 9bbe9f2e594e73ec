"""Two scans, the unit turned by 180° between them: the tilt of the calibrating beam is found and removed.

Truth: the simulator's stage, whose beam is tilted and whose scale is wrong by what its header states.
"""

import json
import math
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.cli import altd_here

from altd.calibration.calibrating import calibrate
from altd.calibration.file import load_calibration, save_calibration
from altd.measuring.calibration import Calibration
from altd.recording.reader import open_recording
from altd.records import Limits, Spot
from altd.vision.localise import locate
from hw_sim.beam import BeamPose
from hw_sim.recording import Progress
from hw_sim.scan import record_scan
from hw_sim.stage import MISALIGNED, Mounting, Stage
from hw_sim.unit import Unit, UnitConfig

SEED = 3
DISTANCE_MM = 280.0


def scanned(folder: Path, mounting: Mounting, stream: int, seed: int = SEED) -> Path:
    quiet: Progress = lambda done, planned: None  # noqa: E731
    stage = Stage(np.random.default_rng([seed, stream]), mounting=mounting)
    record_scan(folder, Unit(UnitConfig(seed=seed)), stage, 1, quiet)
    return folder


@pytest.fixture(scope="module")
def scans(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("turned")
    turned = Mounting(MISALIGNED.scale_ppm, MISALIGNED.square_mrad, MISALIGNED.tilt_mm_per_m, is_turned=True)
    both = scanned(folder / "a", MISALIGNED, 1), scanned(folder / "b", turned, 2)
    for path in both:
        header = json.loads((path / "recording.json").read_text())
        (path / "recording.json").write_text(json.dumps(header | {"seat_mm_per_m": 0.1}))
    return both


@pytest.fixture(scope="module")
def calibrations(scans: tuple[Path, Path]) -> tuple[Calibration, Calibration]:
    one, both = ([open_recording(path) for path in paths] for paths in (scans[:1], scans))
    return calibrate(one).calibration, calibrate(both).calibration


def zero_mm_per_m(calibration: Calibration) -> tuple[float, float]:
    """The mean slopes that beams normal to the targets are measured with."""
    unit = Unit(UnitConfig(seed=SEED))
    places_mm = [(x, y) for x in (-55.0, -21.0, 17.0, 49.0) for y in (-44.0, -7.0, 33.0)]
    points: dict[str, list[tuple[float, float]]] = {target.name: [] for target in calibration.targets}
    for sequence, place in enumerate(places_mm):
        unit.place(BeamPose(*place))
        for target in calibration.targets:
            frame = unit.expose(target.name, sequence, sequence * unit.config.period_ns)
            spot = locate(frame, target.localiser, target.flat)
            assert isinstance(spot, Spot)
            point = target.point(spot.u_px, spot.v_px)
            assert point is not None
            points[target.name].append((point.x_mm, point.y_mm))
    x, y = 1000 * np.mean(np.subtract(points["rear"], points["front"]), axis=0) / DISTANCE_MM
    return float(x), float(y)


def test_one_scan_keeps_the_tilt_and_states_it(calibrations: tuple[Calibration, Calibration]) -> None:
    one, _ = calibrations
    assert zero_mm_per_m(one) == pytest.approx([-t for t in MISALIGNED.tilt_mm_per_m], abs=0.05)
    assert one.limits == Limits(0.002, 120.0, 0.2, 0.8, 0.0, 0.0)


def test_two_scans_remove_it_to_a_hundredth_of_the_accuracy_that_is_required(
    calibrations: tuple[Calibration, Calibration],
) -> None:
    _, both = calibrations
    for zero in zero_mm_per_m(both):
        assert math.degrees(abs(zero) * 1e-3) < 0.005
    assert 0.002 < sigma_mm_per_m(both) < 0.02
    assert both.limits.stage_scale_ppm == 120.0, "a turned unit does not show the stage's scale"


def test_the_file_keeps_the_limits(calibrations: tuple[Calibration, Calibration], tmp_path: Path) -> None:
    save_calibration(calibrations[1], tmp_path / "c.json")
    assert load_calibration(tmp_path / "c.json").limits == calibrations[1].limits


def test_a_turned_scan_alone_is_refused(scans: tuple[Path, Path], tmp_path: Path) -> None:
    said = altd_here("calibrate", scans[1], "-o", tmp_path / "c.json")
    assert (said.status, (tmp_path / "c.json").exists()) == (2, False)
    assert "every scan is of the turned unit; one with turned_deg 0 defines the unit's frame" in said.err


def test_a_scan_that_only_says_that_the_unit_was_turned_is_refused(
    scans: tuple[Path, Path], tmp_path: Path
) -> None:
    """A wrong zero would follow from it."""
    forged = scanned(tmp_path / "forged", MISALIGNED, 5)
    header = json.loads((forged / "recording.json").read_text()) | {"turned_deg": 180}
    (forged / "recording.json").write_text(json.dumps(header))
    said = altd_here("calibrate", scans[0], forged, "-o", tmp_path / "c.json")
    assert (said.status, (tmp_path / "c.json").exists()) == (2, False)
    assert "was the unit turned by 180° about z, and nothing else moved?" in said.err


def test_spots_that_the_border_cuts_do_not_hide_the_turn(
    calibrations: tuple[Calibration, Calibration], scans: tuple[Path, Path], tmp_path: Path
) -> None:
    """The front camera's picture ends half a millimetre below the middles of the outer row's spots."""
    front, _ = calibrations[0].targets
    height = round(front.map.to_px(front.map.hull_mm)[:, 1].max() + 0.5 * front.px_per_mm)
    cut = [shutil.copytree(path, tmp_path / path.name) for path in scans]
    for path in cut:
        header = json.loads((path / "recording.json").read_text())
        header["cameras"]["front"]["height"] = height
        (path / "recording.json").write_text(json.dumps(header))
        for file in (path / "front").iterdir():
            cv2.imwrite(str(file), cv2.imread(str(file), cv2.IMREAD_UNCHANGED)[:height])
    both = calibrate([open_recording(path) for path in cut])
    assert any("its spot is known worse" in line for line in both.remarks)
    assert sigma_mm_per_m(both.calibration) < 1.3 * sigma_mm_per_m(calibrations[1])


def sigma_mm_per_m(calibration: Calibration) -> float:
    """Of the tilt, without the two seatings."""
    assert calibration.limits.beam_normal_mm_per_m is not None
    return math.sqrt(calibration.limits.beam_normal_mm_per_m**2 - 0.1**2 / 2)


def test_a_turned_scan_of_one_target_shows_no_tilt_and_is_refused(
    scans: tuple[Path, Path], tmp_path: Path
) -> None:
    half = shutil.copytree(scans[1], tmp_path / "half")
    rows = (half / "frames.csv").read_text().splitlines()
    (half / "frames.csv").write_text("".join(f"{row}\n" for row in rows if ",rear," not in row))
    targets = {"targets": [{"name": "front", "z_mm": 0.0, "camera": "front"}]}
    (half / "recording.json").write_text(
        json.dumps(json.loads((half / "recording.json").read_text()) | targets)
    )
    said = altd_here("calibrate", scans[0], half, "-o", tmp_path / "c.json")
    assert (said.status, (tmp_path / "c.json").exists()) == (2, False)
    assert "shows one target of the turned unit; the tilt needs two" in said.err


def test_a_replay_of_the_turned_unit_compares_nothing_with_the_stage(
    calibrations: tuple[Calibration, Calibration], scans: tuple[Path, Path], tmp_path: Path
) -> None:
    """The positions are those of another frame, which only the calibration and the verification know."""
    save_calibration(calibrations[1], tmp_path / "c.json")
    upright, turned = (altd_here("replay", scan, "--calibration", tmp_path / "c.json") for scan in scans)
    assert "against the known positions" in upright.err
    assert "known" not in turned.err
    assert len(turned.objects) == 30
    assert all(line["valid"] and "known_x_mm" not in line for line in turned.objects)
