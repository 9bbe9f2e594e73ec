"""Recordings of many frames, and a scan whose table lacks some."""

import json
import sys
import tracemalloc
from pathlib import Path

import cv2
import numpy as np
from support.cli import altd_here
from support.played_unit import PlayedUnit
from support.recordings import header

from altd.recording.reader import open_recording


def test_rows_take_no_memory(tmp_path: Path) -> None:
    """30,000 of them would take 10 MB."""
    path = tmp_path / "rec"
    path.mkdir()
    size = {"width": 16, "height": 16, "bits": 8}
    (path / "recording.json").write_text(json.dumps(header("measurement") | {"cameras": {"front": size}}))
    cv2.imwrite(str(path / "f.png"), np.zeros((16, 16), np.uint8))
    rows = (f"{number},{number / 20:.6f},front,f.png,off,," for number in range(30_000))
    (path / "frames.csv").write_text("\n".join(["sequence,t_s,camera,file,leds,x_mm,y_mm", *rows]))
    kept_name = sys.intern("f.png")  # dropped, it is interned for each row, and the table of 3.13 grows
    tracemalloc.start()
    try:
        opened = open_recording(path)
        assert len(opened.rows) == sum(1 for _ in opened.rows) == 30_000
        assert (opened.rows.first.sequence, opened.rows.last.sequence) == (0, 29_999)
        assert tracemalloc.get_traced_memory()[1] < 4e6
        assert opened.rows.last.file == kept_name
    finally:
        tracemalloc.stop()


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
