"""Each query of the dashboards and alerts in `examples/grafana`, on the real database with data."""

import asyncio
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import psycopg
import pytest
import yaml
from support.cli import altd_here
from support.fleet import FleetUnit, fleet_toml, ingesting, postgresql, until
from support.history import batch, sample, state
from support.mqtt import mosquitto
from support.places import ROOT

GRAFANA = ROOT / "examples" / "grafana"
QUERIES = {
    f"{path.stem}: {panel['title']}": target["rawSql"]
    for path in sorted((GRAFANA / "dashboards").glob("*.json"))
    for panel in json.loads(path.read_text())["panels"]
    for target in panel["targets"]
}
RULES = [
    rule
    for group in yaml.safe_load((GRAFANA / "provisioning/alerting/altd.yaml").read_text())["groups"]
    for rule in group["rules"]
]
ALERTS = {rule["title"]: rule["data"][0]["model"]["rawSql"] for rule in RULES}
ALL_TIME = r"\1 BETWEEN '2020-01-01' AND '2040-01-01'"


@pytest.fixture(scope="module")
def database(tmp_path_factory: pytest.TempPathFactory) -> Iterator[psycopg.Connection]:
    """Of a unit that was blind for a second, and was restarted; and of one that has sent garbage."""
    folder = tmp_path_factory.mktemp("fleet")
    unit = FleetUnit("ALT-1", folder / "unit")
    unit.write(100)
    unit.store.end(None)
    unit.open(unit.outbox)
    unit.written_s += 1
    blind: list[Any] = [state(unit.written_s, 2, "front_spot_missing"), sample(unit.written_s, None)]
    unit.store.write(batch(unit.written_s + 5, blind))

    async def send(port: int) -> None:
        async with unit.running(port):
            await until(lambda: unit.outbox.mark is not None and unit.waiting() == 0)

    with postgresql() as cluster, mosquitto(folder, "allow_anonymous true") as (port, _):
        connection = cluster.new_database()
        with ingesting(fleet_toml(folder, port, connection)):
            asyncio.run(send(port))
        with psycopg.connect(connection, autocommit=True) as opened:
            opened.execute("INSERT INTO altd.refused VALUES ('ALT-1', 'crc', 3)")
            while opened.execute("SELECT altd.roll_up(0, '0 s')").fetchone() != (None,):
                pass
            yield opened
    unit.close()


@pytest.mark.parametrize("title", QUERIES)
def test_each_panel_shows_the_data(title: str, database: psycopg.Connection) -> None:
    sql = re.sub(r"\$__timeFilter\(([a-z.]+)\)", ALL_TIME, QUERIES[title])
    found = database.execute(sql.replace("${unit:sqlstring}", "'ALT-1'").encode())
    rows = found.fetchall()
    assert rows, "no data"
    assert "$" not in sql.replace("${unit:sqlstring}", "")
    columns = [column.name for column in found.description or ()]
    assert len(set(columns)) == len(columns)


def test_time_in_which_a_unit_was_off_is_not_valid(database: psycopg.Connection) -> None:
    """100 s of its hours had a valid measurement. The view takes a unit of less than two hours as new."""
    by_hour = QUERIES["fleet: Availability by hour"].replace("$__timeFilter(h.time)", "true").encode()
    assert sum(3600 * share for _, _, share in database.execute(by_hour)) == pytest.approx(100)
    shares = "SELECT valid_share FROM altd.fleet"
    too_little = ALERTS["A unit measures too little"].encode()
    assert database.execute(shares).fetchall() == [(pytest.approx(100 / 101),)]
    with database.transaction(force_rollback=True):
        database.execute(
            "INSERT INTO altd.hours SELECT id, last_time - interval '1 day', 1, 1, 1, 0, '{}' FROM altd.units"
        )
        assert database.execute(shares).fetchall() == [(pytest.approx(100 / 3600),)]
        assert database.execute(too_little).fetchall() == [("ALT-1", 1)]
        database.execute("UPDATE altd.seconds SET n = 0, n_valid = 0")
        database.execute("UPDATE altd.hours SET n = 0, n_valid = 0")
        assert database.execute(shares).fetchall() == [(0.0,)], "no frame, no measurement"
        assert {share for _, _, share in database.execute(by_hour)} == {0.0}
        assert database.execute(too_little).fetchall() == [("ALT-1", 1)]
        database.execute("DELETE FROM altd.seconds")
        assert database.execute(shares).fetchall() == [(None,)], "not known any more"


