"""Flats of a simulated unit, whose response is known."""

import csv
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.recordings import quiet

from altd.calibration.calibrating import calibrate
from altd.calibration.recorded_flat import flat_correlation, flats_of
from altd.calibration.result import CalibrationResult
from altd.calibration.target_frames import target_frames
from altd.errors import BadInputError
from altd.measuring.calibration import Calibration
from altd.recording.reader import Recording, open_recording
from altd.records import Spot
from altd.vision.flat import Flat
from altd.vision.localise import locate
from hw_sim.flat import record_flat
from hw_sim.measure import random_poses
from hw_sim.scan import STAGE_STREAM, record_scan
from hw_sim.stage import Stage
from hw_sim.targets import DotPattern
from hw_sim.unit import Unit, UnitConfig

SEED = 3


@pytest.fixture(scope="module")
def unit() -> Unit:
    return Unit(UnitConfig(seed=SEED))


@pytest.fixture(scope="module")
def scan(unit_3: Path) -> Recording:
    return open_recording(unit_3 / "scan")


@pytest.fixture(scope="module")
def flats(scan: Recording, flat_of_unit_3: Path) -> dict[str, Flat]:
    return flats_of(open_recording(flat_of_unit_3), target_frames([scan]))


def correlation(flat: Flat, unit: Unit, camera: str) -> float:
    """Correlation with the true response where the flat says anything: not at hot pixels."""
    known = flat.levels > 0
    assert np.mean(known) > 0.999
    return float(np.corrcoef(flat.response[known], unit.imagers[camera].view.response[known])[0, 1])


@pytest.mark.parametrize("camera", ["front", "rear"])
def test_a_flat_is_what_the_pixels_show_of_even_light(
    flats: dict[str, Flat], unit: Unit, camera: str
) -> None:
    assert flats[camera].source == "recording"
    assert flats[camera].response.mean() == pytest.approx(1.0)
    assert correlation(flats[camera], unit, camera) > 0.97


def test_a_flat_of_another_camera_is_refused(scan: Recording, flat_of_unit_3: Path) -> None:
    """The flat was recorded by the rear camera's successor."""
    flat = open_recording(flat_of_unit_3)
    sizes = scan.header.cameras
    cameras = {name: size.model_copy(update={"serial": f"{name}-1"}) for name, size in sizes.items()}
    others = {**cameras, "rear": cameras["rear"].model_copy(update={"serial": "rear-2"})}
    flat = replace(flat, header=flat.header.model_copy(update={"cameras": others}))
    scan = replace(scan, header=scan.header.model_copy(update={"cameras": cameras}))
    with pytest.raises(BadInputError, match=r"rear: the flat is of another camera .* 'rear-2'"):
        flats_of(flat, target_frames([scan]))


