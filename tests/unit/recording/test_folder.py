import json
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.frames import Blob, frame, light
from support.recordings import header, write_beams

from altd.errors import BadInputError
from altd.recording.header import CameraHeader, RecordingHeader, UnitHeader
from altd.recording.reader import open_recording
from altd.recording.writer import RecordingWriter


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    return write_beams(tmp_path / "rec", [(0, 0, 0, 0)], exposures=2)


def edit(path: Path, row: int, old: str, new: str) -> None:
    """Replace text in one line of frames.csv; the header is row 1."""
    lines = (path / "frames.csv").read_text().splitlines()
    assert old in lines[row - 1]
    lines[row - 1] = lines[row - 1].replace(old, new)
    (path / "frames.csv").write_text("\n".join(lines) + "\n")


def complaint(path: Path) -> str:
    with pytest.raises(BadInputError) as caught:
        open_recording(path)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_rows_and_frames_are_read_and_unknown_columns_ignored(recording: Path) -> None:
    opened = open_recording(recording)
    assert [(row.sequence, row.camera, row.t_s) for row in opened.rows] == [
        (0, "front", 0.0),
        (0, "rear", 0.0),
        (1, "front", 0.05),
        (1, "rear", 0.05),
    ]
    first = opened.frame([*opened.rows][2])
    expected = cv2.imread(str(recording / "front0001.png"), cv2.IMREAD_UNCHANGED)
    assert np.array_equal(first.pixels, expected)
    assert (first.sequence, first.t_ns, first.bits) == (1, 50_000_000, 8)
    assert not first.pixels.flags.writeable


def test_a_row_says_whether_the_frame_leds_were_on(recording: Path) -> None:
    edit(recording, 3, ",off,", ",on,")
    opened = open_recording(recording)
    assert [row.leds_on for row in opened.rows] == [False, True, False, False]
    assert [opened.frame(row).leds_on for row in opened.rows] == [False, True, False, False]


@pytest.mark.parametrize(
    ("row", "old", "new", "message"),
    [
        (3, "rear0000.png", "gone.png", "frames.csv: row 3: gone.png: No such file or directory"),
        (3, "rear0000.png", "../../x.png", "row 3: file '../../x.png' is not a path inside the recording"),
        (3, "rear0000.png", "/etc/passwd", "row 3: file '/etc/passwd' is not a path inside the recording"),
        (4, "0.050000", "soon", "row 4: t_s 'soon' is not a number"),
        (4, "0.050000", "nan", "row 4: t_s 'nan' is not a number"),
        (2, "0.000000", "1.0", "row 4: t_s 0.05 is before the camera's frame above it"),
        (2, "0.000000", "0.05", "row 4: t_s 0.05 is that of the camera's frame above it, row 2"),
        (4, "1,0.05", "0,0.05", "row 4: sequence 0 is that of the camera's frame above it, row 2"),
        (2, "0,0.0", "7,0.0", "row 4: sequence 1 is before the camera's frame above it, row 2"),
        (2, "0,0.0", "1e300,0.0", "row 2: sequence '1e300' is larger than"),
        (2, "0.000000", "-1e300", "row 2: t_s '-1e300' is larger than 1e+09"),
        (2, "0.000000", "inf", "row 2: t_s 'inf' is not a number"),
        (2, ",off,,,", ",off,1e300,0,", "row 2: x_mm '1e300' is larger than 10000"),
        (2, ",off,,,", ",off,0,nan,", "row 2: y_mm 'nan' is not a number"),
        (2, "front,", "left,", "row 2: camera 'left' is not in recording.json"),
        (2, "off", "dim", "row 2: leds must be on or off, not 'dim'"),
        (2, ",off,,,", ",off,1.0,,", "row 2: x_mm and y_mm must both be given or both be empty"),
        (2, "0,0.0", "0.5,0.0", "row 2: sequence '0.5' is not a whole number"),
        (5, ",0.050000,rear,rear0001.png,off,,,", ",0.05", "row 5: is torn: 2 fields"),
        (1, "leds", "lamps", "row 1: column 'leds' is missing"),
        (1, ",", ";", "row 1: column 'sequence' is missing; columns are separated by commas"),
    ],
)
def test_a_bad_row_is_named(recording: Path, row: int, old: str, new: str, message: str) -> None:
    edit(recording, row, old, new)
    assert message in complaint(recording)


