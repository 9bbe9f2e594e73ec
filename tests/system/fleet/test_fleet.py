"""From the histories of units through a real broker into a real PostgreSQL, and all that may go wrong."""

import asyncio
import contextlib
import itertools
import json
import signal
import subprocess
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

import psycopg
import pytest
from support.cli import altd_here
from support.fleet import (
    LIMITS,
    Cluster,
    FleetUnit,
    Row,
    fleet_toml,
    guarded_broker,
    ingesting,
    postgresql,
    stored_rows,
    until,
)
from support.foreign import need_program
from support.history import START_S
from support.mqtt import ChosenBroker, mosquitto, subscribed
from support.played_unit import PlayedUnit, playing

from altd.publish.mqtt import connecting, outbox
from altd.runtime import supervision
from altd.status.proof import sealed
from benchmarks.harness import Child, child, module_command

BROKER = ("allow_anonymous true", *LIMITS)


@pytest.fixture(scope="module")
def cluster() -> Iterator[Cluster]:
    with postgresql() as running:
        yield running


@pytest.fixture(autouse=True)
def fast(monkeypatch: pytest.MonkeyPatch) -> None:
    for place, name, value in (
        (connecting, "MAX_JITTER_S", 0.0),
        (supervision, "MIN_BACKOFF_S", 0.05),
        (supervision, "MAX_BACKOFF_S", 0.1),
        (outbox, "LIVE_INTERVAL_S", 0.05),
        (outbox, "CATCH_UP_INTERVAL_S", 0.02),
        (outbox, "RESEND_AFTER_S", 0.5),
        (outbox, "MAX_RESEND_S", 1.0),
    ):
        monkeypatch.setattr(place, name, value)


def is_whole(connection: str, units: list[FleetUnit]) -> bool:
    """Whether the database has each second of the units' histories once, and in its place."""
    stored = stored_rows(connection)
    expected: set[Row] = set().union(*(unit.rows() for unit in units))
    places = [row[:2] for row in stored]
    return len(stored) == len(expected) and set(stored) == expected and places == sorted(places)


async def test_crashes_of_broker_ingest_and_database_lose_nothing(cluster: Cluster, tmp_path: Path) -> None:
    connection = cluster.new_database()
    units = [FleetUnit(f"ALT/{number}", tmp_path / str(number)) for number in range(3)]
    async with contextlib.AsyncExitStack() as stack:
        broker = contextlib.ExitStack()
        port, process = broker.enter_context(mosquitto(tmp_path, *BROKER))
        config = fleet_toml(tmp_path, port, connection)
        stack.enter_context(ingesting(config))
        victim = stack.enter_context(ingesting(config))
        for unit in units:
            unit.write(1500)
            await stack.enter_async_context(unit.running(port))
        for deed in ("broker", "ingest", "database", "unit", "broker"):
            for unit in units:
                unit.write(700)
            await asyncio.sleep(0.15)  # in the midst of it
            match deed:
                case "broker":
                    process.kill()
                    process.wait()
                    broker.pop_all()
                    _, process = broker.enter_context(mosquitto(tmp_path, *BROKER, port=port))
                case "ingest":
                    victim.kill()
                    victim.wait()
                    victim = stack.enter_context(ingesting(config))
                case "database":
                    cluster.stop(signal.SIGQUIT)
                    cluster.start()
                case "unit":
                    units[0].close()
                    units[0].open(units[0].outbox)
        await until(lambda: all(unit.waiting() == 0 for unit in units))
        broker.close()
    assert all(unit.written_s == START_S + 5000 for unit in units)
    assert is_whole(connection, units)
    for unit in units:
        unit.close()


async def batches_of(unit: FleetUnit) -> list[bytes]:
    """All that a unit sends to a broker behind which there is no ingest."""
    messages = []
    async with ChosenBroker() as chosen, unit.running(chosen.port):
        last = 0
        while last < unit.written_s - START_S:
            messages.append((await chosen.until("outbox")).data)
            last = json.loads(messages[-1])["last"]
    return messages


