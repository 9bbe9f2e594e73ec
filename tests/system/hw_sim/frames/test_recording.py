"""Recordings of a simulated unit: of its beam, of a flat and of a plate."""

import csv
import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.cli import altd_here, refusal
from support.recordings import quiet

from altd.errors import BadInputError
from hw_sim.beam import BeamPose
from hw_sim.faults import Fault
from hw_sim.fisheye import FisheyeLens
from hw_sim.flat import raster_mm, record_laser_flat
from hw_sim.lens import PIXEL_MM, rotation
from hw_sim.measure import random_poses, record_measurement
from hw_sim.plate import Plate, record_plate, with_plate
from hw_sim.scan import record_scan
from hw_sim.stage import Stage
from hw_sim.unit import Unit, UnitConfig


def rows_of(folder: Path) -> list[dict[str, str]]:
    with (folder / "frames.csv").open(newline="") as table:
        reader = csv.DictReader(table)
        assert reader.fieldnames == ["sequence", "t_s", "camera", "file", "leds", "x_mm", "y_mm"]
        return list(reader)


@pytest.fixture(scope="module")
def scan(tmp_path_factory: pytest.TempPathFactory, ordinary_unit: Unit) -> Path:
    folder = tmp_path_factory.mktemp("hw_sim") / "scan"
    record_scan(folder, ordinary_unit, Stage(np.random.default_rng(1)), 1, quiet)
    return folder


def test_a_scan_begins_with_led_pairs_and_goes_over_the_grid(scan: Path) -> None:
    front = [row for row in rows_of(scan) if row["camera"] == "front"]
    assert [row["leds"] for row in front[:4]] == ["off", "on", "off", "on"]
    assert {row["x_mm"] for row in front[:4]} == {""}
    nodes = [(float(row["x_mm"]), float(row["y_mm"])) for row in front[4:]]
    assert nodes == [(x, y) for y in (-56, -28, 0, 28, 56) for x in (-70, -42, -14, 14, 42, 70)]
    assert {row["leds"] for row in front[4:]} == {"off"}


def test_sixteen_bits_survive_the_file(tmp_path: Path, clean_unit: Unit) -> None:
    record_measurement(tmp_path / "m", clean_unit, [BeamPose(0.0, 0.0)], 1, quiet)
    image = cv2.imread(str(tmp_path / "m" / "rear" / "000000.png"), cv2.IMREAD_UNCHANGED)
    assert image is not None
    assert image.dtype == np.uint16
    assert image.max() > 20_000
    assert json.loads((tmp_path / "m" / "recording.json").read_text())["cameras"]["rear"]["bits"] == 16


def test_poses_keep_to_the_area_on_both_targets_and_to_the_specified_slopes() -> None:
    poses = random_poses(300, 280.0, np.random.default_rng(1))
    ends = np.array([pose.at(z) for pose in poses for z in (0.0, 280.0)])
    slopes = np.array([(pose.slope_x, pose.slope_y) for pose in poses])
    assert np.all(np.abs(ends) <= [70.0, 55.0])
    assert np.all(np.abs(slopes) <= [0.110, 0.250])
    assert np.all(np.abs(slopes).max(axis=0) > [0.1, 0.2])


def test_the_truth_of_a_measurement_is_the_beam_that_was_there(tmp_path: Path, unit: Unit) -> None:
    poses = [BeamPose(1.0, 2.0, 0.03, 0.04), BeamPose(-5.0, 6.0, -0.07, 0.08)]
    truth = record_measurement(tmp_path / "m", unit, poses, 2, quiet)
    assert truth == {
        "window": 2,
        "poses": [
            {"x_mm": 1.0, "y_mm": 2.0, "slope_x": 0.03, "slope_y": 0.04},
            {"x_mm": -5.0, "y_mm": 6.0, "slope_x": -0.07, "slope_y": 0.08},
        ],
    }
    rows = rows_of(tmp_path / "m")
    assert [int(row["sequence"]) for row in rows] == [0, 0, 1, 1, 2, 2, 3, 3]
    assert {(row["leds"], row["x_mm"], row["y_mm"]) for row in rows} == {("off", "", "")}


def test_faulty_cameras_leave_their_mark_in_the_table(tmp_path: Path, unit: Unit) -> None:
    unit.inject(Fault.FRONT_SILENT, Fault.OUT_OF_STEP)
    record_measurement(tmp_path / "m", unit, [BeamPose(0.0, 0.0)], 2, quiet)
    rows = rows_of(tmp_path / "m")
    assert [(row["camera"], row["t_s"]) for row in rows] == [("rear", "0.010000"), ("rear", "0.030000")]


def test_a_folder_that_holds_something_is_refused_and_left_alone(tmp_path: Path, unit: Unit) -> None:
    (tmp_path / "mine.txt").write_text("precious")
    with pytest.raises(BadInputError, match="not an empty folder"):
        record_measurement(tmp_path, unit, [BeamPose(0.0, 0.0)], 1, quiet)
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