def test_a_frame_of_the_wrong_size_or_depth_is_named_before_anything_is_decoded(recording: Path) -> None:
    cv2.imwrite(str(recording / "rear0001.png"), np.zeros((480, 750), np.uint8))
    assert "row 5: rear0001.png is 750 × 480, expected 752 × 480" in complaint(recording)
    cv2.imwrite(str(recording / "rear0001.png"), np.zeros((480, 752, 3), np.uint8))
    assert "row 5: rear0001.png is not a grey PNG of 8 bits" in complaint(recording)
    (recording / "rear0001.png").write_bytes(b"GIF89a" + bytes(40))
    assert "row 5: rear0001.png is not a PNG" in complaint(recording)


def test_a_damaged_frame_is_named_when_it_is_decoded(recording: Path) -> None:
    path = recording / "front0001.png"
    path.write_bytes(path.read_bytes()[:200])
    opened = open_recording(recording)
    with pytest.raises(BadInputError, match=r"row 4: front0001\.png cannot be decoded"):
        opened.frame([*opened.rows][2])


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("format", "altd-recording/2", "format"),
        ("kind", "movie", "kind"),
        ("fps", "fast", "fps"),
        ("cameras", {}, "cameras"),
        ("unit", {"serial": "A"}, "unit.target_distance_mm"),
        (
            "unit",
            {"serial": "A", "target_distance_mm": float("nan")},
            "unit.target_distance_mm: Input should",
        ),
        ("unit", {"serial": "A", "target_distance_mm": 1e200}, "unit.target_distance_mm: Input should"),
        ("fps", float("inf"), "fps: Input should be a finite number, not inf"),
        ("fps", 1e-300, "fps: Input should be greater than or equal to 0.001, not 1e-300"),
        ("start", "9999-12-31T23:59:59Z", "start: the year 9999 is not that of a recording"),
        (
            "plate",
            {"columns": 7, "rows": 5, "pitch_mm": 1e300, "origin_mm": [0, 0]},
            "plate.pitch_mm: Input should be less",
        ),
        (
            "plate",
            {"columns": 7, "rows": 5, "pitch_mm": 25, "origin_mm": [0, float("nan")]},
            "plate.origin_mm.1: Input should be a finite number",
        ),
    ],
)
def test_a_bad_header_is_named(recording: Path, key: str, value: object, message: str) -> None:
    (recording / "recording.json").write_text(json.dumps(header("measurement") | {key: value}))
    assert f"recording.json: {message}" in complaint(recording)


def test_torn_json_a_missing_file_and_an_empty_table_are_named(recording: Path, tmp_path: Path) -> None:
    assert "recording.json: No such file" in complaint(tmp_path / "nowhere")
    (tmp_path / "empty").mkdir()
    assert complaint(tmp_path / "empty") == f"{tmp_path}/empty: is not a recording: it has no recording.json"
    table = recording / "frames.csv"
    assert complaint(table) == f"{table}: is not a recording: a recording is a folder"
    (recording / "frames.csv").write_text("sequence,t_s,camera,file,leds,x_mm,y_mm\n")
    assert "frames.csv: has no frames" in complaint(recording)
    (recording / "recording.json").write_text('{"format": "altd-rec')
    assert "recording.json: is not JSON" in complaint(recording)


def test_rows_that_are_not_any_more_what_was_checked_are_refused(recording: Path) -> None:
    """They are well formed, but their frames were not checked."""
    opened = open_recording(recording)
    edit(recording, 5, "rear0001.png", "rear0002.png")
    with pytest.raises(BadInputError, match=r"frames\.csv: was changed after it was checked"):
        list(opened.rows)
    with pytest.raises(BadInputError, match=r"frames\.csv: was changed after it was checked"):
        opened.sha256()


def test_rows_that_are_appended_later_are_not_seen(recording: Path) -> None:
    opened = open_recording(recording)
    with (recording / "frames.csv").open("a") as table:
        table.write("2,0.1,front,gone.png,off,,,\n2,0.1,re")
    assert len([*opened.rows]) == len(opened.rows) == 4
    assert [row.file for row in opened.rows.of("rear")] == ["rear0000.png", "rear0001.png"]


