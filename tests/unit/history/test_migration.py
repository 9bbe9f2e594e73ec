"""Histories of older programs are brought to the newest version, whole or not at all.

``history-1.db.gz`` was written by the first program that kept a history (version 1 of the tables): three
seconds of two measurements, the second one's invalid, and two events.
"""

import gzip
import sqlite3
from pathlib import Path

import pytest
from support.history import START_S, US, batch, sample, store

from altd.history import schema
from altd.history.opening import open_to_read
from altd.history.reader import Reader
from altd.history.schema import MINUTES, SECONDS, VERSION, UnusableFileError

OLD = Path(__file__).with_name("history-1.db.gz")


@pytest.fixture
def old(tmp_path: Path) -> Path:
    path = tmp_path / "history.db"
    path.write_bytes(gzip.decompress(OLD.read_bytes()))
    return path


def test_the_old_file_is_old(old: Path) -> None:
    with pytest.raises(UnusableFileError, match=f"is of version 1, this program reads {VERSION}"):
        open_to_read(old)


def test_what_an_old_history_holds_is_kept_and_goes_on(old: Path) -> None:
    writing = store(old.parent)
    written = writing.write(batch(START_S + 10, [sample(START_S + 9, 20.0, 99)]))
    writing.end(None)
    assert written.notices == [], "it is the same unit, and was ended"
    with Reader(old) as reader:
        stored = reader.measurements_after(0, 99)
        assert [one.values.get("x_mm") for one in stored] == [10.0, 10.0, None, None, 11.5, 11.5, 20.0]
        assert [one.id for one in stored] == [1, 2, 3, 4, 5, 6, 7]
        assert [row.n for row in reader.summaries(SECONDS, 0, 2**62)] == [2, 2, 2, 1]
        assert [row.n for row in reader.summaries(MINUTES, 0, 2**62)] == [6, 1]
        day = reader.events(START_S * US, (START_S + 60) * US, ["request", "cause_came"])
        assert [event.text for event in day] == ["a self-check was asked for", "no laser spot"]


def test_it_has_the_tables_that_a_new_one_has(old: Path, tmp_path: Path) -> None:
    (tmp_path / "new").mkdir()
    for folder in (old.parent, tmp_path / "new"):
        store(folder).end(batch(START_S + 10))
    found = []
    for path in (old, tmp_path / "new" / "history.db"):
        with sqlite3.connect(path) as foreign:
            parts = foreign.execute("SELECT type, name, tbl_name, sql FROM sqlite_schema").fetchall()
            found.append(sorted((*of, sorted((sql or "").strip(")").split(", "))) for *of, sql in parts))
            assert foreign.execute("PRAGMA user_version").fetchone() == (VERSION,)
        foreign.close()
    assert found[0] == found[1]


def test_a_migration_that_fails_leaves_the_old_version(old: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    steps = (*schema.MIGRATIONS, ("CREATE TABLE more (a)", "CREATE TABLE facts (a)"))
    monkeypatch.setattr(schema, "MIGRATIONS", steps)
    with pytest.raises(sqlite3.OperationalError, match="table facts already exists"):
        store(old.parent).write(batch(START_S + 10))
    with sqlite3.connect(old) as foreign:
        assert foreign.execute("PRAGMA user_version").fetchone() == (VERSION,)
        names = {name for (name,) in foreign.execute("SELECT name FROM sqlite_schema")}
        assert "more" not in names
        assert foreign.execute("SELECT count(*) FROM measurements").fetchone() == (6,)
    foreign.close()
