import csv
import json
from pathlib import Path

import cv2
import numpy as np

from hw_sim.faults import Fault
from hw_sim.flat import raster_mm, record_flat, record_laser_flat
from hw_sim.stage import Stage
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


def test_a_flat_of_the_laser_has_the_dark_first_and_then_the_spot_at_each_place(
    tmp_path: Path, unit: Unit
) -> None:
    stage = Stage(np.random.default_rng(1), sigma_mm=0.0)
    record_laser_flat(tmp_path / "flat", unit, stage, 20.0, 2, lambda _done, _planned: None)
    with (tmp_path / "flat" / "frames.csv").open(newline="") as table:
        rows = [row for row in csv.DictReader(table) if row["camera"] == "rear"]
    places = [(float(row["x_mm"]), float(row["y_mm"])) for row in rows if row["x_mm"]]
    assert [row["x_mm"] for row in rows[:3]] == ["", "", "-79.0000"]
    assert places == [tuple(np.round(place, 4)) for place in raster_mm(20.0, 9.0)]
    assert np.max(places, axis=0).tolist() == [79.0, 65.0]
    for row in (rows[0], rows[2 + len(places) // 2]):
        picture = cv2.imread(str(tmp_path / "flat" / row["file"]), cv2.IMREAD_UNCHANGED)
        smooth = cv2.GaussianBlur(picture.astype(np.float32), (0, 0), 4.0)
        if not row["x_mm"]:
            assert smooth.max() < 40
            continue
        v, u = np.unravel_index(smooth.argmax(), smooth.shape)
        x_mm, y_mm = unit.imagers["rear"].view.lens.unproject(float(u), float(v))
        assert np.hypot(x_mm - float(row["x_mm"]), y_mm - float(row["y_mm"])) < 1.5
