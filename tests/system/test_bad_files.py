"""In place of every file that a command reads or writes: what is none, or no good one. One line, status 2."""

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from support import evidence
from support.cli import altd_here, refusal, unreadable
from support.foreign import on_small_disk
from support.pngs import png
from support.recordings import write_beams, write_scan
from support.unit_toml import write_config

from altd.calibration.file import save_calibration
from altd.recording.reader import open_recording

HUGE = png(40_000, 40_000)
BEAM = (10.0, 5.0, 0.02, -0.03)


@pytest.fixture(scope="module")
def unit(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A config, what it plays and its calibration."""
    path = tmp_path_factory.mktemp("unit")
    save_calibration(evidence.calibration(), path / "cal.json")
    write_beams(path / "beams", [BEAM], exposures=2)
    write_config(path / "altd.toml", path / "cal.json", path / "beams")
    assert altd_here("check-config", path / "altd.toml").status == 0
    assert altd_here("replay", path / "beams", "--calibration", path / "cal.json").status == 0
    return path


@pytest.fixture
def copy(unit: Path, tmp_path: Path) -> Path:
    """The same, to be corrupted."""
    shutil.copytree(unit, tmp_path / "unit")
    write_config(tmp_path / "unit" / "altd.toml", tmp_path / "unit" / "cal.json", tmp_path / "unit" / "beams")
    return tmp_path / "unit"


def a_pipe(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


def a_device(path: Path) -> None:
    path.unlink()
    path.symlink_to("/dev/zero")


def a_folder(path: Path) -> None:
    path.unlink()
    path.mkdir()


def a_loop(path: Path) -> None:
    path.unlink()
    path.symlink_to(path.name)


def a_terabyte(path: Path) -> None:
    os.truncate(path, 1 << 40)


NO_FILES = {
    a_pipe: "is a pipe, not a file",
    a_device: "is a device, not a file",
    a_folder: "is a folder, not a file",
    a_loop: "Too many levels of symbolic links",
    a_terabyte: "bytes long, more than",
}


@pytest.mark.parametrize("spoil", NO_FILES)
@pytest.mark.parametrize("name", ["altd.toml", "cal.json", "beams/recording.json", "beams/frames.csv"])
def test_what_is_no_file_in_place_of_one(name: str, spoil: Callable[[Path], None], copy: Path) -> None:
    spoil(copy / name)
    line = refusal(altd_here("check-config", copy / "altd.toml"))
    assert f"{copy / name}: " in line
    assert NO_FILES[spoil] in line


@pytest.mark.parametrize("spoil", NO_FILES)
def test_what_is_no_file_in_place_of_a_frame(spoil: Callable[[Path], None], copy: Path) -> None:
    frame = copy / "beams" / "rear0001.png"
    why = NO_FILES[spoil]
    spoil(frame)
    assert why in unreadable(altd_here("locate", frame))
    outcome = altd_here("replay", copy / "beams", "--calibration", copy / "cal.json")
    assert outcome.status == 2
    assert "frames.csv: row 5: rear0001.png: " in outcome.err
    assert why in outcome.err
    assert len(outcome.err.splitlines()) == 1


@pytest.mark.parametrize("picture", [HUGE, png(65_536, 32_768)], ids=["40000 × 40000", "above 2³⁰"])
def test_a_picture_that_claims_to_be_huge(picture: bytes, copy: Path) -> None:
    frame = copy / "beams" / "rear0001.png"
    frame.write_bytes(picture)
    assert "more than 268435456 pixels" in unreadable(altd_here("locate", frame))
    assert "frames.csv: row 5: rear0001.png is" in refusal(
        altd_here("replay", copy / "beams", "--calibration", copy / "cal.json")
    )
    assert "frames.csv: row 5: rear0001.png is" in refusal(
        altd_here("calibrate", copy / "beams", "-o", copy / "new.json")
    )


@pytest.mark.parametrize(
    ("old", "new", "why"),
    [
        ("window = 4", "window = " + "9" * 5000, "not TOML: a number with too many digits"),
        (
            "window = 4",
            "window = 0x" + "f" * 5000,
            "line 26, column 10: measuring.window: has more than 64 bits",
        ),
        ("window = 4", "window = " + "[" * 5000, "is nested too deeply"),
        ("window = 4", "x" + ".a" * 20_000 + " = 4", "more than 64 dots"),
        ("beams", "be\\u0000ams", "cameras.rear.path: has a NUL"),
        ('name = "front"', 'name = "front\\n\\u001b[2J"', "targets.0.name: "),
    ],
)
def test_a_config_that_no_parser_expects(old: str, new: str, why: str, copy: Path) -> None:
    path = copy / "altd.toml"
    path.write_text(path.read_text().replace(old, new))
    assert why in refusal(altd_here("check-config", path))


@pytest.mark.parametrize(
    ("content", "why"),
    [
        (b"[" * 100_000, "is nested too deeply"),
        (b'{"format": "altd-calibration/1", "x": ' + b"[" * 900 + b"]" * 900 + b"}", "cal.json: "),
        (b'{"format": "altd-calibration/1", "format": "altd-calibration/1"}', "'format' occurs twice"),
        (b'{"format": ' + b"9" * 5000 + b"}", "has 5000 digits"),
        (b'{"format": "\\ud800\\n"}', "format is '\\ud800\\n'"),
        (b"\0" * 1000, "is not JSON"),
    ],
)
def test_json_that_no_parser_expects(content: bytes, why: str, copy: Path) -> None:
    (copy / "cal.json").write_bytes(content)
    assert why in refusal(altd_here("check-config", copy / "altd.toml"))


TABLE_HEAD = b"sequence,t_s,camera,file,leds,x_mm,y_mm"


@pytest.mark.parametrize(
    ("old", "new", "why"),
    [
        (b"front0000.png", b"front0000\0.png", "row 2: front0000\\x00.png: is not a path"),
        (b"front0000.png", b'"front0000.png', "is not CSV"),
        (b"front0000.png", b'"' + b"x" * 200_000, "is not CSV: field larger than field limit"),
        (TABLE_HEAD, TABLE_HEAD + b",a" * 1_000_000, "row 2: "),
        (TABLE_HEAD, TABLE_HEAD + b",t_s", "row 1: column 't_s' is repeated"),
        (b"front0000.png", b"\xff.png", "is not CSV: 'utf-8' codec"),
    ],
)
def test_a_table_that_no_parser_expects(old: bytes, new: bytes, why: str, copy: Path) -> None:
    table = copy / "beams" / "frames.csv"
    content = table.read_bytes()
    assert old in content
    table.write_bytes(content.replace(old, new, 1))
    outcome = altd_here("check-config", copy / "altd.toml")
    if outcome.status == 0 and b",a" in new:
        return  # a million unknown columns are ignored
    assert why in refusal(outcome)


def test_a_table_may_have_a_byte_order_mark_and_any_line_ends(copy: Path) -> None:
    table = copy / "beams" / "frames.csv"
    lines = table.read_bytes().splitlines()
    table.write_bytes(b"\xef\xbb\xbf" + b"\r\n".join(lines[:2]) + b"\n" + b"\r\n".join(lines[2:]))
    assert altd_here("check-config", copy / "altd.toml").status == 0


def test_lines_of_altd_map_that_are_no_text(unit: Path) -> None:
    arguments = [
        sys.executable,
        "-m",
        "altd.cli",
        "map",
        "--calibration",
        unit / "cal.json",
        "--target",
        "rear",
    ]
    for content, why in ((b"\xff\xfe 1\n", "got '\\xff\\xfe 1'"), (b"x" * 10**6, "expected 'u v', got 'xxx")):
        done = subprocess.run(arguments, input=content, capture_output=True, timeout=200, check=False)
        assert done.returncode == 2
        assert why in done.stderr.decode().replace("\\\\", "\\")
        assert len(done.stderr.splitlines()) == 1


@pytest.fixture(scope="module")
def scan(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_scan(tmp_path_factory.mktemp("scanned") / "scan", columns=5, rows=4)


class TestWriting:
    """``altd calibrate -o`` makes new files and replaces regular ones, nothing else."""

    def test_on_a_full_disk_a_recording_ends_with_one_line_and_what_is_there_is_whole(
        self, unit: Path, tmp_path: Path
    ) -> None:
        """A real disk with room for a few frames, in a mount namespace of its own; it is read there too."""
        disk = tmp_path / "disk"
        disk.mkdir()
        code = (
            f"{sys.executable} -m altd.cli record --config {unit / 'altd.toml'} -o {disk / 'rec'} "
            f"--seconds 60; echo status $?; cp -r {disk / 'rec'} {tmp_path / 'rec'}"
        )
        command = on_small_disk(disk, "2m", code)
        done = subprocess.run(command, capture_output=True, text=True, timeout=200, check=False)
        assert done.stdout == "status 2\n", done
        assert done.stderr == f"altd record: {disk / 'rec'}: No space left on device\n"
        recording = open_recording(tmp_path / "rec")
        assert len(recording.rows) >= 4
        assert len(list((tmp_path / "rec").rglob("*.png"))) == len(recording.rows)
        for row in recording.rows:
            recording.frame(row)
