"""Disks that are full, gone or read-only and files that are damaged, foreign or newer; on real files."""

import os
import shutil
import sqlite3
import subprocess
import sys
from pathlib import Path

import pytest
from support.history import (
    ABOUT,
    START_S,
    batch,
    event,
    forge,
    record_seconds,
    renamed,
    sample,
    store,
    write_seconds,
)

from altd.history import open_store, opening
from altd.history.opening import MAX_FILES_ASIDE, open_to_read
from altd.history.reader import Reader
from altd.history.schema import SECONDS, VERSION, MovedFileError, NewerFileError, UnusableFileError
from altd.status.event_log import EventKind


def sequences(path: Path) -> list[int]:
    with Reader(path) as reader:
        return [one.sequence for one in reader.measurements_after(0, 1000)]


def test_a_damaged_file_is_moved_aside_and_a_new_one_begun(tmp_path: Path) -> None:
    path = tmp_path / "history.db"
    path.write_bytes(b"no database at all" * 100)
    writing = store(tmp_path)
    with pytest.raises(MovedFileError) as moved:
        writing.write(batch(START_S))
    (aside,) = tmp_path.glob("history.db.damaged-*")
    assert str(moved.value) == f"file is not a database: moved to {aside}, new history file created"
    assert aside.read_bytes() == b"no database at all" * 100
    written = writing.write(batch(START_S + 1, [sample(START_S, sequence=5)]))
    writing.end(None)
    assert sequences(path) == [5]
    kinds = [(notice.kind, aside.name in notice.text) for notice in written.notices]
    assert kinds == [(EventKind.HISTORY, True), (EventKind.HISTORY, False)]


