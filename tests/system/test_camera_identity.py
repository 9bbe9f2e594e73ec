"""Identity of a camera, from its driver into recordings, calibrations and the daemon."""

import json
from pathlib import Path

import pytest
from support.cli import altd_here
from support.recordings import write_beams, write_scan

from altd.devices.v4l2 import node
from altd.records import CameraIdentity
from hw_sim.camera import make_cameras
from hw_sim.unit import Unit, UnitConfig


def named(folder: Path, camera: str, **identity: str) -> Path:
    """A recording whose header says which camera it was."""
    header = json.loads((folder / "recording.json").read_text())
    header["cameras"] = {name: dict(size) for name, size in header["cameras"].items()}
    header["cameras"][camera] |= identity
    (folder / "recording.json").write_text(json.dumps(header))
    return folder


def test_a_recording_of_another_camera_is_refused_in_one_line(tmp_path: Path) -> None:
    scan = named(write_scan(tmp_path / "scan", columns=5, rows=4), "rear", serial="R-1", driver="aravis")
    assert altd_here("calibrate", scan, "-o", tmp_path / "cal.json").status == 0
    poses = write_beams(tmp_path / "poses", [(3.0, 4.0, 0.0, 0.0)])
    command = ("replay", poses, "--calibration", tmp_path / "cal.json", "--window", 4, "--every", 4)
    assert altd_here(*command).status == 0  # the recording does not say which camera it was
    named(poses, "rear", serial="R-2", driver="aravis")
    refused = altd_here(*command)
    assert refused.status == 2
    assert refused.out == ""
    assert refused.err.count("\n") == 1
    assert (
        "target 'rear' was calibrated with another camera: its serial is 'R-2', expected 'R-1'" in refused.err
    )
    named(poses, "rear", serial="R-1")
    assert altd_here(*command).status == 0


def test_cameras_that_are_exchanged_in_a_recording_are_refused(tmp_path: Path) -> None:
    scan = write_scan(tmp_path / "scan", columns=5, rows=4)
    poses = write_beams(tmp_path / "poses", [(3.0, 4.0, 0.0, 0.0)])
    for camera, at_scan, now in (("front", "1", "2"), ("rear", "2", "1")):
        named(scan, camera, serial=at_scan)
        named(poses, camera, serial=now)
    assert altd_here("calibrate", scan, "-o", tmp_path / "cal.json").status == 0
    refused = altd_here("replay", poses, "--calibration", tmp_path / "cal.json")
    assert (refused.status, refused.out) == (2, "")
    assert (
        "another camera: its serial is '2', expected '1': it is the camera of target 'rear', " in refused.err
    )
    assert "the cameras are swapped" in refused.err


@pytest.mark.parametrize(
    ("one", "other", "words"),
    [
        (CameraIdentity("1"), CameraIdentity("2"), "its serial is '1', expected '2'"),
        (CameraIdentity("1", "a"), CameraIdentity("1", "b"), "its model is 'a', expected 'b'"),
        (CameraIdentity("1", "a", "v4l2"), CameraIdentity("2", "b", "aravis"), ""),
        (CameraIdentity("1", "a"), CameraIdentity(), ""),
        (CameraIdentity(), CameraIdentity("1", "a", "v4l2"), ""),
        (CameraIdentity("1", "a", "v4l2"), CameraIdentity("1", "a", "v4l2"), ""),
    ],
)
def test_only_what_both_know_tells_two_cameras_apart(
    one: CameraIdentity, other: CameraIdentity, words: str
) -> None:
    assert one.difference_from(other) == words


def test_a_usb_camera_has_the_serial_of_its_descriptor(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The kernel's layout (Documentation/ABI/testing/sysfs-bus-usb) in a folder: no USB camera is here."""
    usb = tmp_path / "devices" / "usb1" / "1-1"
    (usb / "1-1:1.0" / "video4linux" / "video0").mkdir(parents=True)
    (usb / "serial").write_text("SN0001\n")
    number = Path("/dev/null").stat().st_rdev
    entry = tmp_path / "char" / f"{number >> 8}:{number & 255}"
    entry.mkdir(parents=True)
    (entry / "device").symlink_to(usb / "1-1:1.0")
    monkeypatch.setattr(node, "CHARACTER_DEVICES", tmp_path / "char")
    with Path("/dev/null").open() as device:
        assert node.usb_serial(device.fileno()) == "SN0001"
        (usb / "serial").unlink()
        assert node.usb_serial(device.fileno()) is None


def test_simulated_cameras_have_names_of_their_own() -> None:
    front, rear = make_cameras(Unit(UnitConfig(seed=3)), real_time=False)
    assert front.identity == CameraIdentity("SIM-3-front", "simulated", "hw_sim")
    assert front.identity.difference_from(rear.identity)
