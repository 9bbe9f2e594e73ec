"""``python -m benchmarks.fleet``: many units, one broker, one ingest, one PostgreSQL on this machine.

Simulated units send their seconds as the real ones do: in batches, and no more than a window ahead of the
acknowledgements of the ingest. Three measurements:

- live: each unit sends ``--hz`` rows once a second. The age of a row when its acknowledgement has come back
  is an upper limit of the time from capture to commit.
- backlog: as many seconds as one unit makes in a week, from ``--backlog-units`` units at once.
- plain COPY of the same rows into a table like that of the ingest, in one transaction: the limit of the
  database.

``--hostile`` adds a unit that sends as many batches a second during the live part. Their CRC is right. By
turns, one has an integer of 2^40, and the database refuses one for a constraint that this program adds.

In the end the database must have each row that was sent once. Mosquitto, PostgreSQL and the units share the
machine with the ingest.
"""

import contextlib
import json
import os
import subprocess
import tempfile
import threading
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import psycopg
from paho.mqtt.client import Client, MQTTMessage
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion

from altd.publish.mqtt.outbox import MAX_UNACKNOWLEDGED_S
from altd.status.outbox import MAX_NUMBERS, Second
from altd.status.proof import sealed
from benchmarks.harness import KEYS, Parser, child, cpu_s, end, meanwhile, module_command, until
from benchmarks.postgresql import postgresql
from hw_sim.ports import free_port

ROWS_PER_BATCH = MAX_NUMBERS // (len(Second._fields) + 4 * len(KEYS))
WEEK_S = 7 * 86_400
_TIMEOUT_S = 120.0


@dataclass
class Unit:
    """A unit without a file: the row of any sequence number can be generated again."""

    serial: str
    start_s: int
    number: int
    newest: int = 0
    sent: int = 0
    acknowledged: int = 0
    change: dict[str, Any] = field(default_factory=dict)
    """Fields of its rows that differ."""
    made_s: dict[int, float] = field(default_factory=dict)
    """Creation times of rows that are not yet acknowledged, by sequence number."""

    def row(self, sequence: int) -> Second:
        """Row of a sequence number, with numbers of seven digits as in a real unit."""
        chance = (self.number * 7919 + sequence * 104_729) % 100_003
        values: list[tuple[float, float | None, float, float] | None] = [
            (round(mean + chance * 1e-4, 4), 0.004, round(mean, 4), round(mean + 11.0, 4))
            for mean in (10.0, -5.0, 1.0, -2.0)
        ]
        row = Second(sequence, 1, self.start_s + sequence, 20, 20, 0, "", "", values)
        return row._replace(**self.change)

    def next_batch(self) -> str | None:
        """Next message; None if there is nothing to send or too much is unacknowledged."""
        if self.sent >= self.newest or self.sent - self.acknowledged >= MAX_UNACKNOWLEDGED_S:
            return None
        last = min(self.sent + ROWS_PER_BATCH, self.newest)
        document = {
            "schema": 1,
            "serial": self.serial,
            "file": f"{self.number:016x}",
            "stream": "0" * 16,
            "oldest": self.acknowledged + 1,
            "first": self.sent + 1,
            "last": last,
            "newest": self.newest,
            "dropped": 0,
            "quantities": KEYS,
            "rows": [self.row(sequence) for sequence in range(self.sent + 1, last + 1)],
            "unit": "00000000", "session": "00000000", "message": last, "published": last * 20,
            "clock_ms": last * 1000, "age_s": 0.5,
        }  # fmt: skip
        self.sent = last
        return sealed(json.dumps(document))


class Units:
    """All units, on one connection to the broker."""

    def __init__(self, port: int, prefix: str, count: int, start_s: int) -> None:
        self.by_serial = {
            f"{prefix}-{number}": Unit(f"{prefix}-{number}", start_s, number) for number in range(count)
        }
        self.ages_s: list[float] = []
        self.woken = threading.Event()
        self._client = Client(CallbackAPIVersion.VERSION2, protocol=MQTTProtocolVersion.MQTTv5)
        self._client.max_inflight_messages_set(1000)
        self._client.on_message = self._take
        self._client.connect("127.0.0.1", port)
        self._client.subscribe("altd/+/ack", qos=1)
        self._client.loop_start()

    def end(self) -> None:
        """Disconnect from the broker."""
        self._client.disconnect()
        self._client.loop_stop()

    def send(self, unit: Unit) -> bool:
        """Send the next batch of a unit, if any; return whether one was sent."""
        if (payload := unit.next_batch()) is None:
            return False
        self._client.publish(f"altd/{unit.serial}/outbox", payload, qos=1)
        return True

    def wait(self) -> None:
        """Wait until every row is acknowledged."""
        units = self.by_serial.values()
        until(lambda: all(unit.acknowledged >= unit.newest for unit in units), _TIMEOUT_S, "acknowledgements")

    def _take(self, client: Client, userdata: object, message: MQTTMessage) -> None:
        now_s = time.monotonic()
        document = json.loads(message.payload)
        unit = self.by_serial.get(document["serial"])
        if unit is None:
            return
        for sequence in range(unit.acknowledged + 1, document["sequence"] + 1):
            if (made_s := unit.made_s.pop(sequence, None)) is not None:
                self.ages_s.append(now_s - made_s)
        unit.acknowledged = max(unit.acknowledged, document["sequence"])
        self.woken.set()


