"""Commands that did their work end with status 0."""

import zipfile
from pathlib import Path

from support.cli import altd_here
from support.history import START_S, batch, event, store


def test_events_end_with_0(tmp_path: Path) -> None:
    kept = store(tmp_path)
    kept.write(batch(START_S + 1, (), [event(1, START_S, text="the camera was unplugged")]))
    kept.end(None)
    done = altd_here("events", "--history", tmp_path / "history.db")
    assert (done.status, done.err) == (0, "")
    assert "the camera was unplugged" in done.out


def test_diagnostics_of_a_unit_that_does_not_run_end_with_0_and_a_remark(tmp_path: Path) -> None:
    (tmp_path / "altd.toml").write_text("[no_such_table]\n")
    archive = tmp_path / "unit.zip"
    done = altd_here("diagnose", "--config", tmp_path / "altd.toml", "-o", archive)
    assert (done.status, done.out) == (0, f"{archive}\n")
    assert "only its files are in the archive" in done.err
    assert zipfile.is_zipfile(archive)