def publish(port: int, unit: str, payload: bytes, *arguments: str, topic: str = "outbox") -> None:
    """A foreign client's message."""
    words = [*client(port, f"altd/{unit}/{topic}"), "-s", *arguments]
    subprocess.run(words, input=payload, check=False, capture_output=True)


def client(port: int, topic: str) -> list[str]:
    program = need_program("mosquitto_pub", "mosquitto-clients")
    return [program, "-V", "5", "-p", str(port), "-q", "1", "-t", topic]


@contextlib.contextmanager
def flooding(port: int, topic: str, *arguments: str) -> Iterator[None]:
    """20,000 messages as fast as the broker takes them."""
    with subprocess.Popen([*client(port, topic), "-l", *arguments], stdin=subprocess.PIPE) as flood:
        assert flood.stdin is not None
        flood.stdin.write(b"flood\n" * 5000)
        try:
            yield
        finally:
            flood.kill()


async def test_batches_reversed_and_repeated_are_stored_once_and_acknowledged_without_a_hole(
    cluster: Cluster, tmp_path: Path
) -> None:
    connection = cluster.new_database()
    unit = FleetUnit("ALT-1", tmp_path)
    unit.write(400)
    batches = await batches_of(unit)
    assert len(batches) == 4
    with mosquitto(tmp_path, *BROKER) as (port, _):
        config = fleet_toml(tmp_path, port, connection)
        acknowledged = []
        with ingesting(config), ingesting(config):
            async with subscribed(port, topic="altd/ALT-1/ack") as acks:
                for payload in (*reversed(batches), *batches):
                    await asyncio.to_thread(publish, port, "ALT-1", payload)
                    _, _, _, text = await acks.next()
                    acknowledged.append(json.loads(text)["sequence"])
        with ingesting(config):  # another one later: it knows nothing of the others
            async with subscribed(port, topic="altd/ALT-1/ack") as acks:
                assert json.loads((await acks.next())[3])["sequence"] == 400, "retained"
                await asyncio.to_thread(publish, port, "ALT-1", batches[2])
                assert json.loads((await acks.next())[3])["sequence"] == 400
    assert acknowledged == [0, 0, 0, 400, 400, 400, 400, 400]
    assert is_whole(connection, [unit])
    unit.close()


async def test_a_hostile_unit_harms_itself_alone(cluster: Cluster, tmp_path: Path) -> None:
    """The worked example of docs/fleet.md holds it to its own topics; there it writes all it likes."""
    connection = cluster.new_database()
    good, evil = FleetUnit("ALT-1", tmp_path / "good"), FleetUnit("ALT-9", tmp_path / "evil")
    good.write(1500)
    evil.write(90)
    (batch,) = await batches_of(evil)
    stolen = (await batches_of(good))[0]
    body = json.loads(batch)
    del body["crc32"]
    rows = body.pop("rows")

    def forged(**changes: object) -> bytes:
        return sealed(json.dumps({**body, "rows": rows[:1], "last": 1, **changes})).encode()

    as_evil = ("-u", "ALT-9", "-P", "secret")
    with mosquitto(tmp_path, *guarded_broker(tmp_path, "ALT-1", "ALT-9", "ingest")) as (port, _):
        config = fleet_toml(tmp_path, port, connection, f'credentials = "{tmp_path / "ingest"}"')
        with ingesting(config):
            future = forged(rows=[[1, 1, 2**34, 1, 1, 0, "", "", [None] * len(body["quantities"])]])
            for unit, payload in (
                ("ALT-9", batch),
                ("ALT-1", stolen),  # as another: the broker refuses it
                ("ALT-9", stolen),  # of another, on its own topic
                ("ALT-9", batch.replace(b"10.0", b"99.9", 1)),
                ("ALT-9", b"\x00\xff garbage"),
                ("ALT-9", sealed("{" + "[" * 5000 + "}").encode()),
                ("ALT-9", forged(schema=2)),
                ("ALT-9", forged(rows=[[1, 1, 1, 1, 1, 0, "';--", "", []]])),
                ("ALT-9", forged(rows=[rows[1], rows[0]], last=2)),
                ("ALT-9", forged(rows=[[1, 1, 1, 1, 2, *rows[0][5:]]])),
                ("ALT-9", batch),  # old
                ("ALT-9", future),
            ):
                publish(port, unit, payload, *as_evil)
            publish(port, "ALT-1", b'{"sequence": 90}', *as_evil, topic="ack")
            with flooding(port, "altd/ALT-9/outbox", *as_evil):
                async with good.running(port, credentials=tmp_path / "ALT-1") as publishing:
                    await until(lambda: good.waiting() == 0)
            counters = publishing.health.component("outbox").counters
        table = altd_here("fleet", "--config", config, "--json")
    with psycopg.connect(connection) as opened:
        counted = opened.execute("SELECT unit, reason, count FROM altd.refused").fetchall()
        refused = {reason: count for unit, reason, count in counted if unit == "ALT-9"}
        assert [row for row in counted if row[0] != "ALT-9"] == []
    assert refused.pop("rate") > 100
    assert refused.pop("crc") >= 2
    assert refused == {"unit": 1, "schema": 5}
    assert counters.get("acknowledgements_refused", 0) == 0, "the broker refused the forged one"
    stored = [row for row in stored_rows(connection) if row[0] == "ALT-9"]
    assert set(stored) - evil.rows() == {("ALT-9", 2**34, 1, 1, 0, "", "", ())}, "its own clock, its own row"
    assert len(stored) == 91
    (row,) = [row for row in json.loads(table.out) if row["unit"] == "ALT-1"]
    assert (row["backlog"], row["dropped"], row["refused"], row["worst"]) == (0, 0, 0, 0)
    assert {each for each in stored_rows(connection) if each[0] == "ALT-1"} == good.rows()
    good.close()
    evil.close()


