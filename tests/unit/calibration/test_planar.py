"""Calibration from a plate at known poses, in pictures that OpenCV's camera projects."""

import json
import math
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from support.frames import HEIGHT, WIDTH
from support.plates import View, add_disc, tilted

from altd.calibration.planar import PlanarResult, calibrate_planar
from altd.errors import BadInputError
from altd.recording.reader import open_recording
from hw_sim.recording import STORED

LEDS = np.array([(-41, -40), (-7, -39), (31, -32), (44, 16), (11, 3), (-38, 23), (2, 39)], dtype=float)
VIEW = View(1000.0, 420.0, tilted(10.0, 1.0), distortion=(0.0,) * 5)
POSES = (2.0, -3.0, 5.0), (-14.0, 9.0, -20.0)
FRAMES, NOISE, DISC_MM = 3, 1.5, 5.0
HEADER: dict[str, Any] = {
    "format": "altd-recording/1",
    "kind": "planar",
    "fps": 20.0,
    "cameras": {"eye": {"width": WIDTH, "height": HEIGHT, "bits": 8}},
    "unit": {"serial": "P-1"},
    "plate": {"leds_mm": LEDS.tolist(), "disc_mm": DISC_MM},
}


def placed(pose: tuple[float, float, float]) -> np.ndarray:
    turn = math.radians(pose[2])
    turned = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
    return np.asarray(LEDS @ turned.T + pose[:2])


def record(path: Path, noise: float) -> Path:
    rng = np.random.default_rng(5)
    path.mkdir()
    rows = ["sequence,t_s,camera,file,leds,x_mm,y_mm,a_mm,b_mm,phi_deg"]
    for number, pose in enumerate(POSES):
        image = np.full((HEIGHT, WIDTH), 8.0)
        for place in placed(pose):
            add_disc(image, VIEW, place, DISC_MM, 150.0)
        image = cv2.GaussianBlur(image, (0, 0), 0.7)
        for sequence in range(FRAMES * number, FRAMES * (number + 1)):
            counts = image + rng.normal(0.0, noise, image.shape)
            pixels = np.clip(np.rint(counts), 0, 255).astype(np.uint8)
            cv2.imwrite(str(path / f"{sequence}.png"), pixels, STORED)
            known = ",".join(f"{of:g}" for of in pose)
            rows.append(f"{sequence},{sequence / 20},eye,{sequence}.png,on,,,{known}")
    (path / "recording.json").write_text(json.dumps(HEADER))
    (path / "frames.csv").write_text("\n".join(rows) + "\n")
    return path


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("planar") / "whole", NOISE)


@pytest.fixture
def copy(whole: Path, tmp_path: Path) -> Path:
    shutil.copytree(whole, tmp_path / "copy")
    return tmp_path / "copy"


def calibrated(*paths: Path) -> PlanarResult:
    return calibrate_planar([open_recording(path) for path in paths])


@pytest.fixture(scope="module")
def result(whole: Path) -> PlanarResult:
    return calibrated(whole)


def edit(path: Path, name: str, change: Callable[[str], str]) -> None:
    (path / name).write_text(change((path / name).read_text()))


def test_two_poses_give_the_camera_of_the_plate_s_plane(result: PlanarResult) -> None:
    made = result.calibration
    points = np.concatenate([placed(pose) for pose in POSES])
    assert made.fit.camera.to_mm(VIEW.to_px(points)) == pytest.approx(points, abs=0.05)
    assert made.known_phi_deg == (5.0, -20.0)
    assert made.disc_mm == DISC_MM
    assert (made.unit_serial, made.simulated, result.refused) == ("P-1", False, ())
    assert result.doubts == (
        "2 known poses: the lens's distortion and the error of the known poses are not seen, so sigma lacks "
        "them; 3 or more are needed",
    )


def test_the_noise_of_a_frame_follows_that_of_its_pixels(result: PlanarResult, tmp_path: Path) -> None:
    """Of 28 centres in three frames each, the scatter is known to 7 %."""
    quiet, loud = result.calibration, calibrated(record(tmp_path / "loud", 2 * NOISE)).calibration
    assert loud.frame_noise_px / quiet.frame_noise_px == pytest.approx(2.0, rel=0.25)


def test_an_led_s_diameter_is_measured_where_it_is_not_stated(copy: Path) -> None:
    edit(copy, "recording.json", lambda text: text.replace('"disc_mm": 5.0', '"disc_mm": null'))
    assert calibrated(copy).calibration.disc_mm == pytest.approx(DISC_MM, rel=0.05)


@pytest.mark.parametrize(
    ("name", "old", "new", "said"),
    [
        ("frames.csv", ",-14,9,-20", ",100,9,-20", "a_mm, b_mm, phi_deg are wrong: 0 of 7 lights are where"),
        ("recording.json", '"disc_mm": 5.0', '"disc_mm": 8.0', "plate.disc_mm is 8, but the LEDs look 5."),
        ("recording.json", '"disc_mm": 5.0', '"disc_mm": 3.5', "plate.disc_mm is 3.5, but the LEDs look 5."),
    ],
)
def test_what_contradicts_the_pictures_is_refused(
    copy: Path, name: str, old: str, new: str, said: str
) -> None:
    edit(copy, name, lambda text: text.replace(old, new))
    with pytest.raises(BadInputError) as refused:
        calibrated(copy)
    assert said in str(refused.value)


def test_rows_without_a_pose_and_another_plate_are_refused(whole: Path, copy: Path) -> None:
    edit(copy, "recording.json", lambda text: text.replace("-41.0", "-41.5"))
    with pytest.raises(BadInputError, match="plate: is not that of"):
        calibrated(whole, copy)
    edit(copy, "frames.csv", lambda text: text.replace(",2,-3,5", ",,,").replace(",-14,9,-20", ",,,"))
    with pytest.raises(BadInputError, match="no row has a known pose"):
        calibrated(copy)
