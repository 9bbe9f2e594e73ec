"""The areas of the targets are what the maps take, and no target's name is that of something else."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.cli import altd_here
from support.played_unit import PlayedUnit
from support.recordings import seen, write_targets
from support.unit_toml import played_toml

from altd.app.calibration_summary import target_areas_of
from altd.app.replay import open_replay
from altd.app.settings import load_settings
from altd.calibration.file import load_calibration, save_calibration
from altd.errors import BadInputError
from altd.records.sensors import Quality, SensorValue
from altd.status.measurement_json import as_scan_object, checked_line
from altd.status.models import targets_of
from tools.pages.example import MEASURED, STAMP, board


def inside(corners: tuple[tuple[float, float], ...], place: tuple[float, float]) -> bool:
    """By the winding of a convex, counter-clockwise outline."""
    ends = [*corners[1:], *corners[:1]]
    return all(
        (x1 - x0) * (place[1] - y0) - (y1 - y0) * (place[0] - x0) >= 0
        for (x0, y0), (x1, y1) in zip(corners, ends, strict=True)
    )


def test_a_spot_is_valid_inside_and_nowhere_outside(played_unit: PlayedUnit) -> None:
    calibration = load_calibration(played_unit.calibration, "TEST-1")
    areas = target_areas_of(load_settings(played_unit.config), calibration)
    assert [area.name for area in areas] == ["front", "rear"]
    for area, known in zip(areas, calibration.targets, strict=True):
        for turn in np.linspace(0.0, 2 * math.pi, 60):
            for radius in np.arange(5.0, 130.0, 2.5):
                place = (float(radius * math.cos(turn)), float(radius * math.sin(turn)))
                outside_mm = float(known.inverse.outside_mm(*place))
                if outside_mm <= known.map.margin_mm - 0.02:
                    assert inside(area.valid_mm, place), place
                if outside_mm > known.map.margin_mm + 0.02:
                    assert not inside(area.valid_mm, place), place
    document = targets_of(areas).as_object()
    assert document["area_mm"] == [140.0, 110.0]


WITH_ROLL = replace(MEASURED, from_sensors={"roll_deg": SensorValue(Quality.FROZEN)})
SENT = json.loads(checked_line(board(), WITH_ROLL, STAMP))
WRITTEN = as_scan_object(WITH_ROLL, (0.0, 0.0))


def complaints(tmp_path: Path, name: str) -> list[str]:
    """The complaint about a unit whose rear target has this name."""
    path = tmp_path / "altd.toml"
    path.write_text(played_toml("cal.json", "rec").replace('name = "rear"', f'name = "{name}"'))
    with pytest.raises(BadInputError) as caught:
        load_settings(path)
    return [line.removeprefix(f"{path}: ") for line in caught.value.lines]


@pytest.mark.parametrize("key", sorted({*SENT, *WRITTEN} - {*MEASURED.targets}))
def test_a_key_of_the_measurement_is_no_name_of_a_target(tmp_path: Path, key: str) -> None:
    text = f'targets.1.name: "{key}" is a key of the measurement in JSON; possible: another name'
    assert complaints(tmp_path, key) == [f"line 11, column 8: {text}"]


def test_what_was_sent_has_the_keys_that_are_tried() -> None:
    """So that the test above does not end up with nothing to try."""
    assert {*SENT, *WRITTEN} >= {"sequence", "sensors", "rates", "unit", "session", "crc32", "known_x_mm"}


def test_two_columns_of_a_table_have_not_one_name(tmp_path: Path) -> None:
    (line,) = complaints(tmp_path, "known")
    assert "makes known_x_mm of its own, which is a column of the measurement; possible: " in line


@pytest.mark.parametrize("name", ["front_2", "middle", "state", "units", "rear_dx_mm"])
def test_other_names_are_good(tmp_path: Path, name: str) -> None:
    path = tmp_path / "altd.toml"
    path.write_text(played_toml("cal.json", "rec").replace('name = "rear"', f'name = "{name}"'))
    assert load_settings(path).targets[1].name == name


def test_a_calibration_with_such_a_name_is_not_replayed(played_unit: PlayedUnit, tmp_path: Path) -> None:
    calibration = played_unit.result.calibration
    front, *others = calibration.targets
    path = tmp_path / "cal.json"
    save_calibration(replace(calibration, targets=(replace(front, name="valid"), *others)), path)
    with pytest.raises(BadInputError) as caught:
        open_replay(played_unit.beams, path)
    assert caught.value.lines == (
        f"{path}: target 'valid' is a key of the measurement in JSON: calibrate with another name",
    )


def test_a_recording_with_such_a_name_is_not_calibrated_from(tmp_path: Path) -> None:
    targets = [seen("front", 0.0, "a"), seen("sigma", 280.0, "b")]
    shot = ({"front": None, "sigma": None}, (0.0, 0.0))
    recorded = write_targets(tmp_path / "rec", "scan", targets, [shot])
    said = altd_here("calibrate", recorded, "-o", tmp_path / "cal.json")
    assert (said.status, said.out) == (2, "")
    assert said.err == (
        f"altd calibrate: {recorded}: target 'sigma' is a key of the measurement in JSON: "
        "record it with another name\n"
    )
    assert not (tmp_path / "cal.json").exists()
