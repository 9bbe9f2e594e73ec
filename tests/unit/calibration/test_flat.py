"""Flats of a simulated unit, whose response is known, and of pictures that a test paints."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.cli import altd_here, refusal
from support.recordings import header, write_scan

from altd.calibration.calibrating import calibrate
from altd.calibration.flat import flat_likeness, flats_of
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
from hw_sim.unit import Unit, UnitConfig

SEED = 3


def quiet(_done: int, _planned: int) -> None:
    """No progress."""


@pytest.fixture(scope="module")
def unit() -> Unit:
    return Unit(UnitConfig(seed=SEED))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, unit: Unit) -> Path:
    """A scan with two exposures a node, and a flat."""
    folder = tmp_path_factory.mktemp("flat")
    record_flat(folder / "flat", unit, 8, quiet)
    record_scan(folder / "scan", unit, Stage(np.random.default_rng([SEED, STAGE_STREAM])), 2, quiet)
    return folder


@pytest.fixture(scope="module")
def flats(folder: Path) -> dict[str, Flat]:
    return flats_of(open_recording(folder / "flat"), target_frames([open_recording(folder / "scan")]))


def likeness(flat: Flat, unit: Unit, camera: str) -> float:
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
    assert likeness(flats[camera], unit, camera) > 0.97


def test_a_flat_of_another_camera_is_refused(folder: Path, tmp_path: Path) -> None:
    """The flat was recorded by the rear camera's successor."""
    flat, scan = open_recording(folder / "flat"), open_recording(folder / "scan")
    sizes = scan.header.cameras
    cameras = {name: size.model_copy(update={"serial": f"{name}-1"}) for name, size in sizes.items()}
    others = {**cameras, "rear": cameras["rear"].model_copy(update={"serial": "rear-2"})}
    flat = replace(flat, header=flat.header.model_copy(update={"cameras": others}))
    scan = replace(scan, header=scan.header.model_copy(update={"cameras": cameras}))
    with pytest.raises(BadInputError, match=r"rear: the flat is of another camera .* 'rear-2'"):
        flats_of(flat, target_frames([scan]))


def test_light_that_is_switched_off_during_the_recording_tells_the_dark_rows(
    folder: Path, flats: dict[str, Flat], tmp_path: Path
) -> None:
    """As ``altd record`` writes it: no row says that it is lit, and one frame falls into the switching."""
    copy = tmp_path / "flat"
    with (folder / "flat" / "frames.csv").open(newline="") as table:
        rows = list(csv.DictReader(table))
    for camera in ("front", "rear"):
        (copy / camera).mkdir(parents=True)
    for row in rows:
        pixels = cv2.imread(str(folder / "flat" / row["file"]), cv2.IMREAD_UNCHANGED)
        if row["sequence"] == "8":
            pixels = pixels // 2
        cv2.imwrite(str(copy / row["file"]), pixels)
        row["leds"] = "off"
    with (copy / "frames.csv").open("w", newline="") as table:
        writer = csv.DictWriter(table, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    (copy / "recording.json").write_text((folder / "flat" / "recording.json").read_text())
    switched = flats_of(open_recording(copy), target_frames([open_recording(folder / "scan")]))
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


def test_with_a_flat_a_unit_measures_several_times_as_well(folder: Path, unit: Unit) -> None:
    result = calibrate([open_recording(folder / "scan")], open_recording(folder / "flat"))
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
    folder: Path, flats: dict[str, Flat], camera: str
) -> None:
    scan = open_recording(folder / "scan")
    frames = [scan.frame(row) for row in scan.rows if row.camera == camera and row.position_mm][::6]
    assert flat_likeness(frames, flats[camera]) > 0.75
    for moved_px in ((0, 1), (1, 0), (0, -2), (30, 40)):
        moved = Flat(np.roll(flats[camera].levels, moved_px, (0, 1)), "recording")
        assert flat_likeness(frames, moved) < 0.55, moved_px
    assert np.isnan(flat_likeness(frames, Flat(np.full((480, 752), 200, np.uint8), "recording")))


