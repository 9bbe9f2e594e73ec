"""An ingest: ``fleet.toml``, what a message must be, and messages held while the database is away."""

from __future__ import annotations

import json
import sys
from ctypes.util import find_library
from pathlib import Path
from typing import TYPE_CHECKING, Any
from unittest.mock import Mock

import pytest
from support.cli import altd_here
from support.foreign import need
from support.places import ROOT

from altd.errors import BadInputError
from altd.fleet import intake as limits
from altd.fleet.intake import BURST, RATE_HZ, Intake, RefusalReason
from altd.fleet.settings import load_fleet_settings
from altd.status.outbox import Batch
from altd.status.proof import sealed

if TYPE_CHECKING:
    from altd.fleet.ingest import Ingest


@pytest.fixture
def ingest(tmp_path: Path) -> Ingest:
    need(find_library("pq") is not None, "libpq is not installed (Debian package libpq5)")
    from altd.fleet.ingest import Ingest

    settings = tmp_path / "fleet.toml"
    settings.write_text('[broker]\nhost = "broker"\n[database]\nconnection = "dbname=altd"\n')
    return Ingest(load_fleet_settings(tmp_path / "fleet.toml"))


def test_messages_of_a_connection_that_ended_are_not_kept(ingest: Ingest) -> None:
    """A broker that comes and goes while the database is away delivers the same thousand again and again."""
    connected = Mock(is_failure=False)
    client, message = Mock(), Mock(payload=b"")
    for _ in range(100):
        ingest._on_connect(Mock(), None, None, connected, None)  # noqa: SLF001  as paho calls it
        for _ in range(1000):
            ingest._on_message(client, None, message)  # noqa: SLF001
    assert ingest._messages.qsize() == 1000  # noqa: SLF001


