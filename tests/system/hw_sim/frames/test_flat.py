from __future__ import annotations

import csv
import json
from pathlib import Path

import cv2
import numpy as np

from hw_sim.faults import Fault
from hw_sim.flat import record_flat
from hw_sim.unit import Unit


def test_a_flat_is_the_dark_and_the_evenly_lit_targets_without_the_laser(tmp_path: Path, unit: Unit) -> None:
    record_flat(tmp_path / "flat", unit, 2, lambda _done, _planned: None)
    assert json.loads((tmp_path / "flat" / "recording.json").read_text())["kind"] == "flat"
    with (tmp_path / "flat" / "frames.csv").open(newline="") as table:
        rows = list(csv.DictReader(table))
    assert [row["leds"] for row in rows if row["camera"] == "front"] == ["off", "off", "on", "on"]
    assert {row["x_mm"] for row in rows} == {""}
    for camera, imager in unit.imagers.items():
        pictures = [
            cv2.imread(str(tmp_path / "flat" / row["file"]), cv2.IMREAD_UNCHANGED).astype(float)
            for row in rows
            if row["camera"] == camera
        ]
        light = (pictures[2] + pictures[3] - pictures[0] - pictures[1]).ravel()
        dark = (pictures[0] + pictures[1]).ravel() / 2
        usable = dark < 60  # no hot pixel
        assert dark.mean() < 20
        assert np.corrcoef(light[usable], imager.view.response.ravel()[usable])[0, 1] > 0.9
        assert np.percentile(pictures[2], 99.9) < 255
    assert Fault.NO_LASER not in unit.faults