@pytest.mark.parametrize("bits", [8, 12, 16])
def test_what_is_written_is_read_back(tmp_path: Path, bits: int) -> None:
    start = datetime(2026, 11, 20, 8, 15, 30, 125000, UTC)
    size = CameraHeader(width=752, height=480, bits=bits)
    wanted = RecordingHeader(
        format="altd-recording/1",
        kind="measurement",
        fps=20.0,
        cameras={"front": size},
        unit=UnitHeader(serial="A", target_distance_mm=280.0),
        start=start,
    )
    kept = frame(light(Blob(300, 200)) * (1 << bits) / 256, np.random.default_rng(1), bits=bits)
    writer = RecordingWriter(tmp_path / "out", wanted)
    writer.write(kept, 3, 0.15)
    opened = open_recording(tmp_path / "out")  # readable although not closed yet
    writer.close()
    assert opened.header == wanted
    read = opened.frame(opened.rows.first)
    assert np.array_equal(read.pixels, kept.pixels)
    assert (read.sequence, read.t_ns) == (3, 150_000_000)


def test_the_header_states_only_an_exposure_that_all_frames_have(tmp_path: Path) -> None:
    camera = CameraHeader(width=752, height=480, bits=8, exposure_ms=10.0, gain_db=0.0)
    wanted = RecordingHeader(
        format="altd-recording/1",
        kind="measurement",
        fps=20.0,
        cameras={"front": camera},
        unit=UnitHeader(serial="A", target_distance_mm=280.0),
    )
    exposed = replace(frame(light(Blob(300, 200, 40))), camera="front", exposure_ms=10.0, gain_db=0.0)
    writer = RecordingWriter(tmp_path / "out", wanted)
    for number, ms, leds_on, stated in ((0, 10.0, False, 10.0), (1, 4.0, True, 10.0), (2, 12.0, False, None)):
        writer.write(replace(exposed, exposure_ms=ms, leds_on=leds_on), number, number / 20)
        opened = open_recording(tmp_path / "out")
        assert opened.header.cameras["front"].exposure_ms == stated
        assert {opened.frame(row).exposure_ms for row in opened.rows} == {stated}
    writer.close()


def test_a_folder_in_use_is_not_written_into(recording: Path) -> None:
    before = sorted(recording.iterdir())
    with pytest.raises(BadInputError, match="exists and is not an empty folder"):
        RecordingWriter(recording, open_recording(recording).header)
    assert sorted(recording.iterdir()) == before


def test_of_two_that_begin_in_one_folder_at_once_the_first_goes_on(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Both have seen an empty folder."""
    monkeypatch.setattr("altd.recording.writer.refuse_used_folder", lambda _: None)
    opened = open_recording(recording)
    first = RecordingWriter(tmp_path / "out", opened.header)
    first.write(opened.frame(opened.rows.first), 0, 0.0)
    with pytest.raises(BadInputError, match="File exists"):
        RecordingWriter(tmp_path / "out", opened.header)
    first.write(opened.frame([*opened.rows][1]), 0, 0.0)
    first.close()
    assert len(open_recording(tmp_path / "out").rows) == 2


def test_the_hash_changes_with_a_frame(recording: Path) -> None:
    before = open_recording(recording).sha256()
    cv2.imwrite(str(recording / "rear0001.png"), np.zeros((480, 752), np.uint8))
    assert open_recording(recording).sha256() != before


def add_opaque(path: Path, *names: str) -> None:
    """Give frames.csv a column ``opaque`` with these names, row by row."""
    lines = (path / "frames.csv").read_text().splitlines()
    cells = ("opaque", *names)
    table = "".join(f"{line},{cell}\n" for line, cell in zip(lines, cells, strict=True))
    (path / "frames.csv").write_text(table)


def test_a_row_names_the_target_that_is_switched_to_show_the_spot(recording: Path) -> None:
    assert not open_recording(recording).rows.has_opaque
    add_opaque(recording, "front", "front", "", " rear ")
    opened = open_recording(recording)
    assert opened.rows.has_opaque
    assert [row.opaque for row in opened.rows] == ["front", "front", "", "rear"]
    assert [opened.frame(row).opaque for row in opened.rows] == ["front", "front", "", "rear"]


def test_an_unknown_opaque_target_a_torn_row_and_a_repeated_column_are_refused(recording: Path) -> None:
    add_opaque(recording, "front", "front", "raer", "rear")
    table = recording / "frames.csv"
    assert complaint(recording) == (
        f"{table}: row 4: opaque 'raer' is not a target of recording.json; did you mean `rear`?"
    )
    edit(recording, 4, "raer", "rear")
    lines = table.read_text().splitlines()
    table.write_text("\n".join([*lines[:-1], lines[-1].rsplit(",", 1)[0]]) + "\n")
    assert ": row 5: is torn: " in complaint(recording)
    add_opaque(recording, *["front"] * 4)
    assert complaint(recording) == f"{table}: row 1: column 'opaque' is repeated"