def test_what_was_committed_is_reported_once_a_minute(
    ingest: Ingest, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO")
    begin_s = ingest._reported_s  # noqa: SLF001
    told = []
    for after_s in (1.0, 59.0, 61.0, 100.0, 120.0, 122.0):
        ingest.rows += 7
        ingest._report(begin_s + after_s)  # noqa: SLF001
        told.append(caplog.messages[-1:])
        caplog.clear()
    lines = [[f"ingest: {rows} seconds committed since the start"] for rows in (21, 42)]
    assert told == [[], [], lines[0], [], [], lines[1]]


@pytest.mark.parametrize("at_start", [True, False])
def test_a_database_that_is_away_is_tried_more_and_more_rarely_and_logged_once(
    ingest: Ingest, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch, at_start: bool
) -> None:
    import psycopg

    from altd.fleet import ingest as module

    waits_s, opened = list[float](), Mock(return_value=Mock())
    opened.side_effect = [psycopg.OperationalError("refused\n")] * 8 + [opened.return_value]
    monkeypatch.setattr(module.time, "sleep", waits_s.append)
    monkeypatch.setattr(ingest, "_open_database", opened)
    if at_start:
        monkeypatch.setattr(module.threading, "Thread", Mock(side_effect=StopIteration))
        with pytest.raises(StopIteration):
            ingest._run()  # noqa: SLF001
    else:
        ingest._write([], {})  # noqa: SLF001
    assert waits_s == [0.2, 0.4, 0.8, 1.6, 3.2, 6.4, 10.0, 10.0]
    said = "no database yet" if at_start else "the database does not take it"
    assert caplog.messages == [f"ingest: {said}: refused; trying again"]


GOOD = """\
[broker]
host = "broker.plant.example"
ca = "plant-ca.pem"

[database]
connection = "dbname=altd"
"""


def test_paths_count_from_the_folder_of_the_file(tmp_path: Path) -> None:
    (tmp_path / "fleet.toml").write_text(GOOD)
    settings = load_fleet_settings(tmp_path / "fleet.toml")
    assert settings.broker.ca == tmp_path / "plant-ca.pem"
    assert settings.broker.port_or_default == 8883
    assert settings.retention.seconds_days == 93


def test_the_example_is_good() -> None:
    assert load_fleet_settings(ROOT / "config" / "fleet.toml").broker.group == "altd"


@pytest.mark.parametrize(
    ("before", "after", "said"),
    [
        ("host", "hots", "2:1: broker.hots: there is no such key; possible: ca, certificate"),
        ('host = "broker.plant.example"\n', "", "1:1: broker.host: this key is missing"),
        ('"broker.plant.example"', '"mqtt://x"', '2:8: broker.host: "mqtt://x" is not a host name'),
        ('"dbname=altd"', "5", "6:14: database.connection: 5 is not text: write it in quotes"),
        ("[database]", "[databse]", "there is no such table; possible: broker, database, retention; did you"),
        (GOOD, GOOD + "[retention]\nseconds_days = 1\n", "8:16: retention.seconds_days: 1 is too small"),
        ("[broker]", "[broker", "1:8: "),
    ],
)
def test_a_fault_is_said_with_its_place(tmp_path: Path, before: str, after: str, said: str) -> None:
    path = tmp_path / "fleet.toml"
    path.write_text(GOOD.replace(before, after))
    with pytest.raises(BadInputError) as refused:
        load_fleet_settings(path)
    lines = [line.replace("line ", "").replace(", column ", ":") for line in refused.value.lines]
    assert any(said in line for line in lines), lines
    for command in ("ingest", "fleet"):
        outcome = altd_here(command, "--config", path)
        assert (outcome.status, outcome.out) == (2, "")
        assert outcome.err.splitlines() == [f"altd {command}: {line}" for line in refused.value.lines]


def test_a_database_that_is_not_there_is_one_line(tmp_path: Path) -> None:
    need(find_library("pq") is not None, "libpq is not installed (Debian package libpq5)")
    path = tmp_path / "fleet.toml"
    path.write_text(GOOD.replace("dbname=altd", f"host={tmp_path} dbname=altd"))
    outcome = altd_here("fleet", "--config", path)
    assert (outcome.status, outcome.out, outcome.err.count("\n")) == (2, "", 1)
    assert outcome.err.startswith("altd fleet: database.connection: ")


def test_without_the_databases_client_one_line_names_what_is_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "psycopg", None)
    for module in ("database", "ingest", "table"):
        monkeypatch.delitem(sys.modules, f"altd.fleet.{module}", raising=False)
    path = tmp_path / "fleet.toml"
    path.write_text(GOOD)
    for command in ("ingest", "fleet"):
        outcome = altd_here(command, "--config", path)
        assert (outcome.status, outcome.err.count("\n")) == (2, 1)
        assert "database.connection: needs psycopg" in outcome.err


TOPIC = "plant/line-4/ALT%2F7/outbox"
ROW = [5, 2, 1_795_161_600, 20, 19, 1, "front_dim", "front_spot_missing", [[10.0, 0.004, 9.9, 10.1], None]]
BATCH = {
    "schema": 1,
    "serial": "ALT/7",
    "file": "0123456789abcdef",
    "stream": "fedcba9876543210",
    "oldest": 1,
    "first": 4,
    "last": 6,
    "newest": 6,
    "dropped": 0,
    "quantities": ["x_mm", "roll_deg"],
    "rows": [ROW],
    "unit": "00000000",
}


def message(**changes: object) -> bytes:
    return sealed(json.dumps({**BATCH, **changes})).encode()


def check(payload: bytes, topic: str = TOPIC) -> Batch | RefusalReason:
    return Intake("plant/line-4").check(topic, payload, 0.0)


def row(place: int, value: object) -> dict[str, Any]:
    return {"rows": [[*ROW[:place], value, *ROW[place + 1 :]]]}


def test_a_batch_that_verifies() -> None:
    batch = check(message())
    assert batch.rows[0].values == [(10.0, 0.004, 9.9, 10.1), None]
    assert isinstance(check(message(rows=[], first=6)), Batch), "all of it was dropped"


