"""The header of a recording: its targets, limits, ``turned_deg``, and a plate of LEDs."""

import json
from pathlib import Path
from typing import Any

import pytest
from support.pngs import png
from support.recordings import header, seen, write_targets
from support.unit_toml import TARGETS

from altd.config import Target
from altd.config.measuring import ScanLimits
from altd.config.unit import target_headers
from altd.errors import BadInputError
from altd.recording.header import RecordingHeader, read_header
from altd.recording.reader import Recording, open_recording
from altd.recording.writer import RecordingWriter
from altd.records import Limits

SIZE = {"width": 752, "height": 480, "bits": 8}
TWO_CAMERAS = {"a": SIZE, "b": SIZE}


def shown(**more: Any) -> list[tuple[str, float, str]]:
    of_header = RecordingHeader.model_validate(header("scan") | more)
    return [(target.name, target.z_mm, target.camera) for target in of_header.shown_targets]


def test_without_the_key_front_and_rear_are_shown_where_their_cameras_are_there() -> None:
    unit = {"serial": "A", "target_distance_mm": 281.5}
    assert shown(unit=unit) == [("front", 0.0, "front"), ("rear", 281.5, "rear")]
    assert shown(unit=unit, cameras={"rear": SIZE, "spare": SIZE}) == [("rear", 281.5, "rear")]
    assert shown(unit=unit, cameras={"front": SIZE}) == [("front", 0.0, "front")]
    assert shown(unit=unit, cameras={"left": SIZE}) == []


def test_with_the_key_it_alone_decides_and_no_distance_is_needed() -> None:
    near = [seen("entry", 100.0, "b"), seen("exit", 100.5, "a")]
    assert shown(unit={"serial": "A"}, cameras=TWO_CAMERAS, targets=near)[1] == ("exit", 100.5, "a")
    targets = [seen("entry", -20.0, "b"), seen("exit", 900.0, "a")]
    for unit in ({"serial": "A"}, {"serial": "A", "target_distance_mm": 5.0}):
        assert shown(unit=unit, cameras=TWO_CAMERAS | {"front": SIZE}, targets=targets) == [
            ("entry", -20.0, "b"),
            ("exit", 900.0, "a"),
        ]


@pytest.mark.parametrize(
    ("targets", "complaint"),
    [
        ([seen("x", 0.0, "a"), seen("x", 1.0, "b")], "targets.1.name: 'x' is already that of targets.0"),
        ([seen("x", 0.0, "b"), seen("y", 1.0, "b")], "targets.1.camera: 'b' is already that of targets.0"),
        ([seen("x", 0.0, "a"), seen("y", 1.0, "c")], "targets.1.camera: 'c' is not one of the cameras"),
        (
            [seen("x", 0.0, "a"), seen("y", 0.0, "b")],
            "targets.1.z_mm: 0 must exceed z_mm of targets.0, 0",
        ),
        (
            [seen("x", 280.0, "a"), seen("y", -1.5, "b")],
            "targets.1.z_mm: -1.5 must exceed z_mm of targets.0, 280",
        ),
        ([], "targets: Tuple should have at least 1 item"),
        ([{"name": "x", "camera": "a"}], "targets.0.z_mm: Field required"),
        ([seen("x", float("nan"), "a")], "targets.0.z_mm: Input should be a finite number"),
        ([seen("x", 1e9, "a")], "targets.0.z_mm: Input should be less than or equal to 100000"),
        (
            [seen("x", 0.0, "a") | {"glass_mm": -4.0}],
            "targets.0.glass_mm: Input should be greater than or equal to 0",
        ),
        (
            [seen("x", 0.0, "a") | {"glass_mm": 4.0, "glass_index": 0.9}],
            "targets.0.glass_index: Input should be greater than or equal to 1",
        ),
        ([seen("X y", 0.0, "a")], "targets.0.name: String should match pattern"),
        ([seen("x" * 40, 0.0, "a")], "targets.0.name: String should have at most 32 characters"),
        ("front", "targets: Input should be a valid tuple"),
        (None, "unit.target_distance_mm: Field required where there are no targets"),
    ],
)
def test_a_mistake_is_a_line_that_names_file_and_key(tmp_path: Path, targets: object, complaint: str) -> None:
    file = tmp_path / "recording.json"
    about = header("scan", cameras=TWO_CAMERAS, unit={"serial": "A"}, targets=targets)
    file.write_text(json.dumps(about))
    with pytest.raises(BadInputError) as caught:
        read_header(file)
    assert str(caught.value).startswith(f"{file}: {complaint}")
    assert "\n" not in str(caught.value)


