"""A scan whose table lacks frames, through the calibration."""

from pathlib import Path

from support.cli import altd_here
from support.played_unit import PlayedUnit


def test_calibrate_names_them_too(played_unit: PlayedUnit, tmp_path: Path) -> None:
    scan = tmp_path / "scan"
    scan.mkdir()
    for picture in (played_unit.folder / "scan").glob("*.png"):
        (scan / picture.name).symlink_to(picture)
    (scan / "recording.json").write_text((played_unit.folder / "scan" / "recording.json").read_text())
    rows = (played_unit.folder / "scan" / "frames.csv").read_text().splitlines()
    del rows[-5]  # the rear's of the third exposure from the end
    (scan / "frames.csv").write_text("\n".join(rows) + "\n")
    outcome = altd_here("calibrate", scan, "-o", tmp_path / "cal.json")
    assert outcome.status == 0
    line = f"altd calibrate: {scan}/frames.csv: row 56: sequence 27 has no row of camera 'rear'"
    assert line in outcome.err.splitlines()