def test_pages_that_are_damaged_are_found_after_a_crash(tmp_path: Path) -> None:
    path = tmp_path / "history.db"
    record_seconds(
        tmp_path, START_S, [10.0] * 30
    )  # the pages are in the file, and it does not say that it was ended
    content = bytearray(path.read_bytes())
    for page in range(8, len(content) // 4096, 3):
        content[page * 4096 : page * 4096 + 64] = os.urandom(64)
    path.write_bytes(content)
    with pytest.raises((UnusableFileError, sqlite3.DatabaseError), match=r"damaged|malformed"):
        store(tmp_path).write(batch(START_S + 60))
    assert len(list(tmp_path.glob("history.db.damaged-*"))) == 1
    assert not path.exists()


def test_a_disk_that_damages_every_file_is_not_filled(tmp_path: Path) -> None:
    path = tmp_path / "history.db"
    for _ in range(MAX_FILES_ASIDE):
        path.write_bytes(b"x" * 5000)
        with pytest.raises(MovedFileError):
            store(tmp_path).write(batch(START_S))
    path.write_bytes(b"y" * 5000)
    with pytest.raises(UnusableFileError, match=r"as 3 before it: move .*history\.db\.damaged-\* away"):
        store(tmp_path).write(batch(START_S))
    assert path.read_bytes() == b"y" * 5000


def test_a_history_of_another_unit_is_kept_and_none_of_this_ones(tmp_path: Path) -> None:
    """A memory card that was moved from unit to unit."""
    writing = store(tmp_path)
    write_seconds(writing, START_S, [10.0])
    writing.end(batch(START_S + 2))
    writing = store(tmp_path, renamed(ABOUT, serial="TEST-2"))
    with pytest.raises(MovedFileError, match="is of unit 'TEST-1', and this one is 'TEST-2'"):
        writing.write(batch(START_S + 8))
    (aside,) = tmp_path.glob("history.db.of-another-unit-*")
    assert len(sequences(aside)) == 20
    written = writing.write(batch(START_S + 9, [sample(START_S + 8, sequence=5)]))
    writing.end(None)
    assert sequences(tmp_path / "history.db") == [5]
    assert [aside.name in notice.text for notice in written.notices] == [True, False]


def test_of_two_daemons_on_one_history_the_second_writes_once_the_first_has_ended(tmp_path: Path) -> None:
    first, second = store(tmp_path), store(tmp_path)
    first.write(batch(START_S + 1, [sample(START_S, sequence=1)]))
    with pytest.raises(UnusableFileError, match="another daemon writes it"):
        second.write(batch(START_S + 1, [sample(START_S, sequence=100)]))
    first.write(batch(START_S + 2, [sample(START_S + 1, sequence=2)]))
    assert sequences(tmp_path / "history.db") == [1, 2]
    first.end(batch(START_S + 3))
    notices = second.write(batch(START_S + 4, [sample(START_S + 3, sequence=101)])).notices
    second.end(None)
    assert sequences(tmp_path / "history.db") == [1, 2, 101]
    assert notices == []  # no daemon crashed


def test_a_daemon_that_was_killed_holds_the_history_no_more(tmp_path: Path) -> None:
    code = (
        "import os, sys; from pathlib import Path; from altd.history.opening import WriteLock;"
        "WriteLock(Path(sys.argv[1])); print('held', flush=True); os.kill(os.getpid(), 9)"
    )
    command = [sys.executable, "-c", code, str(tmp_path / "history.db")]
    killed = subprocess.run(command, capture_output=True, check=False)
    assert (killed.stdout, killed.returncode) == (b"held\n", -9)
    writing = store(tmp_path)
    writing.write(batch(START_S + 1, [sample(START_S)]))
    writing.end(None)


def test_a_newer_history_is_left_as_it_is(tmp_path: Path) -> None:
    path = tmp_path / "history.db"
    record_seconds(tmp_path, START_S, [10.0])
    forge(path, f"PRAGMA user_version = {VERSION + 1}")
    before = path.read_bytes()
    said = f"is of version {VERSION + 1}, and this program knows {VERSION}"
    with pytest.raises(NewerFileError, match=said):
        store(tmp_path).write(batch(START_S + 9))
    assert path.read_bytes() == before
    with pytest.raises(NewerFileError):
        open_to_read(path)


def test_a_database_of_something_else_is_left_as_it_is(tmp_path: Path) -> None:
    path = tmp_path / "history.db"
    forge(path, "CREATE TABLE recipes (name TEXT)")
    before = path.read_bytes()
    with pytest.raises(UnusableFileError, match="is a database, but no history"):
        store(tmp_path).write(batch(START_S))
    assert path.read_bytes() == before


@pytest.mark.parametrize(
    "statement",
    [
        "CREATE VIEW spy AS SELECT * FROM events",
        "CREATE TRIGGER t AFTER INSERT ON events BEGIN DELETE FROM events; END",
        "CREATE TABLE more (a)",
        "ALTER TABLE seconds ADD COLUMN forged AS (n * 2)",
        "DROP TABLE hours",
        "DROP TABLE hours; CREATE VIEW hours AS WITH RECURSIVE r(i) AS "
        "(SELECT 1 UNION ALL SELECT i + 1 FROM r) SELECT i AS key FROM r",
    ],
)
def test_a_file_with_other_tables_is_not_believed(tmp_path: Path, statement: str) -> None:
    record_seconds(tmp_path, START_S, [10.0])
    with sqlite3.connect(tmp_path / "history.db") as foreign:
        foreign.executescript(statement)
    foreign.close()
    with pytest.raises(UnusableFileError, match=r"has (other tables|a hidden column|view|trigger|table)"):
        open_to_read(tmp_path / "history.db")


@pytest.mark.parametrize("value", ["'text'", "x'00ff'", "1e308"])
def test_a_forged_number_is_an_error_and_no_number(tmp_path: Path, value: str) -> None:
    record_seconds(tmp_path, START_S, [10.0])
    with sqlite3.connect(tmp_path / "history.db") as foreign:
        foreign.execute(f"UPDATE measurements SET value_0 = {value}")
        foreign.execute(f"UPDATE seconds SET n = {value}")
    foreign.close()
    with Reader(tmp_path / "history.db") as reader:
        if value != "1e308":
            with pytest.raises(UnusableFileError, match="x_mm is not a number"):
                reader.measurements_after(0, 10)
        with pytest.raises(UnusableFileError, match="is damaged: a row of seconds"):
            list(reader.summaries(SECONDS, 0, 2**62))


def test_a_folder_that_is_deleted_is_told_and_one_that_comes_back_is_used(tmp_path: Path) -> None:
    folder = tmp_path / "disk"
    folder.mkdir()
    writing = store(folder)
    writing.write(batch(START_S + 1, [sample(START_S, sequence=1)]))
    shutil.rmtree(folder)
    with pytest.raises(UnusableFileError, match="was replaced, deleted or written"):
        writing.write(batch(START_S + 2, [sample(START_S + 1, sequence=2)]))
    with pytest.raises(UnusableFileError, match=r"the folder .* does not exist"):
        writing.write(batch(START_S + 2, [sample(START_S + 1, sequence=2)]))
    folder.mkdir()
    writing.write(batch(START_S + 3, [sample(START_S + 2, sequence=3)]))
    writing.end(None)
    assert sequences(folder / "history.db") == [3]


def files_of(path: Path) -> list[Path]:
    return sorted(path.parent.glob(f"{path.name}*"))


def overwrite(path: Path) -> None:
    with path.open("r+b") as file:
        file.write(b"garbage!" * 200)


DAMAGE = {
    "it is moved": lambda path: path.rename(path.with_name("moved.db")),
    "it is moved, and an empty one put there": lambda path: (
        path.rename(path.with_name("moved.db")),
        path.touch(),
    ),
    "it is deleted": Path.unlink,
    "all of it is deleted": lambda path: [each.unlink() for each in files_of(path)],
    "it is truncated": lambda path: os.truncate(path, 0),
    "it is cut in two": lambda path: os.truncate(path, path.stat().st_size // 2),
    "it is overwritten": lambda path: path.write_bytes(b"x" * path.stat().st_size),
    "its head is overwritten": overwrite,
    "its log is deleted": lambda path: path.with_name("history.db-wal").unlink(),
    "its log is truncated": lambda path: os.truncate(path.with_name("history.db-wal"), 0),
    "its index is deleted": lambda path: path.with_name("history.db-shm").unlink(),
}
DAMAGES = "it is cut in two", "it is overwritten", "its head is overwritten"


@pytest.mark.parametrize("how", DAMAGE)
def test_what_is_done_to_a_file_while_it_is_open_is_said_and_the_history_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, how: str
) -> None:
    monkeypatch.setattr(opening, "WAL_PAGES", 12)  # most pages are in the file, as those of a long history
    path, writing = tmp_path / "history.db", store(tmp_path)
    write_seconds(writing, START_S, [10.0] * 10)
    DAMAGE[how](path)
    next_one = batch(START_S + 12, [sample(START_S + 11, sequence=999)])
    with pytest.raises(UnusableFileError, match="was replaced, deleted or written by another program while"):
        writing.write(next_one)
    if how in DAMAGES:
        with pytest.raises((UnusableFileError, sqlite3.DatabaseError), match=r"malformed|not a database"):
            writing.write(next_one)
        assert len(list(tmp_path.glob("history.db.damaged-*"))) >= 1
    told = writing.write(next_one).notices
    writing.write(batch(START_S + 13, [sample(START_S + 12, sequence=1000)]))
    assert sequences(path)[-2:] == [999, 1000]
    assert any("by another program while it was open" in notice.text for notice in told)
    writing.end(None)
    with sqlite3.connect(path) as whole:
        assert whole.execute("PRAGMA integrity_check").fetchone() == ("ok",)
    whole.close()
    if "moved" in how:
        assert len(sequences(tmp_path / "moved.db")) == 200
    if how in ("its log is deleted", "its index is deleted"):
        assert len(sequences(path)) == 202


def test_an_older_copy_that_is_put_back_gets_nothing_of_the_log_of_the_newer_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, older = tmp_path / "history.db", store(tmp_path)
    write_seconds(older, START_S, [10.0] * 10)
    older.end(None)
    shutil.copy(path, tmp_path / "copy.db")
    monkeypatch.setattr(opening, "WAL_PAGES", 50)
    newer = store(tmp_path)
    write_seconds(newer, START_S + 20, [10.0] * 10)
    (tmp_path / "copy.db").rename(path)
    with pytest.raises(UnusableFileError, match="was replaced"):
        newer.write(batch(START_S + 32))
    newer.write(batch(START_S + 32, [sample(START_S + 31, sequence=999)]))
    newer.end(None)
    assert sequences(path) == [*range(200), 999]


def test_a_program_that_only_reads_disturbs_nothing(tmp_path: Path) -> None:
    path, writing = tmp_path / "history.db", store(tmp_path)
    for number in range(5):
        writing.write(batch(START_S + number + 1, [sample(START_S + number, sequence=number)]))
        assert sequences(path)[-1] == number
        with sqlite3.connect(path) as foreign, sqlite3.connect(tmp_path / "copy.db") as copy:
            foreign.backup(copy)
        foreign.close()
        copy.close()
    writing.end(None)


@pytest.mark.parametrize("umask", [0o000, 0o022, 0o077])
@pytest.mark.parametrize("is_there", [True, False])
def test_its_owner_alone_may_read_it_whatever_the_umask_and_whoever_made_it(
    tmp_path: Path, umask: int, is_there: bool
) -> None:
    path, before = tmp_path / "history.db", os.umask(umask)
    try:
        if is_there:
            by_hand = sqlite3.connect(path)
            by_hand.execute("PRAGMA journal_mode = WAL")
            for each in files_of(path):
                each.chmod(0o666 & ~umask)
        writing = store(tmp_path)
        writing.write(batch(START_S + 1, [sample(START_S)]))
        assert {each.name: each.stat().st_mode & 0o777 for each in files_of(path)} == dict.fromkeys(
            ("history.db", "history.db-shm", "history.db-wal", "history.db.lock"), 0o600
        )
        writing.end(None)
        if is_there:
            by_hand.close()
    finally:
        os.umask(before)


def test_where_its_permissions_cannot_be_changed_an_event_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    (tmp_path / "history.db").touch()
    (tmp_path / "history.db").chmod(0o644)
    monkeypatch.setattr(Path, "chmod", refuse)
    writing = store(tmp_path)
    texts = [notice.text for notice in writing.write(batch(START_S + 1)).notices]
    writing.end(None)
    assert texts[1].startswith("others may read the history")


def test_a_batch_that_was_refused_is_taken_whole_the_next_time(tmp_path: Path) -> None:
    """The lock of another program represents any refusal of SQLite after a batch has begun."""
    writing = store(tmp_path)
    writing.write(batch(START_S + 1.5, [sample(START_S, 10.0, 1)]))
    refused = batch(START_S + 2.5, [sample(START_S + 0.9, 20.0, 2)], [event(1, START_S + 2)])
    foreign = sqlite3.connect(tmp_path / "history.db", isolation_level=None)
    foreign.execute("BEGIN IMMEDIATE")
    with pytest.raises(sqlite3.OperationalError, match="database is locked"):
        writing.write(refused)
    foreign.execute("ROLLBACK")
    foreign.close()
    writing.write(refused)
    writing.end(None)
    assert sequences(tmp_path / "history.db") == [1, 2]
    with Reader(tmp_path / "history.db") as reader:
        (point,) = reader.trend(START_S * 10**6, (START_S + 1) * 10**6, 1, ["x_mm"]).points
        assert len(reader.events(0, 2**62, ["state"])) == 1
    assert (point.n, point.values["x_mm"].mean) == (2, 15.0)


def test_a_reader_that_does_not_end_stops_the_writing_before_the_log_fills_the_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(open_store, "MAX_LOG_BYTES", 100_000)
    monkeypatch.setattr(opening, "WAL_PAGES", 10)
    writing = store(tmp_path)
    writing.write(batch(START_S, [sample(START_S)]))
    foreign = sqlite3.connect(tmp_path / "history.db", isolation_level=None)
    foreign.execute("BEGIN")
    foreign.execute("SELECT count(*) FROM measurements").fetchone()
    with pytest.raises((UnusableFileError, sqlite3.OperationalError), match="another program blocks it"):
        write_seconds(writing, START_S + 1, [10.0] * 100)
    assert (tmp_path / "history.db-wal").stat().st_size < 300_000
    foreign.execute("COMMIT")
    foreign.close()
    writing.write(batch(START_S + 200, [sample(START_S + 200, sequence=99)]))
    writing.end(None)
    assert sequences(tmp_path / "history.db")[-1] == 99


def test_a_copy_in_a_folder_that_cannot_be_written_is_read(tmp_path: Path) -> None:
    record_seconds(tmp_path, START_S, [10.0])
    copy = tmp_path / "copy"
    copy.mkdir()
    shutil.copy(tmp_path / "history.db", copy)
    (copy / "history.db").chmod(0o400)
    copy.chmod(0o500)
    try:
        assert len(sequences(copy / "history.db")) == 20
    finally:
        copy.chmod(0o700)


@pytest.mark.parametrize("kind", ["folder", "pipe", "missing"])
def test_what_is_no_file_is_not_opened(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "history.db"
    if kind == "folder":
        path.mkdir()
    elif kind == "pipe":
        os.mkfifo(path)
    with pytest.raises((UnusableFileError, FileNotFoundError)):
        open_to_read(path)
    if kind != "missing":
        with pytest.raises(UnusableFileError, match="is not a regular file"):
            store(tmp_path).write(batch(START_S))