def test_the_targets_of_a_config_are_written_and_read_back(tmp_path: Path) -> None:
    config = [
        Target.model_validate(target | {"camera": f"{target['camera']}_cam"} | glass)
        for target, glass in zip(TARGETS, ({"glass_mm": 4.0}, {}), strict=True)
    ]
    about = header("scan", cameras={"front_cam": SIZE, "rear_cam": SIZE}, unit={"serial": "A"})
    wanted = RecordingHeader.model_validate(about | {"targets": target_headers(config)})
    RecordingWriter(tmp_path / "rec", wanted).close()
    assert read_header(tmp_path / "rec" / "recording.json") == wanted
    assert json.loads((tmp_path / "rec" / "recording.json").read_text())["targets"] == [
        {"name": "front", "z_mm": 0.0, "camera": "front_cam", "glass_mm": 4.0, "glass_index": 1.52},
        {"name": "rear", "z_mm": 280.0, "camera": "rear_cam"},
    ]


def test_a_recording_is_gone_on_with_only_of_the_same_targets(tmp_path: Path) -> None:
    """One that says them in words and one that has the usual ones without words are the same."""
    usual = [seen("front", 0.0, "front"), seen("rear", 280.0, "rear")]
    shots = [({"front": None, "rear": None}, None)]
    unit = {"serial": "A", "target_distance_mm": 280.0}
    rec = write_targets(tmp_path / "rec", "scan", usual, shots, unit=unit)
    known = open_recording(rec).header
    RecordingWriter(rec, known.model_copy(update={"targets": None}), 0).close()
    moved = tuple(target.model_copy(update={"z_mm": target.z_mm + 1}) for target in known.shown_targets)
    with pytest.raises(BadInputError, match="is of another unit, of other targets, of other cameras"):
        RecordingWriter(rec, known.model_copy(update={"targets": moved}), 0)


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


def test_joints_of_a_machine_are_read_with_poses_or_without(tmp_path: Path) -> None:
    columns = f"{COLUMNS},joint_1_mm,joint_2_mm,joint_3_mm"
    rows = ("0,0.0,eye,0.png,on,,,,,,120,-3.5,450", "1,0.05,eye,0.png,on,,,0.5,700,-180,,,")
    recording = written(tmp_path, None, *rows, columns=columns)
    assert [row.joints_mm for row in recording.rows] == [(120.0, -3.5, 450.0), None]
    assert [row.pose for row in recording.rows] == [None, (0.5, 700.0, -180.0)]


def test_a_table_without_the_columns_has_no_pose(tmp_path: Path) -> None:
    columns = COLUMNS.removesuffix(",a_mm,b_mm,phi_deg")
    recording = written(tmp_path, None, "0,0.0,eye,0.png,on,,", columns=columns)
    assert [row.pose for row in recording.rows] == [None]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"plate": None}, "plate.leds_mm: Field required in a recording of kind 'planar'"),
        ({"plate": {"columns": 7}}, "plate.leds_mm: Field required in a recording of kind 'planar'"),
        ({"plate": {"leds_mm": LEDS[:4]}}, "plate.leds_mm: Tuple should have at least 5 items"),
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
        ("0,0.0,eye,0.png,on,,,1,,", "a_mm, b_mm, phi_deg must all be given or all be empty"),
        ("0,0.0,eye,0.png,on,,,1,2", "a_mm, b_mm, phi_deg must all be given or all be empty"),
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


def test_limits_are_read_and_those_that_are_absent_are_known_as_not_stated() -> None:
    limits = {"stage_scale_ppm": 50, "beam_normal_mm_per_m": 0.3, "colour": "red"}
    read = RecordingHeader.model_validate(header("scan") | {"limits": limits, "turned_deg": 180})
    assert read.limits == Limits(stage_scale_ppm=50.0, beam_normal_mm_per_m=0.3)
    assert read.limits.not_stated == ("stage_mm", "stage_square_mrad", "target_distance_mm", "temperature_k")
    assert read.turned_deg == 180.0


def test_without_the_keys_nothing_is_stated_and_the_unit_was_not_turned() -> None:
    read = RecordingHeader.model_validate(header("scan"))
    assert (read.limits, read.turned_deg) == (None, 0.0)


def test_what_altd_scan_writes_is_what_its_settings_state() -> None:
    assert ScanLimits().record is None
    stated = ScanLimits(stage_mm=0.005).record
    assert stated == Limits(stage_mm=0.005)
    written = RecordingHeader.model_validate(header("scan") | {"limits": stated}).model_dump_json()
    assert RecordingHeader.model_validate_json(written).limits == stated


@pytest.mark.parametrize(
    ("more", "place"),
    [
        ({"limits": {"stage_mm": -0.001}}, "stage_mm: -0.001 is not an uncertainty; possible: 0 to 1000"),
        ({"limits": {"stage_scale_ppm": 1e9}}, "stage_scale_ppm: 1e+09 is not an uncertainty"),
        ({"limits": {"stage_mm": "good"}}, "limits.stage_mm"),
        ({"limits": 0.1}, "limits"),
        ({"turned_deg": 90}, "turned_deg: possible: 0, 180, not 90"),
    ],
)
def test_what_is_no_limit_is_refused_by_its_key(more: dict[str, object], place: str, tmp_path: Path) -> None:
    file = tmp_path / "recording.json"
    file.write_text(json.dumps(header("scan") | more))
    with pytest.raises(BadInputError, match=place.replace("+", r"\+")):
        read_header(file)
