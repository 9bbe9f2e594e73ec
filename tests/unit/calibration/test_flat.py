"""Flats of pictures that a test paints; those of a simulated unit: ``tests/system/calibration``."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.cli import altd_here, refusal
from support.recordings import header, write_scan

from altd.calibration.recorded_flat import flats_of
from altd.calibration.target_frames import target_frames
from altd.errors import BadInputError
from altd.recording.reader import Recording, open_recording


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
        ({"lit": np.full((480, 640), 90)}, "front: frames of 640 × 480, those of the scan are 752 × 480"),
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
