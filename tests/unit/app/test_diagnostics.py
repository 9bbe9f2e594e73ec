"""The daemon's part of a unit's diagnostics, and data that must never be in it."""

import hashlib
import io
import json
import os
import platform
import re
import socket
import zipfile
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

import pytest
from support.history import batch, event, store
from support.played_unit import PlayedUnit

from altd import __version__
from altd.app import diagnostics
from altd.app.diagnostics import diagnose, diagnostic_parts
from altd.app.operating_time import file_in, write_seconds
from altd.app.settings import load_settings
from altd.config import Config
from altd.status.unit import DiagnosticPart

SECRET = "correct-horse-battery"
_SOUNDS_SECRET = re.compile(r"password|passphrase|secret|token|private|pin\b|psk|api_?key", re.IGNORECASE)


@pytest.fixture
def config(played_unit: PlayedUnit, tmp_path: Path) -> Config:
    """The settings of a unit with a secret in each place where a person or a command may put one."""
    for name in ("credentials", "unit.pem", "unit.key"):
        (tmp_path / name).write_text(f"-----BEGIN PRIVATE KEY-----\n{SECRET}\n")
    more = f'# the root password: {SECRET}\n[http]\ncredentials = "{tmp_path}/credentials"  # {SECRET}\n'
    more += f'certificate = "{tmp_path}/unit.pem"\nkey = "{tmp_path}/unit.key"\n'
    path = tmp_path / "altd.toml"
    path.write_text(played_unit.config.read_text() + more)
    return load_settings(path)


def test_the_settings_are_those_that_were_read_without_any_secret(config: Config) -> None:
    made = {part.name: part.make() for part in diagnostic_parts(config)}
    settings = json.loads(made["settings.json"])
    assert settings["unit"]["serial"] == "TEST-1"
    assert settings["http"]["credentials"] == str(config.http and config.http.credentials)
    assert settings["http"]["port"] == 8080, "defaults are told, too"
    assert not any(SECRET.encode() in content for content in made.values())


def content_of(archive: bytes) -> dict[str, str]:
    with zipfile.ZipFile(io.BytesIO(archive)) as opened:
        return {name: opened.read(name).decode() for name in opened.namelist()}


def test_a_stopped_unit_has_diagnostics_of_its_files(
    config: Config, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("STATE_DIRECTORY", str(tmp_path))
    kept = store(tmp_path)
    now_s = int(datetime.now(UTC).timestamp())
    kept.write(batch(now_s - 60, (), [event(1, now_s - 60, text="the camera was unplugged")]))
    kept.end(None)
    write_seconds(file_in(tmp_path, "TEST-1"), 7200.0)
    monkeypatch.setenv("STATE_DIRECTORY", str(tmp_path))
    fake_journal(tmp_path, monkeypatch, "echo \"$@\"; sleep 0.1; echo 'frame lost'")
    doctor = DiagnosticPart("doctor.txt", "findings", lambda: b"1 error")
    steps: list[str] = []
    name, archive, why = diagnose(tmp_path / "altd.toml", None, [doctor], steps.append)
    files = content_of(archive)
    assert re.fullmatch(r"altd-TEST-1-\d{8}T\d{6}Z\.zip", name)
    assert "the daemon is not running" in why
    assert why in files["daemon.txt"]
    of_files = {"events.jsonl", "trend.csv"}
    of_files |= {"doctor.txt", "journal.txt", "calibration.txt", "operating-time.json"}
    assert set(files) == {"README.txt", "daemon.txt", "settings.json", "versions.txt"} | of_files
    assert "--unit=altd" in files["journal.txt"]
    assert '"seconds": 7200.0' in files["operating-time.json"]
    assert "frame lost" in files["journal.txt"]
    assert "no log" not in files["README.txt"]
    digest = hashlib.sha256(config.unit.calibration.read_bytes()).hexdigest()
    assert f"SHA-256: {digest}\nmade: 20" in files["calibration.txt"]
    assert steps[0].startswith(why)
    assert "--no-journal" in steps[1]
    assert {step.partition(":")[0] for step in steps[2:]} == set(files) - {
        "README.txt",
        "daemon.txt",
        "events.jsonl",
        "trend.csv",
    }
    assert "the camera was unplugged" in files["events.jsonl"]
    assert not any(SECRET in content for content in files.values())


def fake_journal(folder: Path, monkeypatch: pytest.MonkeyPatch, script: str) -> None:
    (folder / "bin").mkdir()
    (folder / "bin" / "journalctl").write_text(f"#!/bin/sh\n{script}\n")
    (folder / "bin" / "journalctl").chmod(0o755)
    monkeypatch.setenv("PATH", f"{folder}/bin", prepend=":")


def test_a_daemon_and_a_journal_that_hang_delay_the_archive_by_their_limits_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fake_journal(tmp_path, monkeypatch, "exec sleep 20")
    monkeypatch.setattr(diagnostics, "_FIRST_TIMEOUT_S", 0.1)
    monkeypatch.setattr(diagnostics, "_JOURNAL_TIMEOUT_S", 0.5)
    hanging = tmp_path / "altd.sock"
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(str(hanging))
        listening.listen()
        _, archive, why = diagnose(None, hanging)
    assert why == f"the daemon at {hanging} does not answer within 0.1 s"
    files = content_of(archive)
    assert "versions.txt" in files
    assert "Diagnostics of the unit of unknown serial number, made at" in files["README.txt"]
    assert "and no log: on the unit itself `journalctl -u altd` shows that" in files["README.txt"]
    assert "journal.txt: " in files["README.txt"].partition("Not in it:")[2]


def test_without_the_journal_on_request(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fake_journal(tmp_path, monkeypatch, "echo never")
    steps: list[str] = []
    _, archive, _ = diagnose(None, tmp_path / "none.sock", (), steps.append, with_journal=False)
    assert "journal.txt" not in content_of(archive)
    assert not any("--no-journal" in step for step in steps)


def test_settings_that_cannot_be_used_are_told_in_the_diagnostics(config: Config, tmp_path: Path) -> None:
    (tmp_path / "altd.toml").write_text("[no_such_table]\n")
    _, archive, why = diagnose(tmp_path / "altd.toml")
    files = content_of(archive)
    assert "no_such_table" in why
    assert "no_such_table" in files["daemon.txt"]
    assert "events.jsonl: " in files["README.txt"].partition("Not in it:")[2]


def test_no_key_of_the_settings_holds_a_secret() -> None:
    """A new secret has to be left out of the diagnostics and of the history first."""
    keys = set(re.findall(r'"([a-z0-9_]+)": \{', json.dumps(Config.model_json_schema()["$defs"])))
    assert {"serial", "credentials", "certificate", "key"} <= keys, "the schema is read as it is written"
    assert {key for key in keys if _SOUNDS_SECRET.search(key)} == set()


def test_the_versions_are_those_of_this_process(config: Config) -> None:
    (made,) = (part.make() for part in diagnostic_parts(config) if part.name == "versions.txt")
    lines = made.decode().splitlines()
    assert lines[0] == f"altd {__version__}"
    assert lines[1].endswith(platform.python_version())
    assert os.uname().release in lines[2]
    assert f"numpy {version('numpy')}" in lines
    assert f"uvicorn {version('uvicorn')}" in lines
    assert os.uname().nodename not in lines
