"""No target takes the place of something else in what is published."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from support.cli import altd_here
from support.played_unit import PlayedUnit
from support.recordings import seen, write_targets
from support.unit_toml import played_toml

from altd.app.replay import open_replay
from altd.app.settings import load_settings
from altd.calibration.file import save_calibration
from altd.errors import BadInputError
from altd.records.sensors import Quality, SensorValue
from altd.status.measurement_json import as_scan_object, checked_line
from tools.pages.example import MEASURED, STAMP, board

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
    recorded = write_targets(
        tmp_path / "rec", "scan", targets, [({"front": None, "sigma": None}, (0.0, 0.0))]
    )
    said = altd_here("calibrate", recorded, "-o", tmp_path / "cal.json")
    assert (said.status, said.out) == (2, "")
    assert said.err == (
        f"altd calibrate: {recorded}: target 'sigma' is a key of the measurement in JSON: "
        "record it with another name\n"
    )
    assert not (tmp_path / "cal.json").exists()
