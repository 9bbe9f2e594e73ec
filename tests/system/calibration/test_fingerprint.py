"""The identity of a scan's cameras, from its header into the file of its calibration."""

import json
from pathlib import Path

from support.recordings import write_scan

from altd.calibration.calibrating import calibrate
from altd.calibration.file import load_calibration, save_calibration
from altd.recording.reader import open_recording
from altd.records import CameraIdentity


def test_the_file_carries_the_identities_of_the_scans_cameras(tmp_path: Path) -> None:
    scan = write_scan(tmp_path / "rec")
    header = json.loads((scan / "recording.json").read_text())
    front = {**header["cameras"]["front"], "serial": "F-7", "model": "mini", "driver": "aravis"}
    header["cameras"] = {**header["cameras"], "front": front}
    (scan / "recording.json").write_text(json.dumps(header))
    save_calibration(calibrate([open_recording(scan)]).calibration, tmp_path / "cal.json")
    known, unknown = load_calibration(tmp_path / "cal.json").targets
    assert known.camera == CameraIdentity("F-7", "mini", "aravis")
    assert unknown.camera == CameraIdentity()
