"""The archive for a public issue: its content, what is never in it, and that it needs consent."""

import getpass
import io
import json
import socket
import zipfile
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.cli import altd_here, refusal
from support.played_unit import PlayedUnit

from altd.app.public_archive import PICTURES, public_archive
from altd.app.settings import load_settings
from altd.recording.reader import open_recording

SECRET = "correct-horse-battery"
HOST = "my-own-laptop"
ADDRESS = "192.0.2.77"
VERIFICATION = {
    "format": "altd-verification/1",
    "unit": "TEST-1",
    "created": "2026-11-30T12:00:00.000Z",
    "origin": "camera",
    "verdict": "passed",
    "reasons": [f"/home/jane/{SECRET}: too few"],
    "calibration": {"path": f"/home/jane/{SECRET}.json"},
    "reference": {"laboratory": SECRET},
    "tests": [{"name": "zero of yaw", "unit": "mm/m", "value": 0.1, "result": "passed"}],
    "sets": [{"recording": f"/home/jane/{SECRET}", "note": SECRET, "positions": 20}],
    "residuals": [{"set": 1, "x_mm": 0.01}],
}


@pytest.fixture
def place(played_unit: PlayedUnit, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Settings with a secret or a name in each table that may hold one."""
    (tmp_path / "login").write_text(f"jane\n{SECRET}\n")
    (tmp_path / "login").chmod(0o600)
    more = f'# {SECRET}\n[mqtt]\nhost = "{ADDRESS}"\ntopic = "{HOST}"\ncredentials = "{tmp_path}/login"\n'
    path = tmp_path / "altd.toml"
    path.write_text(played_unit.config.read_text() + more)
    (tmp_path / "verification.json").write_text(json.dumps(VERIFICATION))
    monkeypatch.setattr(socket, "gethostname", lambda: HOST)
    monkeypatch.setenv("HOME", f"/home/{HOST}")
    return path


def files_of(archive: bytes) -> dict[str, bytes]:
    with zipfile.ZipFile(io.BytesIO(archive)) as opened:
        return {name: opened.read(name) for name in opened.namelist()}


def test_it_has_all_that_an_issue_needs_and_nothing_personal(place: Path, played_unit: PlayedUnit) -> None:
    name, archive = public_archive(
        load_settings(place), played_unit.beams, place.parent / "verification.json"
    )
    files = files_of(archive)
    texts = {name: content.decode() for name, content in files.items() if not name.startswith("pictures/")}
    documents = {"settings.json", "calibration.json", "verification.json"}
    assert set(texts) == {"README.txt", "versions.txt"} | documents
    assert json.loads(texts["settings.json"])["targets"][1]["z_mm"] == 280.0
    assert json.loads(texts["settings.json"])["cameras"]["front"]["driver"] == "recording"
    assert json.loads(texts["calibration.json"])["targets"][0]["residuals"]["mean_mm"] > 0
    verified = json.loads(texts["verification.json"])
    assert (verified["verdict"], verified["sets"]) == ("passed", [{"positions": 20}])
    assert verified["tests"] == VERIFICATION["tests"], "names and units of the tests stay"
    whole = name + "".join(files) + "".join(texts.values())
    for personal in ("TEST-1", SECRET, "jane", HOST, ADDRESS, str(place.parent), str(played_unit.folder)):
        assert personal not in whole
    assert "They hold no password, token or key, and no log." in texts["README.txt"]


def test_its_pictures_are_those_of_the_recording(place: Path, played_unit: PlayedUnit) -> None:
    recording = open_recording(played_unit.beams)
    _, archive = public_archive(load_settings(place), played_unit.beams, None)
    pictures = {name: data for name, data in files_of(archive).items() if name.startswith("pictures/")}
    assert len(pictures) == min(PICTURES, len(recording.rows))
    first = recording.rows.first
    data = np.frombuffer(pictures[f"pictures/{first.camera}-{first.sequence}.png"], np.uint8)
    shown = cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
    assert shown is not None
    assert np.array_equal(shown, recording.frame(first).pixels)


def test_a_calibration_that_is_not_there_is_named_without_its_path(place: Path) -> None:
    place.write_text(place.read_text().replace("cal.json", "none.json"))
    files = files_of(public_archive(load_settings(place), None, None)[1])
    assert set(files) == {"README.txt", "settings.json", "versions.txt"}
    readme = files["README.txt"].decode()
    assert "calibration.json: it cannot be read" in readme.partition("Not in it:")[2]
    assert str(place.parent) not in readme


def test_nothing_is_written_without_consent(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(place.parent)
    before = set(place.parent.iterdir())
    command = ["diagnose", "--public", "--config", str(place)]
    asked = altd_here(*command)
    assert (asked.status, asked.out) == (1, "Write it? (y: yes) ")
    assert "anybody may read and keep it" in asked.err
    assert asked.err.endswith("altd diagnose: nothing is written\n")
    assert set(place.parent.iterdir()) == before
    written = altd_here(*command, "--yes")
    assert written.status == 0
    assert (place.parent / written.out.strip()).is_file()
    assert getpass.getuser() not in written.out


def test_a_verification_of_another_unit_is_refused(place: Path) -> None:
    (place.parent / "verification.json").write_text(json.dumps(VERIFICATION | {"unit": "OTHER"}))
    options = ["--public", "--yes", "--config", place, "--verification", place.parent / "verification.json"]
    assert refusal(altd_here("diagnose", *options)).endswith("is of unit 'OTHER', not 'TEST-1'")


@pytest.mark.parametrize(
    "content", ["{}", "[]", "no JSON", json.dumps(VERIFICATION | {"format": "altd-verification/2"})]
)
def test_a_file_that_is_no_verification_is_refused(place: Path, content: str) -> None:
    (place.parent / "verification.json").write_text(content)
    options = ["--public", "--yes", "--config", place, "--verification", place.parent / "verification.json"]
    assert refusal(altd_here("diagnose", *options)).endswith("is not a verification.json of `altd verify -o`")
    assert "requires --public" in refusal(altd_here("diagnose", *options[2:]))