def test_without_a_flat_the_print_is_found_and_the_plain_plate_is_seen_to_be_plain(
    folder: Path, unit: Unit
) -> None:
    result = calibrate([open_recording(folder / "scan")])
    assert result.remarks[:2] == (
        "front: print of 1.000 mm pitch found and modelled",
        "rear: plain, no print",
    )
    front, rear = result.calibration.targets
    assert (front.localiser.method, rear.localiser.method) == ("profile", "profile")
    assert (front.flat is not None, rear.flat) == (True, None)
    assert front.flat is not None
    assert likeness(front.flat, unit, "front") > 0.95
    off_mm, off_deg = errors_of(result.calibration, unit)
    assert off_mm < 0.012
    assert off_deg < 0.0035


def painted(
    folder: Path, lit: np.ndarray | None, kind: str = "flat", serial: str = "TEST-1", name: str = "front"
) -> Path:
    """A recording of one camera: ``lit`` three times."""
    picture = np.full((480, 752), 90, np.uint8) if lit is None else lit.astype(np.uint8)
    (folder / name).mkdir(parents=True)
    about = header(kind, serial)
    rows, columns = picture.shape
    about["cameras"] = {name: {"width": columns, "height": rows, "bits": 8}}
    (folder / "recording.json").write_text(json.dumps(about))
    table = ["sequence,t_s,camera,file,leds,x_mm,y_mm"]
    for n in range(3):
        cv2.imwrite(str(folder / name / f"{n}.png"), picture)
        table.append(f"{n},{n / 20},{name},{name}/{n}.png,off,,")
    (folder / "frames.csv").write_text("\n".join(table) + "\n")
    return folder


@pytest.fixture(scope="module")
def scan(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """Of the unit whose flats are painted."""
    return open_recording(write_scan(tmp_path_factory.mktemp("scan") / "scan", columns=1, rows=1))


def spot_alone() -> np.ndarray:
    v, u = np.mgrid[:480, :752]
    return 4 + 200 * np.exp(-((u - 300) ** 2 + (v - 200) ** 2) / (2 * 60.0**2))


def half_white() -> np.ndarray:
    picture = np.full((480, 752), 100)
    picture[:, 376:] = 255
    return picture


@pytest.mark.parametrize(
    ("given", "complaint"),
    [
        ({"kind": "measurement"}, "is of kind 'measurement', not 'flat'"),
        ({"serial": "TEST-2"}, "is a flat of unit 'TEST-2', the scan is of unit 'TEST-1'"),
        (
            {"lit": np.full((480, 640), 90)},
            "front: frames of 640 × 480, those of the scan are 752 × 480",
        ),
        ({"lit": np.full((480, 752), 8)}, "front: too dark to be a flat: 8.0 counts of 255 on average"),
        ({"lit": half_white()}, "front: too bright to be a flat: 50% of the pixels are saturated"),
        ({"lit": spot_alone()}, "front: too uneven to be a flat: half the picture gets "),
        ({"name": "left"}, "has no frame of the targets 'front' and 'rear'"),
    ],
)
def test_what_is_no_flat_of_the_scan_is_refused(
    tmp_path: Path, scan: Recording, given: dict[str, object], complaint: str
) -> None:
    recording = open_recording(painted(tmp_path / "flat", **{"lit": None, **given}))  # type: ignore[arg-type]
    with pytest.raises(BadInputError) as caught:
        flats_of(recording, target_frames([scan]))
    assert str(caught.value).startswith(f"{tmp_path / 'flat'}: {complaint}")
    assert "\n" not in str(caught.value)


def test_a_camera_without_frames_gets_no_flat(tmp_path: Path, scan: Recording) -> None:
    flats = flats_of(open_recording(painted(tmp_path / "flat", None)), target_frames([scan]))
    assert set(flats) == {"front"}
    assert flats["front"].response == pytest.approx(np.ones((480, 752)))


def test_the_command_line_refuses_with_one_line_and_writes_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scan, output = write_scan(tmp_path / "scan"), tmp_path / "cal.json"
    painted(tmp_path / "other", None, serial="TEST-2")
    for flat, complaint in (
        (tmp_path / "nowhere", "nowhere/recording.json: No such file or directory"),
        (scan, "scan: is of kind 'scan', not 'flat'"),
        (tmp_path / "other", "other: is a flat of unit 'TEST-2', the scan is of unit 'TEST-1'"),
    ):
        assert complaint in refusal(altd_here("calibrate", scan, "--flat", flat, "-o", output))
        assert not output.exists()
