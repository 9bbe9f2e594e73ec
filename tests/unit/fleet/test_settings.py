"""``fleet.toml``: its paths, and a line with the place of each fault."""

from __future__ import annotations

import sys
from ctypes.util import find_library
from pathlib import Path

import pytest
from support.cli import altd_here
from support.foreign import need
from support.places import ROOT

from altd.errors import BadInputError
from altd.fleet.settings import load_fleet_settings

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
        ("host", "hots", "2:1: broker.hots: there is no such key; possible: host, port"),
        ('host = "broker.plant.example"\n', "", "1:1: broker.host: this key is missing"),
        (
            '"broker.plant.example"',
            '"mqtt://x"',
            '2:8: broker.host: "mqtt://x" is not a host name',
        ),
        (
            '"dbname=altd"',
            "5",
            "6:14: database.connection: 5 is not text in quotes; possible: text",
        ),
        ("[database]", "[databse]", "there is no such key; possible: broker, database, retention; did you"),
        (
            GOOD,
            GOOD + "[retention]\nseconds_days = 1\n",
            "8:16: retention.seconds_days: 1 is too small",
        ),
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