@pytest.mark.parametrize("title", ALERTS)
def test_each_alert_names_the_unit(title: str, database: psycopg.Connection) -> None:
    rows = database.execute(ALERTS[title].encode()).fetchall()
    is_healthy = "too little" in title or "clock" in title
    assert rows == ([] if is_healthy else [("ALT-1", 3 if "deleted" in title else 1)])


def test_no_alert_fires_on_a_healthy_fleet(database: psycopg.Connection) -> None:
    """Without ``noDataState`` Grafana fires on a query without a row."""
    with database.transaction(force_rollback=True):
        database.execute("DELETE FROM altd.refused")
        database.execute("UPDATE altd.units SET last_time = now(), heard = now()")
        for rule in RULES:
            rows = database.execute(ALERTS[rule["title"]].encode()).fetchall()
            assert (rows, rule.get("noDataState")) == ([], "OK"), rule["title"]


def test_a_clock_that_is_ahead_does_not_hide_silence(database: psycopg.Connection, tmp_path: Path) -> None:
    table = ("fleet", "--config", fleet_toml(tmp_path, 1883, database.info.dsn))
    times = database.execute("SELECT last_time, heard FROM altd.units").fetchone()
    database.execute(
        "UPDATE altd.units SET last_time = now() + interval '26 h', heard = now() - interval '2 h'"
    )
    try:
        for title in ("A unit is silent", "A unit's clock is ahead"):
            assert database.execute(ALERTS[title].encode()).fetchall() == [("ALT-1", 1)], title
        units = QUERIES["fleet: Units"].encode()
        assert database.execute(units).fetchone() == (1, 0, 1), "of 1 unit, none is live"
        cells = re.split(r" {2,}", altd_here(*table).out.splitlines()[1])
        (unit,) = json.loads(altd_here(*table, "--json").out)
    finally:
        database.execute("UPDATE altd.units SET last_time = %s, heard = %s", times)
    assert cells[1].endswith("Z +1 d 4 h")
    assert cells[4] == "2 h 0 min"
    assert unit["lag_s"] == pytest.approx(7200, abs=60)


def test_the_table_in_a_terminal_shows_the_worst(database: psycopg.Connection, tmp_path: Path) -> None:
    """Severity 2 is *out of specification*, the third of NE 107 (`altd/reasons.py`)."""
    config = fleet_toml(tmp_path, 1883, database.info.dsn)
    head, row = altd_here("fleet", "--config", config).out.splitlines()
    wanted = "unit newest state cause lag valid in 1 h backlog dropped refused"
    assert " ".join(head.split()) == wanted
    cells = re.split(r" {2,}", row)
    assert cells[:4] == ["ALT-1", "2026-11-20T08:01:41Z", "out_of_specification", "front_spot_missing"]
    assert cells[5:] == ["99.0 %", "0.0 s", "0", "3"], "100 of 101 s"


def test_all_dashboards_use_the_provisioned_source() -> None:
    (source,) = yaml.safe_load((GRAFANA / "provisioning/datasources/altd.yaml").read_text())["datasources"]
    texts = [path.read_text() for path in (GRAFANA / "dashboards").glob("*.json")]
    assert set(re.findall(r'"type": "postgres",\s*"uid": "([a-z]+)"', "".join(texts))) == {source["uid"]}
    assert Path(GRAFANA / "dashboards/unit.json").exists()
