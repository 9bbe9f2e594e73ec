"""Which targets and flats a calibration takes from recordings; flats of a unit: ``tests/system``."""

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from support.plates import write_plates
from support.recordings import header, seen, write_scan, write_scan_of, write_targets

from altd.calibration.recorded_flat import flats_of
from altd.calibration.target_frames import target_frames
from altd.errors import BadInputError
from altd.recording.reader import Recording, open_recording
from altd.records import Glass

SIZE = {"width": 752, "height": 480, "bits": 8}


def refused(*recordings: Path) -> str:
    with pytest.raises(BadInputError) as caught:
        target_frames([open_recording(path) for path in recordings])
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.fixture(scope="module")
def rear(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("rear")
    identity = {"serial": "7", "model": "mini", "driver": "aravis"}
    return write_scan_of(folder / "rear", seen("rear", 280.0, "cam"), of_cameras=identity)


@pytest.mark.parametrize(
    ("target", "more", "complaint"),
    [
        (seen("front", 0.0, "a"), {"serial": "TEST-2"}, "is of unit 'TEST-2', {rear} of unit 'TEST-1'"),
        (seen("rear", 281.0, "a"), {}, "target 'rear' is at z 281 mm, in {rear} at 280 mm"),
        (seen("front", 280.0, "a"), {}, "target 'front' is at z 280 mm, where target 'rear' of {rear} is"),
        (
            seen("rear", 280.0, "cam"),
            {"of_cameras": {"serial": "8", "driver": "aravis"}},
            "target 'rear' is seen by another camera than in {rear}: its serial is '8', expected '7'",
        ),
    ],
)
def test_recordings_that_do_not_go_together_are_refused(
    rear: Path, tmp_path: Path, target: dict[str, object], more: dict[str, Any], complaint: str
) -> None:
    other = write_scan_of(tmp_path / "other", target, **more)
    assert refused(rear, other) == f"{other / 'recording.json'}: {complaint.format(rear=rear)}"


def test_the_glass_of_a_target_is_that_of_the_scan_that_states_it(rear: Path, tmp_path: Path) -> None:
    scans = [
        write_scan_of(tmp_path / name, seen("rear", 280.0, "cam") | {"glass_mm": thick})
        for name, thick in (("thin", 3.0), ("thick", 4.0))
    ]
    (frames,) = target_frames([open_recording(path) for path in (rear, scans[1])])
    assert frames.glass == Glass(4.0, 1.52)
    assert refused(rear, *scans) == (
        f"{scans[1] / 'recording.json'}: target 'rear' has 4 mm of glass (index 1.52) behind it, "
        f"in {scans[0]} 3 mm of glass (index 1.52)"
    )


def test_pictures_of_another_size_are_refused(rear: Path, tmp_path: Path) -> None:
    targets = [seen("rear", 280.0, "cam")]
    other = write_targets(tmp_path / "other", "scan", targets, [({"rear": None}, (0.0, 0.0))])
    cv2.imwrite(str(other / "cam0000.png"), np.zeros((480, 640), np.uint8))
    about = json.loads((other / "recording.json").read_text())
    about["cameras"]["cam"]["width"] = 640
    (other / "recording.json").write_text(json.dumps(about))
    assert refused(rear, other) == (
        f"{other / 'recording.json'}: target 'rear' has pictures of 640 × 480, in {rear} of 752 × 480"
    )


def test_a_scan_and_a_plate_or_two_plates_of_one_target_are_refused(rear: Path, tmp_path: Path) -> None:
    plates = [
        write_plates(
            tmp_path / name,
            {"cam": np.zeros((480, 752))},
            pairs=1,
            cameras={"cam": SIZE},
            targets=[seen("rear", 280.0, "cam")],
        )
        for name in ("plate", "again")
    ]
    file = "recording.json: target 'rear'"
    assert refused(rear, plates[0]) == f"{plates[0]}/{file} is shown by a plate here and by a scan in {rear}"
    assert refused(*plates) == f"{plates[1]}/{file} is shown by the plate in {plates[0]} already"


def test_a_recording_given_twice_and_one_without_a_target_are_refused(rear: Path, tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(rear)
    assert refused(rear, tmp_path / "link") == f"{tmp_path / 'link'}: is given twice"
    nameless = write_scan_of(tmp_path / "nameless", seen("rear", 280.0, "cam"))
    about = json.loads((nameless / "recording.json").read_text())
    del about["targets"]
    about["unit"]["target_distance_mm"] = 280.0
    (nameless / "recording.json").write_text(json.dumps(about))
    assert refused(nameless).endswith(
        "recording.json: has neither `targets` nor a camera 'front' or 'rear': it shows no target"
    )


def test_a_scan_by_the_front_camera_alone_needs_no_list_of_targets(tmp_path: Path) -> None:
    scan = write_scan(tmp_path / "scan")
    about = json.loads((scan / "recording.json").read_text())
    del about["cameras"]["rear"]
    (scan / "recording.json").write_text(json.dumps(about))
    lines = (scan / "frames.csv").read_text().splitlines(keepends=True)
    (scan / "frames.csv").write_text("".join(line for line in lines if ",rear," not in line))
    (frames,) = target_frames([open_recording(scan)])
    assert (frames.name, frames.z_mm, len(frames)) == ("front", 0.0, 30)


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