def live(port: int, count: int, hz: int, seconds: int, start_s: int) -> Units:
    """Let each unit send once a second, spread over the second."""
    units = Units(port, "LIVE", count, start_s)
    began_s = time.monotonic()
    for tick in range(count * seconds):
        due_s = began_s + tick / count
        if (wait_s := due_s - time.monotonic()) > 0:
            time.sleep(wait_s)
        unit = units.by_serial[f"LIVE-{tick % count}"]
        for _ in range(hz):
            unit.newest += 1
            unit.made_s[unit.newest] = due_s  # delays of the sender count as delays of the ingest
        units.send(unit)
    units.wait()
    units.end()
    return units


@contextlib.contextmanager
def hostile(port: int, connection: str, hz: int) -> Iterator[None]:
    """Let a unit send ``hz`` batches a second that cannot be written."""
    with psycopg.connect(connection) as opened:
        opened.execute("ALTER TABLE altd.seconds ADD CHECK (cause <> 'hostile')")
    client = Client(CallbackAPIVersion.VERSION2, protocol=MQTTProtocolVersion.MQTTv5)
    client.connect("127.0.0.1", port)
    client.loop_start()

    def send(ended: threading.Event) -> None:
        unit, number = Unit("HOSTILE", int(time.time()), 1, newest=10**9), 0
        while not ended.wait(1 / hz):
            number += 1
            unit.change = {"boot": 2**40} if number % 2 else {"cause": "hostile"}
            unit.acknowledged = unit.sent
            client.publish(f"altd/{unit.serial}/outbox", unit.next_batch(), qos=1)

    try:
        with meanwhile(send):
            yield
    finally:
        client.disconnect()
        client.loop_stop()


def backlog(port: int, count: int, rows: int, start_s: int) -> tuple[Units, float]:
    """Send all pending rows of all units; return the units and the time until all are acknowledged, s."""
    units = Units(port, "BACKLOG", count, start_s)
    for unit in units.by_serial.values():
        unit.newest = rows // count
    began_s = time.monotonic()
    while any(unit.sent < unit.newest for unit in units.by_serial.values()):
        units.woken.clear()
        sent = sum(units.send(unit) for unit in units.by_serial.values())
        if not sent:
            units.woken.wait(1.0)
    units.wait()
    units.end()
    return units, time.monotonic() - began_s


def plain_copy_s(connection: str) -> tuple[float, int]:
    """Time of one COPY of all rows, as text, into a table like the ingest's; and the number of rows."""
    with psycopg.connect(connection, autocommit=True) as opened:
        with opened.cursor().copy("COPY (SELECT * FROM altd.seconds ORDER BY received) TO STDOUT") as copy:
            pieces = [bytes(piece) for piece in copy]
        opened.execute("CREATE TABLE plain (LIKE altd.seconds INCLUDING ALL)")
        began_s = time.monotonic()
        with opened.transaction(), opened.cursor().copy("COPY plain FROM STDIN") as copy:
            for place in range(0, len(pieces), 1000):
                copy.write(b"".join(pieces[place : place + 1000]))
        took_s = time.monotonic() - began_s
        row = opened.execute("SELECT count(*) FROM plain").fetchone()
        opened.execute("DROP TABLE plain")
        return took_s, 0 if row is None else int(row[0])


def faults(connection: str, units: Units) -> tuple[int, int]:
    """Number of rows that were sent and are missing or wrong, and number of duplicate rows."""
    lost = twice = 0
    with psycopg.connect(connection) as opened:
        for unit in units.by_serial.values():
            found = opened.execute(
                "SELECT sequence, extract(epoch FROM time)::bigint, quantities->'x_mm'->>0 "
                "FROM altd.seconds JOIN altd.units ON units.id = unit WHERE serial = %s ORDER BY time",
                (unit.serial,),
            ).fetchall()
            rows = (unit.row(sequence) for sequence in range(1, unit.newest + 1))
            expected = [(row.sequence, row.t_s, str(row.values[0][0])) for row in rows if row.values[0]]
            lost += len(set(expected) - set(found))
            twice += len(found) - len(set(found))
    return lost, twice