def test_each_damaged_byte_is_found() -> None:
    good = message()
    for place in range(len(good)):
        damaged = bytearray(good)
        damaged[place] ^= 1
        assert check(bytes(damaged)) is RefusalReason.CRC, place


@pytest.mark.parametrize(
    "changes",
    [
        {"schema": 2},
        {"schema": True},
        {"file": "x"},
        {"oldest": 0},
        {"oldest": 5},
        {"first": 7},
        {"last": 2**53},
        {"last": "6"},
        {"dropped": -1},
        {"quantities": ["x_mm"]},
        {"quantities": ["x_mm", "Robert'); DROP"]},
        {"quantities": ["x_mm", 'a":[1]}\t']},
        {"rows": [ROW, ROW]},
        {"serial": "\u0000"},
        row(0, 3),
        row(0, 7),
        row(1, -1),
        row(2, 1.5),
        row(2, 2**35),
        row(3, 18),
        row(5, 5),
        row(6, "a\tb"),
        row(7, "\\N\n"),
        row(8, [[10.0, 0.004, 9.9], None]),
        row(8, [["10.0", 0.004, 9.9, 10.1], None]),
        row(8, [[float("nan"), 0.004, 9.9, 10.1], None]),
        row(8, [[float("inf"), 0.004, 9.9, 10.1], None]),
    ],
)
def test_what_no_unit_sends_is_refused_with_the_right_crc(changes: dict[str, object]) -> None:
    assert check(message(**changes)) is RefusalReason.SCHEMA


@pytest.mark.parametrize("payload", [b"", b"{}", b"\xff\x00", sealed("{" + "[" * 9000 + "}").encode()])
def test_garbage(payload: bytes) -> None:
    assert check(payload) in (RefusalReason.CRC, RefusalReason.SCHEMA)


@pytest.mark.parametrize(
    "topic",
    [
        "plant/line-4/ALT%2F8/outbox",
        "plant/line-4/%41LT%2F7/outbox",  # another user name for an access list
        "plant/ALT%2F7/outbox",
        "ALT%2F7",
        "plant/line-4/%00/outbox",
    ],
)
def test_a_batch_on_the_topic_of_another_unit(topic: str) -> None:
    assert check(message(), topic) is RefusalReason.UNIT


def test_a_flood_is_refused_before_it_is_read_and_others_are_not() -> None:
    intake = Intake("plant/line-4")
    found = [intake.check(TOPIC, b"flood", 10.0) for _ in range(1000)]
    assert found.count(RefusalReason.CRC) == BURST
    assert found[-1] is RefusalReason.RATE
    assert isinstance(intake.check(TOPIC.replace("7", "8"), message(serial="ALT/8"), 10.0), Batch)
    later = [intake.check(TOPIC, b"flood", 12.0) for _ in range(1000)]
    assert later.count(RefusalReason.CRC) == 2 * RATE_HZ


def test_seconds_that_no_unit_can_have_measured_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """A unit whose messages verify could otherwise fill the database of all."""
    assert limits.SECONDS_BURST == 31 * 86_400, "a catch-up after 31 days is not delayed"
    monkeypatch.setattr(limits, "SECONDS_BURST", 100.0)
    intake = Intake("plant/line-4")
    batch = message(rows=[[number, *ROW[1:]] for number in range(1, 11)], first=1, last=10)
    found = [intake.check(TOPIC, batch, 10.0) for _ in range(12)]
    assert [isinstance(each, Batch) for each in found] == 10 * [True] + 2 * [False]
    assert found[-1] is RefusalReason.RATE
    assert isinstance(intake.check(TOPIC.replace("7", "8"), message(serial="ALT/8"), 10.0), Batch)
    empty = message(rows=[], first=6)
    later = [intake.check(TOPIC, empty, 15.0) for _ in range(20)]
    empty_counts = "an empty one counts as one"
    assert [isinstance(each, Batch) for each in later] == 10 * [True] + 10 * [False], empty_counts
    live = [intake.check(TOPIC, message(), 20.0 + second) for second in range(1000)]
    assert all(isinstance(each, Batch) for each in live), "one a second is always admitted"
