import csv
import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.cli import altd_here, refusal
from support.recordings import quiet

from altd.recording.reader import open_recording
from hw_sim.fisheye import FisheyeLens
from hw_sim.lens import PIXEL_MM, rotation
from hw_sim.plate import Plate, record_plate, with_plate
from hw_sim.unit import Unit, UnitConfig


@pytest.fixture(scope="module")
def seen() -> tuple[Unit, Plate]:
    plate = Plate(dark=((0, 0), (4, 2)))
    return with_plate(Unit(UnitConfig(seed=5, lux=0.0, speckle_contrast=0.0, hot_pixels=0)), plate), plate


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, seen: tuple[Unit, Plate]) -> Path:
    path = tmp_path_factory.mktemp("hw_sim") / "plate"
    record_plate(path, *seen, 1, quiet)
    return path


def test_a_plates_recording_says_what_it_shows(folder: Path) -> None:
    header = open_recording(folder).header
    assert (header.kind, header.note) == ("plate", "hw_sim, seed 5, plate")
    assert json.loads((folder / "recording.json").read_text())["plate"] == {
        "columns": 7,
        "rows": 5,
        "pitch_mm": 23.0,
        "origin_mm": [-69.0, -46.0],
        "disc_mm": 5.0,
    }
    with (folder / "frames.csv").open(newline="") as table:
        rows = list(csv.DictReader(table))
    assert [(row["camera"], row["leds"], row["x_mm"]) for row in rows] == [
        ("front", "off", ""),
        ("rear", "off", ""),
        ("front", "on", ""),
        ("rear", "on", ""),
    ]


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


def test_its_axis_is_no_special_place() -> None:
    lens = fisheye()
    assert np.column_stack(lens.project(*lens.unproject(377.0, 238.0))) == pytest.approx(
        np.array([[377.0, 238.0]])
    )


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["--tilt", "50"], "--tilt: 50 is not between 0 and 35 degrees"),
        (["--dark", "7,0"], "7,0 is not on the plate of 7 × 5 LEDs"),
        (["--dark", "middle"], "'middle' is not COLUMN,ROW"),
        (["--exposures", "0"], "'0' is not a whole number from 1 on"),
    ],
)
def test_a_wrong_argument_gives_one_line_and_status_2(
    tmp_path: Path, arguments: list[str], complaint: str
) -> None:
    assert complaint in refusal(altd_here("plate", "-o", tmp_path / "p", *arguments, module="hw_sim"))
    assert list(tmp_path.iterdir()) == []