def run_ingest(config: Path) -> Child:
    return child(module_command("altd.cli", "ingest", "--config", config), config.with_suffix(".log"))


def test_an_ingest_of_another_database_is_refused_and_the_first_one_goes_on(
    cluster: Cluster, tmp_path: Path
) -> None:
    """Each would take a part of each unit's seconds."""
    first, second = cluster.new_database(), cluster.new_database()
    unit = FleetUnit("ALT-1", tmp_path)
    unit.write(90)
    (batch,) = asyncio.run(batches_of(unit))
    folder = tmp_path / "test"
    folder.mkdir()
    with mosquitto(tmp_path, *BROKER) as (port, _):
        with ingesting(fleet_toml(tmp_path, port, first)) as process, ingesting(tmp_path / "fleet.toml"):
            with run_ingest(fleet_toml(folder, port, second)) as refused:
                assert refused.process.wait(30) == 2
                assert "broker.group: an ingest of this group writes to another" in refused.described()
            publish(port, "ALT-1", batch)
            asyncio.run(until(lambda: len(stored_rows(first)) == 90))
            assert process.poll() is None
        subprocess.run([*client(port, "altd/ingest/altd"), "-r", "-n"], check=True)
        with ingesting(folder / "fleet.toml"):
            publish(port, "ALT-1", batch)
            asyncio.run(until(lambda: len(stored_rows(second)) == 90))
    unit.close()


def test_an_ingest_that_may_not_read_the_claim_says_so_and_takes_messages(
    cluster: Cluster, tmp_path: Path
) -> None:
    settings = guarded_broker(tmp_path, "ingest")
    rights = tmp_path / "acl"
    rights.write_text(rights.read_text().replace("topic readwrite altd/ingest/+\n", ""))
    with mosquitto(tmp_path, *settings) as (port, _):
        config = fleet_toml(tmp_path, port, cluster.new_database(), f'credentials = "{tmp_path / "ingest"}"')
        with run_ingest(config) as ingest:
            ingest.await_text("the broker does not let it read altd/ingest/altd")
            ingest.await_text("connected to")


