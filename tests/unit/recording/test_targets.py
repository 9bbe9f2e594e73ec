"""``targets`` of a recording's header: which targets it shows, and which camera looks at each."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from support.recordings import header, seen, write_targets
from support.unit_toml import TARGETS

from altd.config import Target
from altd.errors import BadInputError
from altd.recording.header import RecordingHeader, read_header, target_headers
from altd.recording.reader import open_recording
from altd.recording.writer import RecordingWriter

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
    targets = [seen("entry", -20.0, "b"), seen("exit", 900.0, "a")]
    for unit in ({"serial": "A"}, {"serial": "A", "target_distance_mm": 5.0}):
        assert shown(unit=unit, cameras=TWO_CAMERAS | {"front": SIZE}, targets=targets) == [
            ("entry", -20.0, "b"),
            ("exit", 900.0, "a"),
        ]


@pytest.mark.parametrize(
    ("targets", "complaint"),
    [
        (
            [seen("x", 0.0, "a"), seen("x", 1.0, "b")],
            "targets.1.name: 'x' is the name of targets.0 too",
        ),
        (
            [seen("x", 0.0, "b"), seen("y", 1.0, "b")],
            "targets.1.camera: 'b' is the camera of targets.0 too",
        ),
        ([seen("x", 0.0, "a"), seen("y", 1.0, "c")], "targets.1.camera: 'c' is not one of the cameras"),
        (
            [seen("x", 0.0, "a"), seen("y", 0.0, "b")],
            "targets.1.z_mm: 0 is not behind targets.0, 0: targets must be in beam order",
        ),
        (
            [seen("x", 280.0, "a"), seen("y", -1.5, "b")],
            "targets.1.z_mm: -1.5 is not behind targets.0, 280: targets must be in beam order",
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
def test_a_mistake_is_one_line_that_names_file_and_key(
    tmp_path: Path, targets: object, complaint: str
) -> None:
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
    rec = write_targets(
        tmp_path / "rec", "scan", usual, shots, unit={"serial": "A", "target_distance_mm": 280.0}
    )
    known = open_recording(rec).header
    RecordingWriter(rec, known.model_copy(update={"targets": None}), 0).close()
    moved = tuple(target.model_copy(update={"z_mm": target.z_mm + 1}) for target in known.shown_targets)
    with pytest.raises(BadInputError, match="is of another unit, of other targets, of other cameras"):
        RecordingWriter(rec, known.model_copy(update={"targets": moved}), 0)
