"""``python -m benchmarks.outages`` (``make bench-outages``): network cut, killed servers, repeated messages.

The twenty units of ``make demo-fleet`` run behind a virtual Ethernet link, with real histories, outboxes and
MQTT publishers. Broker, two ingests and PostgreSQL are at its other end. Half of the kills take place first.
Then the link is down. The other half takes place while the units catch up. A foreign client publishes a fifth
of all batches a second time. In the end each second of the units' histories must be in the database once,
with equal values and in order.

It must run as root in a network namespace: ``unshare -n``. PostgreSQL runs as another user.
"""

import argparse
import asyncio
import contextlib
import random
import signal
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import psycopg
from paho.mqtt.client import Client, MQTTMessage
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion

from altd.history.reader import Reader
from altd.history.schema import SECONDS
from benchmarks.demo_fleet import UNITS, DemoUnit
from benchmarks.fleet import ingesting, write_settings
from benchmarks.harness import Child, Parser, child, end, module_command
from benchmarks.live.parts import NEAR, behind_link, ip, set_link
from benchmarks.postgresql import Cluster, postgresql

Row = tuple[str, int, *tuple[object, ...]]
"""Serial, time in s, the columns of the second, and its values by quantity."""

MODULE = "benchmarks.outages"
_SEED = 27
_REPEATED_SHARE = 0.2
_PAUSE_S = 2.0
_CATCH_UP_S = 300.0
_WRITTEN_AFTER_S = 5.0
"""A second is in a history this long after its end."""


