"""``altd events --follow`` while the daemon writes."""

from __future__ import annotations

import sqlite3
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest
from support.history import START_S, batch, event, store

from altd.answers.events import answer
from altd.history.opening import DAMAGED, move_aside
from altd.status.event_log import EventKind


def write(folder: Path, number: int, text: str) -> None:
    """As a daemon does that is started, notes an event and ends."""
    writing = store(folder)
    writing.write(
        batch(START_S + number + 1, (), [event(number, START_S + number, EventKind.REQUEST, 1, text)])
    )
    writing.end(None)


def begin(history: Path) -> None:
    """As a daemon does before the first table is on its disk."""
    with closing(sqlite3.connect(history)) as connection:
        connection.execute("PRAGMA journal_mode = WAL")


def test_goes_on_with_the_file_that_the_daemon_begins_anew(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    history = tmp_path / "history.db"
    write(tmp_path, 1, "the first")

    def pauses() -> Iterator[None]:
        yield
        write(tmp_path, 2, "the second")
        yield
        move_aside(history, DAMAGED)
        begin(history)
        yield  # it is seen that there is another file
        yield
        yield
        write(tmp_path, 1, "in a new file")
        yield
        yield
        raise KeyboardInterrupt

    pause = pauses()
    monkeypatch.setattr(time, "sleep", lambda seconds: next(pause))
    with pytest.raises(KeyboardInterrupt):
        answer(history, (0, 2**62), ("request",), "text", follow=True)
    said = [line.split(" request ")[1].strip() for line in capsys.readouterr().out.splitlines()]
    assert said == ["the first", "the second", "in a new file"]
