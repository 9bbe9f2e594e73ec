"""The ingest's transactions and the tables' functions on a real PostgreSQL, without a broker."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any, get_type_hints
from unittest.mock import Mock
from urllib.parse import quote

import psycopg
import pytest
from psycopg.rows import dict_row
from support.fleet import Cluster, postgresql, stored_rows

from altd.fleet import ingest as ingest_module
from altd.fleet.database import Writer, connect, maintain, migrate
from altd.fleet.ingest import Ingest
from altd.fleet.settings import FleetSettings
from altd.status.outbox import Batch, Second
from altd.status.proof import sealed


@pytest.fixture(scope="module")
def cluster() -> Iterator[Cluster]:
    with postgresql() as running:
        yield running


def settings_of(cluster: Cluster) -> FleetSettings:
    """Settings of an empty database."""
    database = {"connection": cluster.new_database()}
    return FleetSettings.model_validate({"broker": {"host": "localhost"}, "database": database})


@pytest.fixture
def ingest(cluster: Cluster) -> Iterator[Ingest]:
    """An ingest of an empty database, without a broker."""
    opened = Ingest(settings_of(cluster))
    yield opened
    opened._close_database()  # noqa: SLF001


def document(serial: str, sequence: int, **changes: object) -> dict[str, Any]:
    """A batch of one second; ``changes`` are of this second."""
    second = Second(sequence, 1, 1_795_161_600 + sequence, 20, 20, 0, "", "", [])._replace(**changes)  # type: ignore[arg-type]
    about = {"schema": 1, "serial": serial, "file": "0" * 16, "stream": "0" * 16, "oldest": 1, "dropped": 0}
    return about | {"first": 1, "last": sequence, "newest": sequence, "quantities": [], "rows": [second]}


def message(serial: str, sequence: int, **changes: object) -> tuple[int, Any]:
    """The same as the broker delivers it."""
    payload = sealed(json.dumps(document(serial, sequence, **changes))).encode()
    return 0, Mock(topic=f"altd/{quote(serial, safe='')}/outbox", payload=payload)


def test_the_largest_integers_of_a_batch_fit_their_columns(cluster: Cluster) -> None:
    """A unit that sends them must end neither a transaction of others nor the table of the fleet."""
    largest: dict[str, int] = {}
    hints = get_type_hints(Second, include_extras=True) | get_type_hints(Batch, include_extras=True)
    for name, hint in hints.items():
        if getattr(hint, "__origin__", None) is int:
            limits = {type(limit).__name__: limit for limit in hint.__metadata__[0].metadata}
            largest[name] = limits["Le"].le if "Le" in limits else limits["Lt"].lt - 1
    assert largest.pop("schema_") == 1
    batch = {name: value for name, value in largest.items() if name in Batch.model_fields}
    row = {name: value for name, value in largest.items() if name in Second._fields}
    payload = json.dumps(document("ALT-1", row.pop("sequence"), **row) | batch)
    settings = settings_of(cluster)
    with connect(settings) as connection:
        migrate(connection)
        Writer(connection, settings).write([Batch.model_validate_json(payload)], {})
        stored = connection.cursor(row_factory=dict_row).execute(
            "SELECT sequence, boot, extract(epoch FROM time)::bigint AS t_s, n, n_valid, worst, newest, "
            "seen AS last, upper(streams.received) - 1 AS first, upper(streams.received) - 1 AS oldest, "
            "dropped "
            "FROM altd.seconds JOIN altd.streams USING (unit) JOIN altd.files ON files.id = seconds.file"
        )
        assert stored.fetchone() == largest
        connection.execute(
            "INSERT INTO altd.files (unit, file, dropped) SELECT unit, n::text, dropped "
            "FROM altd.files, generate_series(1, 2000) AS n"
        )
        fleet = connection.execute("SELECT backlog, dropped FROM altd.fleet").fetchall()
    assert fleet == [(0, 2**63 - 1)]


def test_a_unit_whose_batches_the_database_refuses_costs_the_others_a_few_transactions(
    ingest: Ingest, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After three such batches, no message of it is read for a minute."""
    settings = ingest._settings  # noqa: SLF001
    with connect(settings) as connection:
        migrate(connection)
        connection.execute("ALTER TABLE altd.seconds ADD CHECK (cause <> 'hostile')")
    connect_once = Mock(side_effect=connect)
    writes: list[int] = []

    def write(writer: Writer, batches: list[Batch], refused: dict[tuple[str, str], int]) -> object:
        writes.append(len(batches))
        return Writer.write(writer, batches, refused)

    monkeypatch.setattr(ingest_module, "connect", connect_once)
    monkeypatch.setattr(ingest_module, "Writer", type("Counted", (Writer,), {"write": write}))
    for number in range(1, 11):
        messages = [message(f"ALT-{unit}", number) for unit in range(32)]
        messages[7:7] = [message("EVIL", 20 * number + each, cause="hostile") for each in range(20)]
        ingest.take(messages)
        assert len(writes) < 30, "only the first time is a refusal searched"
    ingest.take([message("ALT-1", 11), message("ALT-2", 11, boot=2**40)])
    assert writes[-10:] == [32] * 9 + [1]
    assert connect_once.call_count == 1
    stored = {row[:2] for row in stored_rows(settings.database.connection)}
    assert len(stored) == 321
    assert {serial for serial, _ in stored} == {f"ALT-{unit}" for unit in range(32)}
    assert ingest.rows == 321
    with connect(settings) as connection:
        refused = connection.execute("SELECT unit, reason, count FROM altd.refused ORDER BY 2").fetchall()
    assert refused == [("", "database", 200), ("ALT-2", "schema", 1)]


