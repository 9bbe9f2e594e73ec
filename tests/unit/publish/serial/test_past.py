"""`history` and `log` on the console: what a real file holds, also by the wire."""

from datetime import UTC, datetime
from pathlib import Path

import pytest
from support.clock import FakeClock
from support.history import START_S, batch, sample, store
from support.serving import serving
from support.wire import Wire

from altd.config import ConsolePortSettings
from altd.history.history import History
from altd.instruments.beam.instrument import QUANTITIES
from altd.publish.serial.console import Console
from altd.publish.serial.parts_text import SHOWN_EVENTS, Past, history_text
from altd.publish.serial.publisher import ConsolePublisher
from altd.status.event_log import EventKind, EventLog
from altd.status.health import Health
from altd.status.unit import PublishedUnit

from .conftest import answer, well

NOW_S = START_S + 3600


@pytest.fixture
def events(clock: FakeClock) -> EventLog:
    return EventLog(clock)


@pytest.fixture
def past(tmp_path: Path, events: EventLog) -> Past:
    """An hour: x is 10 mm in its first half; in the second 20 mm in every other measurement, else no spot."""
    writing = store(tmp_path)
    writing.write(batch(START_S - 1))
    samples = []
    for second in range(0, 3600, 10):
        late = second >= 1800
        lost = late and second % 20 == 0
        samples.append(sample(START_S + second, None if lost else 20.0 if late else 10.0, second + 1))
    writing.write(batch(NOW_S, samples))
    writing.end(None)
    return Past(events, History(tmp_path / "history.db"), lambda: datetime.fromtimestamp(NOW_S, UTC))


async def test_the_last_hour_is_told_in_twelve_steps(past: Past) -> None:
    lines = (await history_text(past, QUANTITIES, "hour")).split("\n")
    await past.history.end()
    assert lines[0].split() == ["from", "(UTC)", "valid", "x", "mm", "y", "mm", "yaw", "deg", "pitch", "deg"]
    rows = [line.split() for line in lines[1:]]
    assert len(rows) == 12
    assert {(row[1], row[3]) for row in rows[:6]} == {("100", "10.000")}
    assert {(row[1], row[3], row[-1]) for row in rows[6:]} == {("50", "20.000", "front_spot_missing")}
    assert max(map(len, lines)) < 80


async def test_spans_without_a_daemon_have_no_row(past: Past) -> None:
    lines = (await history_text(past, QUANTITIES, "month")).split("\n")
    assert len(lines) == 2
    later = Past(past.events, past.history, lambda: datetime.fromtimestamp(NOW_S + 7200, UTC))
    assert await history_text(later, QUANTITIES, "hour") == "nothing was measured in the last hour"
    await past.history.end()


async def test_what_cannot_be_read_is_said(past: Past, tmp_path: Path) -> None:
    none = Past(past.events, History(None, "the history is off: disabled in [history]"), past.now)
    said = await history_text(none, QUANTITIES, "day")
    assert said == "no history: the history is off: disabled in [history]"
    (tmp_path / "other.db").write_bytes(b"\x1b[2J" * 1000)
    broken = Past(past.events, History(tmp_path / "other.db"), past.now)
    assert (await history_text(broken, QUANTITIES, "day")).startswith("no history: ")
    timeless = Past(past.events, past.history, lambda: None)
    assert await history_text(timeless, QUANTITIES, "day") == "no history: the time of day is not known"
    for each in (none, broken, past):
        await each.history.end()


async def test_it_comes_over_the_wire_and_what_is_typed_meanwhile_waits(
    wire: Wire, published: PublishedUnit, clock: FakeClock, health: Health, past: Past
) -> None:
    settings = ConsolePortSettings(device=wire.device, speaks="console")
    publisher = ConsolePublisher(settings, published, health.component("serial"), past)
    async with serving(publisher):
        wire.send(b"history\rversion\r")
        shown = await wire.receive(lambda shown: shown.endswith(b"unit ALT-0007\r\n> "))
    await past.history.end()
    assert shown.count(b"10.000") == 6
    assert shown.index(b"spot_missing") < shown.index(b"version\r\n")


def test_the_log_has_the_newest_events_first(clock: FakeClock, events: EventLog, past: Past) -> None:
    typed = Console(well(), past)
    assert b"nothing has happened so far" in typed.feed(b"log\r")
    for number in range(30):
        clock.now_ns += 20_000_000_000
        events.note(EventKind.CAUSE_CAME, f"event {number} " + "told at length " * 5, "front")
    events.note(EventKind.REQUEST, "\x1b[2J\r\nforged\u00e4", "console")
    shown = typed.feed(b"log\r").decode("ascii")
    assert "\x1b" not in shown
    lines = shown.split("\r\n")
    assert "request console: " in lines[1]
    assert "began front: event 29 told at length" in lines[2]
    assert f"event {30 - SHOWN_EVENTS + 1} " in shown + typed.feed(b" ").decode("ascii")
    assert max(map(len, lines)) < 80


def test_a_daemon_that_remembers_nothing_says_so() -> None:
    assert answer("log") == answer("history") == ["this daemon stores no history"]
    assert answer("history year") == ["usage: history [hour|day|month], not 'year'"]