def test_light_that_is_switched_off_during_the_recording_tells_the_dark_rows(
    scan: Recording, flat_of_unit_3: Path, flats: dict[str, Flat], tmp_path: Path
) -> None:
    """As ``altd record`` writes it: no row says that it is lit, and one frame falls into the switching."""
    copy = tmp_path / "flat"
    with (flat_of_unit_3 / "frames.csv").open(newline="") as table:
        rows = list(csv.DictReader(table))
    for camera in ("front", "rear"):
        (copy / camera).mkdir(parents=True)
    for row in rows:
        pixels = cv2.imread(str(flat_of_unit_3 / row["file"]), cv2.IMREAD_UNCHANGED)
        if row["sequence"] == "8":
            pixels = pixels // 2
        cv2.imwrite(str(copy / row["file"]), pixels)
        row["leds"] = "off"
    with (copy / "frames.csv").open("w", newline="") as table:
        writer = csv.DictWriter(table, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    (copy / "recording.json").write_text((flat_of_unit_3 / "recording.json").read_text())
    switched = flats_of(open_recording(copy), target_frames([scan]))
    for camera, flat in flats.items():
        assert np.corrcoef(switched[camera].response.ravel(), flat.response.ravel())[0, 1] > 0.99
        assert np.percentile(np.abs(switched[camera].response - flat.response), 99) < 0.1


def errors_of(calibration: Calibration, unit: Unit) -> tuple[float, float]:
    """Rms of x and y, mm, and of yaw and pitch, degrees, over twenty random beams of four exposures."""
    off_mm, off_deg = [], []
    for number, pose in enumerate(random_poses(20, 280.0, np.random.default_rng(1))):
        unit.place(pose)
        points = []
        for target in calibration.targets:
            spots = [
                locate(unit.expose(target.name, 4 * number + n, 0), target.localiser, target.flat)
                for n in range(4)
            ]
            mean_px = np.mean([(s.u_px, s.v_px) for s in spots if isinstance(s, Spot)], axis=0)
            point = target.point(*mean_px)
            assert point is not None
            points.append(np.array([point.x_mm, point.y_mm]))
        off_mm.append(points[0] - pose.at(0.0))
        slopes = (points[1] - points[0]) / 280.0
        off_deg.append(np.degrees(np.arctan(slopes)) - (pose.yaw_deg, pose.pitch_deg))
    return float(np.sqrt(np.mean(np.square(off_mm)))), float(np.sqrt(np.mean(np.square(off_deg))))


def test_with_a_flat_a_unit_measures_several_times_as_well(
    unit_3_with_flat: CalibrationResult, unit: Unit
) -> None:
    result = unit_3_with_flat
    assert result.remarks[:2] == (
        "front: localised through its recorded flat",
        "rear: localised through its recorded flat",
    )
    assert result.doubts == ()
    off_mm, off_deg = errors_of(result.calibration, unit)
    assert off_mm < 0.004
    assert off_deg < 0.0010


@pytest.mark.parametrize("camera", ["front", "rear"])
def test_a_flat_of_other_pixels_is_told_from_the_right_one(
    scan: Recording, flats: dict[str, Flat], camera: str
) -> None:
    frames = [scan.frame(row) for row in scan.rows if row.camera == camera and row.position_mm][::6]
    assert flat_correlation(frames, flats[camera]) > 0.75
    for moved_px in ((0, 1), (1, 0), (0, -2), (30, 40)):
        moved = Flat(np.roll(flats[camera].levels, moved_px, (0, 1)), "recording")
        assert flat_correlation(frames, moved) < 0.55, moved_px
    assert np.isnan(flat_correlation(frames, Flat(np.full((480, 752), 200, np.uint8), "recording")))


def test_a_print_that_ends_within_the_outer_spots_needs_a_flat(tmp_path: Path) -> None:
    unit = Unit(UnitConfig(seed=301, dots=DotPattern(size_mm=(146.0, 116.0))))
    record_flat(tmp_path / "flat", unit, 8, quiet)
    unit.leds_on, unit.even_mw_per_mm2 = False, 0.0
    record_scan(tmp_path / "scan", unit, Stage(np.random.default_rng([301, STAGE_STREAM])), 1, quiet)
    scan = open_recording(tmp_path / "scan")
    with pytest.raises(BadInputError, match=r"front: print or surface ends .* x -70, x 70, y -56, y 56 mm"):
        calibrate([scan])
    result = calibrate([scan], open_recording(tmp_path / "flat"))
    assert result.refused == ()
    assert max(target.leave_one_out_px for target in result.calibration.targets) < 0.03


def test_without_a_flat_the_print_is_found_and_the_plain_plate_is_seen_to_be_plain(
    unit_3: Path, calibration_of_unit_3: Calibration, unit: Unit
) -> None:
    said = (unit_3 / "calibrated").read_text().splitlines()
    assert {"front: print of 1.000 mm pitch found and modelled", "rear: plain, no print"} <= set(said)
    front, rear = calibration_of_unit_3.targets
    assert (front.localiser.method, rear.localiser.method) == ("profile", "profile")
    assert (front.flat is not None, rear.flat) == (True, None)
    assert front.flat is not None
    assert correlation(front.flat, unit, "front") > 0.95
    off_mm, off_deg = errors_of(calibration_of_unit_3, unit)
    assert off_mm < 0.012
    assert off_deg < 0.0035