def test_a_name_that_the_database_cannot_write_is_refused_alone(ingest: Ingest, cluster: Cluster) -> None:
    """The name is in the batch and in the counters of refused messages."""
    settings = ingest._settings  # noqa: SLF001
    name = psycopg.conninfo.conninfo_to_dict(settings.database.connection)["dbname"]
    with psycopg.connect(cluster.connection("postgres"), autocommit=True) as connection:
        connection.execute(f"DROP DATABASE {name}".encode())
        connection.execute(f"CREATE DATABASE {name} TEMPLATE template0 ENCODING LATIN1 LOCALE 'C'".encode())
    ingest.take([message("ALT-1", 1), message("目標", 1), message("ALT-é", 1)])
    ingest.take([message("目標", 2, boot=-1)])
    ingest.take([message("ALT-1", 2)])
    stored = sorted(row[0] for row in stored_rows(settings.database.connection))
    assert stored == ["ALT-1", "ALT-1", "ALT-é"]


def test_a_database_that_takes_nothing_is_tried_again_and_no_unit_is_blamed(
    ingest: Ingest, cluster: Cluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A replica, missing rights or missing tables are no fault of a batch."""
    settings = ingest._settings  # noqa: SLF001
    ingest.take([message("ALT-1", 1)])
    name = psycopg.conninfo.conninfo_to_dict(settings.database.connection)["dbname"]

    def alter(how: str) -> None:
        with psycopg.connect(cluster.connection("postgres"), autocommit=True) as connection:
            connection.execute(f"ALTER DATABASE {name} SET default_transaction_read_only = {how}".encode())

    def mend(_: float) -> None:
        alter("off")

    alter("on")
    ingest._close_database()  # noqa: SLF001
    monkeypatch.setattr(ingest_module.time, "sleep", mend)
    ingest.take([message("ALT-1", 2), message("ALT-2", 2)])
    with connect(settings) as connection:
        connection.execute("DROP SCHEMA altd CASCADE")
    ingest.take([message("ALT-1", 3), message("ALT-2", 3)])
    assert [row[:2] for row in stored_rows(settings.database.connection)] == [
        ("ALT-1", 1_795_161_603),
        ("ALT-2", 1_795_161_603),
    ]
    with connect(settings) as connection:
        assert connection.execute("SELECT * FROM altd.refused").fetchall() == []


def test_a_unit_that_is_deleted_while_the_ingest_runs_is_there_again_with_its_next_second(
    ingest: Ingest,
) -> None:
    settings = ingest._settings  # noqa: SLF001
    ingest.take([message("ALT-1", 1), message("ALT-2", 1)])
    with connect(settings) as connection:
        for table in ("seconds", "streams", "files"):
            sql = f"DELETE FROM altd.{table} USING altd.units WHERE unit = units.id AND serial = 'ALT-1'"
            connection.execute(sql.encode())
        connection.execute("DELETE FROM altd.units WHERE serial = 'ALT-1'")
    ingest.take([message("ALT-1", 2), message("ALT-2", 2)])
    stored = [row[:2] for row in stored_rows(settings.database.connection)]
    assert [(serial, t_s - 1_795_161_600) for serial, t_s in stored] == [
        ("ALT-1", 2),
        ("ALT-2", 1),
        ("ALT-2", 2),
    ]
    with connect(settings) as connection:
        fleet = connection.execute("SELECT unit, extract(epoch FROM last_time) FROM altd.fleet").fetchall()
        files = connection.execute("SELECT count(DISTINCT unit) FROM altd.files").fetchone()
    assert fleet == [("ALT-1", 1_795_161_602), ("ALT-2", 1_795_161_602)]
    assert files == (2,)


def test_the_day_of_a_wrong_clock_comes_and_old_days_go(cluster: Cluster) -> None:
    settings = settings_of(cluster)
    day = "date_trunc('day', now()) + interval '1 day'"
    insert = "INSERT INTO altd.seconds VALUES (1, {}, 1, {}, 1, 1, 1, 0, '', '', '{{}}')"
    count = "SELECT count(*) FROM ONLY altd.seconds_other"
    with connect(settings) as connection:
        migrate(connection)
        migrate(connection)
        connection.execute(insert.format(day, 1).encode())
        connection.execute(insert.format("'1970-01-01'", 2).encode())
        connection.execute("SELECT altd.make_day('2020-01-01')")
        connection.execute(insert.format("'2020-01-01'", 3).encode())
        assert connection.execute(count.encode()).fetchone() == (2,)
        assert maintain(connection, settings) == 0
        assert connection.execute(count.encode()).fetchone() == (1,), "tomorrow has its own partition now"
        found = connection.execute("SELECT sequence FROM altd.seconds ORDER BY 1").fetchall()
        assert found == [(1,), (2,)], "1970 arrived today; 2020 is old"
        connection.execute("UPDATE altd.seconds_other SET received = now() - interval '94 days'")
        with connect(settings) as other:
            assert maintain(other, settings) == 0
        assert connection.execute("SELECT sequence FROM altd.seconds").fetchall() == [(1,)]
        connection.execute("INSERT INTO altd.version VALUES (99)")
        with pytest.raises(Exception, match="of version 99, and this program knows"):
            migrate(connection)


def test_a_hostile_unit_delays_its_own_roll_ups_alone(cluster: Cluster) -> None:
    """Each maintenance rolls up an hour of each unit; unit 1 has 100,000, and a value without a sum."""
    settings = settings_of(cluster)
    with connect(settings) as connection:
        migrate(connection)
        for sql in (
            "INSERT INTO altd.units (serial) SELECT 'ALT-' || n FROM generate_series(1, 3) AS n",
            "INSERT INTO altd.stale SELECT 1, to_timestamp(3600.0 * n), now() - interval '1 h' "
            "FROM generate_series(0, 99999) AS n",
            "INSERT INTO altd.stale SELECT unit, to_timestamp(3600 * n), now() - interval '1 h' "
            "FROM generate_series(2, 3) AS unit, generate_series(1, 2) AS n",
            "INSERT INTO altd.seconds SELECT n, to_timestamp(3600), 1, 1, 1, 9, 9, 0, '', '', "
            "jsonb_build_object('x_mm', jsonb_build_array(CASE n WHEN 1 THEN 1e308 ELSE 1 END, 1, 1, 1)) "
            "FROM generate_series(1, 3) AS n",
        ):
            connection.execute(sql.encode())
        for hours, others in ((3, [(2, 1), (3, 1)]), (3, []), (1, [])):
            assert maintain(connection, settings) == hours
            left = connection.execute(
                "SELECT unit, count(*) FROM altd.stale GROUP BY 1 ORDER BY 1"
            ).fetchall()
            assert left[1:] == others
        rolled = connection.execute("SELECT unit FROM altd.hours ORDER BY 1").fetchall()
        assert rolled == [(2,), (3,)]
        refused = connection.execute("SELECT unit, reason, count FROM altd.refused").fetchall()
        assert refused == [("ALT-1", "database", 1)]