def history_rows(serial: str, path: Path) -> set[Row]:
    """All seconds of a unit's history."""
    rows: set[Row] = set()
    with Reader(path) as reader:
        for point in reader.summaries(SECONDS, 0, 2**52):
            values = tuple(sorted((key, (v.mean, v.sigma, v.low, v.high)) for key, v in point.values.items()))
            counts = point.n, point.n_valid, point.worst, point.worst_code, point.lost_to
            rows.add((serial, point.t_us // 10**6, *counts, values))
    return rows


def stored_rows(connection: str) -> list[Row]:
    """All seconds of the database, in the order of their sequences."""
    with psycopg.connect(connection) as opened:
        found = opened.execute(
            "SELECT serial, extract(epoch FROM time)::bigint, n, n_valid, s.worst, s.cause, lost_to, "
            "quantities FROM altd.seconds AS s JOIN altd.units ON units.id = unit ORDER BY serial, sequence"
        ).fetchall()
    return [(*row[:7], tuple(sorted((key, tuple(value)) for key, value in row[7].items()))) for row in found]


class Servers:
    """Broker, two ingests and database; each can be killed and is started again."""

    def __init__(self, folder: Path, cluster: Cluster, life: contextlib.ExitStack) -> None:
        self._cluster, self._life = cluster, life
        self.connection = cluster.new_database()
        self.port, self._command, self._config = write_settings(folder, self.connection, "0.0.0.0")  # noqa: S104  in its own namespace
        self._broker = self._started_broker()
        life.enter_context(ingesting(self._config))
        self._ingest = life.enter_context(ingesting(self._config))

    def kill(self, name: str) -> None:
        """Kill ``broker`` or ``ingest`` with SIGKILL, ``database`` as in a crash; start it again."""
        if name == "broker":
            self._broker.kill()
            self._broker = self._started_broker()
        elif name == "ingest":
            self._ingest.kill()
            self._ingest.wait()
            self._ingest = self._life.enter_context(ingesting(self._config))
        else:
            self._cluster.stop(signal.SIGQUIT)
            self._cluster.start()

    def _started_broker(self) -> Child:
        return self._life.enter_context(child(self._command))


class Repeater:
    """A foreign client that publishes some of the batches a second time."""

    def __init__(self, port: int) -> None:
        self.seen = self.repeated = 0
        self._random = random.Random(_SEED)
        self._client = Client(CallbackAPIVersion.VERSION2, protocol=MQTTProtocolVersion.MQTTv5)
        self._client.on_connect = lambda client, *_: client.subscribe("altd/+/outbox", qos=1)
        self._client.on_message = self._take
        self._client.reconnect_delay_set(1, 1)
        self._client.connect_async("127.0.0.1", port)
        self._client.loop_start()

    def end(self) -> None:
        """Disconnect from the broker."""
        self._client.loop_stop()

    def _take(self, client: Client, userdata: object, message: MQTTMessage) -> None:
        self.seen += 1
        if self._random.random() < _REPEATED_SHARE:
            self.repeated += 1
            client.publish(message.topic, message.payload, qos=1)


async def run_units(folder: Path, port: int) -> None:
    """Measure and publish until killed."""
    await asyncio.gather(*(DemoUnit(number, folder, port, NEAR).run() for number in range(1, UNITS + 1)))


def compared(folder: Path, connection: str) -> bool:
    """Wait until the database has all seconds up to now; print the result; return whether it is right."""
    end_s = time.time() - _WRITTEN_AFTER_S
    deadline_s = time.monotonic() + _CATCH_UP_S
    histories = (history_rows(path.stem, path) for path in folder.glob("*.db"))
    expected = {row for history in histories for row in history if row[1] < end_s}
    while True:
        stored = [row for row in stored_rows(connection) if row[1] < end_s]
        missing, different = len(expected - set(stored)), len(set(stored) - expected)
        if not missing or time.monotonic() > deadline_s:
            break
        time.sleep(1.0)
    places = [row[:2] for row in stored]
    twice, is_ordered = len(places) - len(set(places)), places == sorted(places)
    order = "kept" if is_ordered else "lost"
    print(f"rows of the units {len(expected)}, in the database {len(stored)}")
    print(f"missing {missing}, different {different}, twice {twice}, order {order}")
    return bool(expected) and is_ordered and not (missing or different or twice)


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and print; return 1 if a row was lost, changed, stored twice or out of order."""
    parser = Parser(MODULE, __doc__)
    parser.number("--cut", 1800.0, "of the link")
    parser.count("--kills", 10, "of broker and of ingest", least=0)
    parser.count("--crashes", 3, "of the database", least=0)
    parser.add_argument("--units-in", type=Path, metavar="FOLDER", help=argparse.SUPPRESS)
    parser.add_argument("--port", type=int, help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    if options.units_in:
        asyncio.run(run_units(options.units_in, options.port))
        return 0
    plan = ["broker", "ingest"] * options.kills + ["database"] * options.crashes
    random.Random(_SEED).shuffle(plan)
    ip("link", "set", "lo", "up")
    with contextlib.ExitStack() as life:
        folder = Path(life.enter_context(tempfile.TemporaryDirectory(prefix="altd-outages-")))
        (folder / "units").mkdir()
        cluster = life.enter_context(postgresql("fsync=on"))
        servers = Servers(folder, cluster, life)
        repeater = Repeater(servers.port)
        life.callback(repeater.end)
        far_units = module_command(MODULE, "--units-in", folder / "units", "--port", servers.port)
        life.enter_context(behind_link(far_units, folder / "units.log"))
        half = len(plan) // 2
        _kill(servers, plan[:half])
        set_link("down")
        time.sleep(options.cut)
        set_link("up")
        _kill(servers, plan[half:])
        killed = ", ".join(f"{name} {count}" for name, count in Counter(plan).items())
        print(f"link down for {options.cut:g} s; killed: {killed}")
        print(f"batches {repeater.seen}, published a second time {repeater.repeated}")
        return 0 if compared(folder / "units", servers.connection) else 1


def _kill(servers: Servers, names: Sequence[str]) -> None:
    for name in names:
        time.sleep(_PAUSE_S)
        servers.kill(name)


if __name__ == "__main__":
    end(main, MODULE)
