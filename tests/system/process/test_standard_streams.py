"""Commands whose standard streams are closed, full or gone: a line or none, and the right status.

``test_endings.py`` has each command whose standard output is full or whose reader goes away.
"""

import os
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from support.played_unit import PlayedUnit

READ_AND_SAID = {
    "replay": "replay {beams} --calibration {cal} --window 4 --every 4",
    "calibrate": "calibrate {scan} -o {new}/cal.json",
    "check-config": "check-config {config}",
    "devices": "devices",
    "--help": "--help",
    "--version": "--version",
}


def run(
    unit: PlayedUnit, new: Path, command: str, redirected: str = "", folder: str = "."
) -> subprocess.CompletedProcess[str]:
    """A command in a shell that redirects its streams, in a folder."""
    filled = command.format(
        beams=unit.beams, cal=unit.calibration, scan=unit.folder / "scan", config=unit.config, new=new
    )
    line = f"{shlex.quote(sys.executable)} -m altd.cli {filled} {redirected}"
    return subprocess.run(
        ["/bin/bash", "-c", f"cd {folder} && {line}"],
        input="" if "<" not in redirected else None,
        capture_output=True,
        text=True,
        timeout=200,
        check=False,
        env={**os.environ, "PYTHONWARNINGS": "error"},
    )


@pytest.mark.parametrize(
    ("command", "redirected", "why"),
    [
        *((command, ">/dev/full", "No space left on device") for command in ("--help", "--version")),
        *((command, ">&-", "Bad file descriptor") for command in ("replay", "--help")),
    ],
)
def test_an_answer_that_cannot_be_printed_is_a_line_and_status_1(
    played_unit: PlayedUnit, tmp_path: Path, command: str, redirected: str, why: str
) -> None:
    done = run(played_unit, tmp_path, READ_AND_SAID[command], redirected)
    name = "altd" if command.startswith("--") else f"altd {command}"
    assert (done.stderr, done.returncode) == (f"{name}: standard output: {why}\n", 1)


def test_a_reader_that_goes_away_is_no_word(played_unit: PlayedUnit, tmp_path: Path) -> None:
    done = run(played_unit, tmp_path, "--help", "| true; exit ${PIPESTATUS[0]}")
    assert (done.stderr, done.returncode) in (("", 1), ("", 0))  # 0: it was done before the reader was gone


@pytest.mark.parametrize("command", ["replay", "check-config", "devices"])
def test_what_needs_no_input_and_says_nothing_on_standard_error_runs_without_them(
    played_unit: PlayedUnit, tmp_path: Path, command: str
) -> None:
    whole = run(played_unit, tmp_path, READ_AND_SAID[command])
    without = run(played_unit, tmp_path, READ_AND_SAID[command], "<&- 2>&-")
    assert without.returncode == 0
    if command == "devices":  # other tests may have connected some in between
        assert _headings(without.stdout) == _headings(whole.stdout)
    else:
        assert without.stdout == whole.stdout


def _headings(devices: str) -> list[str]:
    return [line for line in devices.splitlines() if not line.startswith(" ")]


@pytest.mark.parametrize("redirected", ["2>&-", "2>/dev/full", "<&- >&- 2>&-"])
def test_a_bad_file_is_status_2_though_nobody_can_be_told(
    played_unit: PlayedUnit, tmp_path: Path, redirected: str
) -> None:
    done = run(played_unit, tmp_path, "check-config {new}/none.toml", redirected)
    assert (done.returncode, done.stdout, done.stderr) == (2, "", "")


def test_a_file_that_is_written_gets_nothing_of_what_is_printed(
    played_unit: PlayedUnit, tmp_path: Path
) -> None:
    """With descriptors 1 and 2 closed the next files to be opened would get their numbers."""
    done = run(played_unit, tmp_path, READ_AND_SAID["calibrate"], "<&- >&- 2>&-")
    assert done.returncode == 1
    again = run(played_unit, tmp_path, f"replay {{beams}} --calibration {tmp_path}/cal.json")
    assert again.returncode == 0, again.stderr


def test_map_without_an_input_is_refused(played_unit: PlayedUnit, tmp_path: Path) -> None:
    done = run(played_unit, tmp_path, "map --calibration {cal} --target rear", "<&-")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == "altd map: stdin: Bad file descriptor\n"


def test_recording_needs_no_standard_stream(played_unit: PlayedUnit, tmp_path: Path) -> None:
    done = run(
        played_unit, tmp_path, "record --config {config} -o {new}/kept --seconds 0.2", "<&- >&- 2>/dev/full"
    )
    assert done.returncode == 0
    assert (tmp_path / "kept" / "frames.csv").stat().st_size > 100


@pytest.mark.parametrize(
    ("command", "status", "said"),
    [
        ("replay {beams} --calibration {cal}", 0, ""),
        ("calibrate {scan} -o cal.json", 2, "altd calibrate: cal.json: No such file or directory"),
        ("record --config {config} -o kept --seconds 0.2", 2, "altd record: kept: No such file"),
        ("run --config altd.toml", 2, "altd run: altd.toml: No such file"),
    ],
)
def test_in_a_working_directory_that_was_deleted(
    played_unit: PlayedUnit, tmp_path: Path, command: str, status: int, said: str
) -> None:
    gone = tmp_path / "gone"
    gone.mkdir()
    done = run(played_unit, tmp_path, command, folder=f"{gone} && rmdir {gone}")
    lines = [line for line in done.stderr.splitlines() if "getcwd" not in line]  # bash's own
    assert done.returncode == status, done.stderr
    assert len(lines) == bool(said)
    assert "".join(lines).startswith(said)


def test_a_name_that_is_no_text_is_printed_all_the_same(played_unit: PlayedUnit, tmp_path: Path) -> None:
    config = os.fsencode(tmp_path) + b"/\xff.toml"
    Path(os.fsdecode(config)).write_bytes(played_unit.config.read_bytes())
    done = subprocess.run(
        [sys.executable, "-m", "altd.cli", "check-config", config],
        capture_output=True,
        env={**os.environ, "PYTHONIOENCODING": "utf-8:strict"},
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert b"good: unit TEST-1" in done.stdout
