"""Which targets a calibration has: those of the recordings' headers, whatever cameras look at them."""

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from support.plates import write_plates
from support.recordings import seen, write_scan, write_scan_of, write_targets

from altd.calibration.target_frames import target_frames
from altd.errors import BadInputError
from altd.recording.reader import open_recording
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