def write_settings(folder: Path, connection: str) -> tuple[int, list[str], Path]:
    """Write settings of a broker and of an ingest; return its port and command, and theirs."""
    port, broker, ingest = free_port(), folder / "mosquitto.conf", folder / "fleet.toml"
    lines = (f"listener {port} 127.0.0.1", "allow_anonymous true", "max_inflight_messages 1000",
             "max_queued_messages 100000", "user root")  # fmt: skip
    broker.write_text("\n".join(lines) + "\n")
    ingest.write_text(
        f'[broker]\nhost = "127.0.0.1"\nport = {port}\n[database]\nconnection = "{connection}"\n'
    )
    return port, ["mosquitto", "-c", str(broker)], ingest


@contextlib.contextmanager
def ingesting(config: Path) -> Iterator[subprocess.Popen[bytes]]:
    """Run `altd ingest`, from its subscription on; its log is beside ``config``."""
    log = config.with_name(f"ingest-{time.monotonic_ns()}.log")
    with child(module_command("altd.cli", "ingest", "--config", config), log) as ingest:
        ingest.await_text("connected to")
        yield ingest.process


@contextlib.contextmanager
def servers(settings: list[str]) -> Iterator[tuple[int, str, dict[str, int]]]:
    """Run broker, database and ingest; yield the broker's port, the database and the processes."""
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        cluster = stack.enter_context(postgresql(*settings))
        connection = cluster.new_database()
        assert cluster.server is not None  # noqa: S101
        port, command, config = write_settings(folder, connection)
        broker = stack.enter_context(child(command))
        ingest = stack.enter_context(ingesting(config))
        pids = {"database": cluster.server.process.pid, "broker": broker.process.pid, "ingest": ingest.pid}
        yield port, connection, pids | {"units": os.getpid()}


def _cpu_s(pids: Mapping[str, int]) -> dict[str, float]:
    """CPU time of each process; for the database, with its children."""
    database = pids["database"]
    children = map(int, Path(f"/proc/{database}/task/{database}/children").read_text().split())
    used_s = {name: cpu_s(pid) for name, pid in pids.items()}
    return used_s | {"database": used_s["database"] + sum(map(cpu_s, children))}


def main() -> int:
    """Measure and print; return 1 if a row was lost or is duplicate."""
    parser = Parser("benchmarks.fleet", "Many units and one ingest.")
    parser.count("--units", 1000, "units that are live")
    parser.count("--hz", 1, "rows of each a second")
    parser.count("--seconds", 600, "time of the live part")
    parser.count("--backlog", WEEK_S, "its seconds, or 0", least=0)
    parser.count("--backlog-units", 60, "units that have it")
    parser.count("--hostile", 0, "batches a second of a hostile unit", least=0)
    options = parser.parse_args()
    start_s = int(time.time()) - WEEK_S
    with servers(["shared_buffers=512MB", "max_wal_size=4GB"]) as (port, connection, pids):
        before_s = _cpu_s(pids)
        with hostile(port, connection, options.hostile) if options.hostile else contextlib.nullcontext():
            units = live(port, options.units, options.hz, options.seconds, start_s)
        _, p99_s, _ = ages_at_s = np.percentile(units.ages_s, [50, 99, 100])
        worked_s = {name: used_s - before_s[name] for name, used_s in _cpu_s(pids).items()}
        lost, twice = faults(connection, units)
        live_copy_s, live_rows = plain_copy_s(connection)
        rate = options.units * options.hz
        print(f"live: {options.units} units, {rate} rows a second, {options.seconds} s")
        names = ("p50", "p99", "worst")
        shown = [f"{name} {age_s * 1e3:.0f} ms" for name, age_s in zip(names, ages_at_s, strict=True)]
        print(f"  made to acknowledged: {', '.join(shown)}")
        of_core = [f"{name} {100 * each_s / options.seconds:.0f} %" for name, each_s in worked_s.items()]
        print(f"  CPU, of a core: {', '.join(of_core)}")
        print(f"  rows {live_rows}, lost {lost}, twice {twice}")
        print(f"  plain COPY of a second's rows: {live_copy_s / options.seconds * 1e3:.1f} ms")
        print(f"  p99 / plain COPY of a second's rows: {p99_s / (live_copy_s / options.seconds):.1f}")
        if not options.backlog:
            return 1 if lost or twice else 0
        behind, took_s = backlog(port, options.backlog_units, options.backlog, start_s)
        more = faults(connection, behind)
        copy_s, rows = plain_copy_s(connection)
        sent = sum(unit.newest for unit in behind.by_serial.values())
        print(f"backlog: {sent} rows of {options.backlog_units} units")
        print(f"  {took_s:.1f} s, {sent / took_s:.0f} rows a second; lost {more[0]}, twice {more[1]}")
        print(f"  plain COPY: {rows / copy_s:.0f} rows a second")
        print(f"  time / plain COPY: {(took_s / sent) / (copy_s / rows):.1f}")
    return 1 if any((lost, twice, *more)) else 0


if __name__ == "__main__":
    end(main, "benchmarks.fleet")