def test_a_flat_of_the_laser_has_the_dark_first_and_then_the_spot_at_each_place(
    tmp_path: Path, unit: Unit
) -> None:
    stage = Stage(np.random.default_rng(1), sigma_mm=0.0)
    record_laser_flat(tmp_path / "flat", unit, stage, 20.0, 2, lambda _done, _planned: None)
    rows = [row for row in rows_of(tmp_path / "flat") if row["camera"] == "rear"]
    places = [(float(row["x_mm"]), float(row["y_mm"])) for row in rows if row["x_mm"]]
    assert [row["x_mm"] for row in rows[:3]] == ["", "", "-79.0000"]
    assert places == [tuple(np.round(place, 4)) for place in raster_mm(20.0, 9.0)]
    assert np.max(places, axis=0).tolist() == [79.0, 65.0]
    for row in (rows[0], rows[2 + len(places) // 2]):
        picture = cv2.imread(str(tmp_path / "flat" / row["file"]), cv2.IMREAD_UNCHANGED)
        smooth = cv2.GaussianBlur(picture.astype(np.float32), (0, 0), 4.0)
        if not row["x_mm"]:
            assert smooth.max() < 40
            continue
        v, u = np.unravel_index(smooth.argmax(), smooth.shape)
        x_mm, y_mm = unit.imagers["rear"].view.lens.unproject(float(u), float(v))
        assert np.hypot(x_mm - float(row["x_mm"]), y_mm - float(row["y_mm"])) < 1.5


@pytest.fixture(scope="module")
def seen() -> tuple[Unit, Plate]:
    plate = Plate(dark=((0, 0), (4, 2)))
    return with_plate(Unit(UnitConfig(seed=5, lux=0.0, speckle_contrast=0.0, hot_pixels=0)), plate), plate


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, seen: tuple[Unit, Plate]) -> Path:
    path = tmp_path_factory.mktemp("hw_sim") / "plate"
    record_plate(path, *seen, 1, quiet)
    return path


@pytest.mark.parametrize("camera", ["front", "rear"])
def test_leds_shine_where_the_drawing_has_them_and_dark_ones_do_not(
    camera: str, folder: Path, seen: tuple[Unit, Plate]
) -> None:
    unit, plate = seen
    off, on = (
        cv2.imread(str(folder / camera / f"00000{n}.png"), cv2.IMREAD_UNCHANGED).astype(float) for n in (0, 1)
    )
    lens = unit.imagers[camera].view.lens
    for row in range(5):
        for column in range(7):
            x, y = plate.origin_mm[0] + 23.0 * column, plate.origin_mm[1] + 23.0 * row
            u, v = (round(float(at)) for at in lens.project(x, y))
            light = (on - off)[v - 2 : v + 3, u - 2 : u + 3].mean()
            assert (light > 60) == ((column, row) not in plate.dark), (column, row)
            u, v = (round(float(at)) for at in lens.project(x + 5.0, y))
            assert (on - off)[v - 2 : v + 3, u - 2 : u + 3].mean() < 5


def fisheye(k1: float = -0.02, k2: float = 0.005) -> FisheyeLens:
    turned = rotation(0.4, -0.2, 0.05)
    return FisheyeLens(
        3.6, (377.0, 238.0), (k1, k2, 0.0, 0.0, 0.0), turned, np.array([1.0, -2.0, 120.0]), True
    )


def test_a_fisheye_lens_puts_points_where_opencv_does() -> None:
    lens, focal_px = fisheye(), 3.6 / PIXEL_MM
    x, y = (grid.ravel() for grid in np.meshgrid(np.linspace(-75, 75, 7), np.linspace(-50, 50, 5)))
    face = np.column_stack([-x, -y, np.zeros_like(x)])[:, None, :]
    matrix = np.array([[focal_px, 0.0, 377.0], [0.0, focal_px, 238.0], [0.0, 0.0, 1.0]])
    turn, _ = cv2.Rodrigues(lens.rotation)
    expected, _ = cv2.fisheye.projectPoints(
        face, turn, lens.translation_mm, matrix, np.array([-0.02, 0.005, 0.0, 0.0])
    )
    assert np.abs(np.column_stack(lens.project(x, y)) - expected.reshape(-1, 2)).max() < 1e-8
    back = np.column_stack(lens.unproject(*expected.reshape(-1, 2).T))
    assert np.abs(back - np.column_stack([x, y])).max() < 1e-8


def test_the_axis_of_a_fisheye_lens_is_no_special_place() -> None:
    lens = fisheye()
    assert np.column_stack(lens.project(*lens.unproject(377.0, 238.0))) == pytest.approx(
        np.array([[377.0, 238.0]])
    )


@pytest.mark.parametrize(
    ("command", "arguments", "complaint"),
    [
        ("measure", ["--faults", "gremlins"], "unknown fault 'gremlins'"),
        ("measure", ["--truth", "/nowhere/truth.json"], "/nowhere/truth.json"),
        ("measure", ["--truth", "/dev/null"], "/dev/null: is a device, not a file that can be replaced"),
        ("measure", ["--poses", "0"], "'0' is not a whole number from 1 on"),
        ("plate", ["--tilt", "50"], "--tilt: 50 is not between 0 and 35 degrees"),
        ("plate", ["--dark", "7,0"], "7,0 is not on the plate of 7 × 5 LEDs"),
        ("plate", ["--dark", "middle"], "'middle' is not COLUMN,ROW"),
        ("plate", ["--exposures", "0"], "'0' is not a whole number from 1 on"),
    ],
)
def test_a_wrong_argument_gives_one_line_and_status_2(
    tmp_path: Path, command: str, arguments: list[str], complaint: str
) -> None:
    output = ["-o", tmp_path / "m", *(["--truth", tmp_path / "t.json"] if command == "measure" else [])]
    assert complaint in refusal(altd_here(command, *output, *arguments, module="hw_sim"))
    assert list(tmp_path.iterdir()) == []