async def test_seconds_that_a_unit_dropped_or_another_database_has_are_not_waited_for(
    cluster: Cluster, tmp_path: Path
) -> None:
    connection = cluster.new_database()
    unit = FleetUnit("ALT-1", tmp_path)
    unit.write(90)
    (batch,) = await batches_of(unit)
    document = {**json.loads(batch), "oldest": 11, "first": 21, "dropped": 7}
    del document["crc32"]
    document["rows"] = [row for row in document["rows"] if row[0] > 25]
    with mosquitto(tmp_path, *BROKER) as (port, _), ingesting(fleet_toml(tmp_path, port, connection)):
        async with subscribed(port, topic="altd/ALT-1/ack") as acks:
            for first, sequence in ((21, 10), (11, 90)):
                publish(port, "ALT-1", sealed(json.dumps({**document, "first": first})).encode())
                assert json.loads((await acks.next())[3])["sequence"] == sequence
    with psycopg.connect(connection) as opened:
        assert opened.execute("SELECT dropped FROM altd.fleet").fetchone() == (7,)
    unit.close()


async def test_roll_ups_are_what_the_history_itself_makes_of_its_seconds(
    cluster: Cluster, tmp_path: Path
) -> None:
    """Late seconds of an hour change its sums, and a wrong clock's rows move when their day has come."""
    connection = cluster.new_database()
    unit = FleetUnit("ALT-1", tmp_path)
    unit.write(1500)
    batches = await batches_of(unit)
    with mosquitto(tmp_path, *BROKER) as (port, _), ingesting(fleet_toml(tmp_path, port, connection)):
        async with subscribed(port, topic="altd/ALT-1/ack") as acks:
            with psycopg.connect(connection, autocommit=True) as opened:
                for some in (batches[1:], batches[:1]):
                    for payload in some:
                        publish(port, "ALT-1", payload)
                        await acks.next()
                    while opened.execute("SELECT altd.roll_up(0, '0 s')").fetchone() != (None,):
                        pass
                found = opened.execute(
                    "SELECT extract(epoch FROM time)::bigint, n, quantities FROM altd.hours"
                )
                hours = found.fetchall()
                (minutes,) = opened.execute("SELECT sum(n) FROM altd.minutes").fetchone() or (0,)
    rows = sorted(unit.rows(), key=lambda row: str(row[1]))
    assert minutes == len(rows) == 1500
    for start_s, of_hour in itertools.groupby(rows, lambda row: int(str(row[1])) // 3600 * 3600):
        values = [dict(row[7])["x_mm"] for row in of_hour]  # type: ignore[call-overload]
        (of_database,) = [quantities["x_mm"] for time_s, _, quantities in hours if time_s == start_s]
        mean, sigma, low, high = of_database
        assert mean == pytest.approx(sum(value[0] for value in values) / len(values), abs=1e-6)
        assert sigma == pytest.approx(0.004, abs=1e-6)
        assert (low, high) == (min(value[2] for value in values), max(value[3] for value in values))
    unit.close()


async def test_a_daemon_keeps_its_seconds_until_the_ingest_has_them(
    cluster: Cluster, played_unit: PlayedUnit, tmp_path: Path
) -> None:
    connection, path = cluster.new_database(), tmp_path / "history.db"
    with mosquitto(tmp_path, *BROKER) as (port, _):
        more = f'[history]\nfile = "{path}"\n[mqtt]\nhost = "127.0.0.1"\nport = {port}\n'
        more += "store_and_forward = true\n"
        with playing(played_unit, tmp_path, subprocess.DEVNULL, more=more) as daemon:
            await asyncio.to_thread(daemon.wait_until_valid)
            await asyncio.sleep(2.0)  # seconds that no ingest takes
            with ingesting(fleet_toml(tmp_path, port, connection)):
                await until(lambda: len(stored_rows(connection)) >= 5)
                daemon.process.send_signal(signal.SIGTERM)
                assert daemon.process.wait(20) == 0
    with psycopg.connect(connection) as opened:
        found = opened.execute(
            "SELECT time, received FROM altd.seconds ORDER BY sequence DESC LIMIT 1"
        ).fetchone()
    assert found is not None
    assert 1.0 < (found[1] - found[0]).total_seconds() < 15.0
    assert abs((datetime.now(UTC) - found[1]).total_seconds()) < 60.0
