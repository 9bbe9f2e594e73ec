"""Recordings of kind ``planar``: the plate's LEDs, and its known poses."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from support.pngs import png

from altd.errors import BadInputError
from altd.recording.reader import Recording, open_recording

LEDS = [[-40.0, -32.0], [38.0, -30.0], [44.0, 12.0], [-44.0, 20.0], [6.0, 40.0]]
HEADER: dict[str, Any] = {
    "format": "altd-recording/1",
    "kind": "planar",
    "fps": 20.0,
    "cameras": {"eye": {"width": 32, "height": 16, "bits": 8}},
    "unit": {"serial": "P-1"},
    "plate": {"leds_mm": LEDS, "disc_mm": 5.0},
}
COLUMNS = "sequence,t_s,camera,file,leds,x_mm,y_mm,a_mm,b_mm,phi_deg"
ROWS = ("0,0.0,eye,0.png,on,,,0.5,700,-180", "1,0.05,eye,0.png,on,,,,,")


def written(path: Path, header: Any = None, *rows: str, columns: str = COLUMNS) -> Recording:
    (path / "0.png").write_bytes(png(32, 16))
    (path / "recording.json").write_text(json.dumps(header or HEADER))
    (path / "frames.csv").write_text("\n".join([columns, *(rows or ROWS)]) + "\n")
    return open_recording(path)


def test_leds_and_poses_are_read_and_no_target_distance_is_needed(tmp_path: Path) -> None:
    recording = written(tmp_path)
    assert [list(place) for place in recording.header.plate.leds_mm] == LEDS  # type: ignore[union-attr]
    assert [row.pose for row in recording.rows] == [(0.5, 700.0, -180.0), None]


def test_a_table_without_the_columns_has_no_pose(tmp_path: Path) -> None:
    columns = COLUMNS.removesuffix(",a_mm,b_mm,phi_deg")
    recording = written(tmp_path, None, "0,0.0,eye,0.png,on,,", columns=columns)
    assert [row.pose for row in recording.rows] == [None]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"plate": None}, "plate.leds_mm: Field required in a recording of kind 'planar'"),
        ({"plate": {"columns": 7}}, "plate.leds_mm: Field required in a recording of kind 'planar'"),
        ({"plate": {"leds_mm": LEDS[:3]}}, "plate.leds_mm: Tuple should have at least 4 items"),
        ({"plate": {"leds_mm": [*LEDS, [1.0]]}}, "plate.leds_mm.5.1: Field required"),
        ({"plate": {"leds_mm": [*LEDS, [1.0, 2e4]]}}, "plate.leds_mm.5.1: Input should be less"),
        ({"plate": {"leds_mm": [*LEDS, LEDS[1]]}}, "plate: leds_mm.5: [38.0, -30.0] is the place"),
        ({"plate": {"leds_mm": LEDS, "disc_mm": 0}}, "plate.disc_mm: Input should be greater than 0"),
        (
            {"cameras": dict.fromkeys(("eye", "other"), HEADER["cameras"]["eye"])},
            "cameras: a recording of kind 'planar' has one, not 2",
        ),
    ],
)
def test_a_wrong_header_is_refused_by_its_key(tmp_path: Path, change: dict[str, Any], said: str) -> None:
    with pytest.raises(BadInputError) as refused:
        written(tmp_path, HEADER | change)
    assert str(refused.value).startswith(f"{tmp_path / 'recording.json'}: {said}")


@pytest.mark.parametrize(
    ("row", "said"),
    [
        ("0,0.0,eye,0.png,on,,,1,,", "a_mm, b_mm and phi_deg must all be given or all be empty"),
        ("0,0.0,eye,0.png,on,,,1,2", "a_mm, b_mm and phi_deg must all be given or all be empty"),
        ("0,0.0,eye,0.png,on,,,1,nan,3", "b_mm 'nan' is not a number"),
        ("0,0.0,eye,0.png,on,,,1,2,361", "phi_deg '361' is larger than 360"),
        ("0,0.0,eye,0.png,on,,,2e4,2,0", "a_mm '2e4' is larger than 10000"),
    ],
)
def test_a_wrong_pose_is_refused_by_its_row(tmp_path: Path, row: str, said: str) -> None:
    with pytest.raises(BadInputError) as refused:
        written(tmp_path, None, row)
    assert str(refused.value) == f"{tmp_path / 'frames.csv'}: row 2: {said}"


def test_a_column_of_the_pose_that_is_missing_is_named(tmp_path: Path) -> None:
    columns = COLUMNS.removesuffix(",phi_deg")
    with pytest.raises(BadInputError, match="row 1: column 'phi_deg' is missing"):
        written(tmp_path, None, "0,0.0,eye,0.png,on,,,1,2", columns=columns)
