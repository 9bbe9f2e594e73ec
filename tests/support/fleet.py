"""Debian's PostgreSQL, `altd ingest` as a process, and units with real histories."""

import asyncio
import contextlib
import subprocess
import time
from collections.abc import AsyncIterator, Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import psycopg

from altd.history.history import History
from altd.history.outbox import Outbox
from altd.history.reader import Reader
from altd.history.schema import SECONDS
from altd.history.store import Store
from benchmarks.fleet import ingesting
from benchmarks.postgresql import Cluster, programs
from benchmarks.postgresql import postgresql as server
from support.foreign import need, need_program
from support.history import ABOUT, MAX_BYTES, START_S, batch, renamed, sample, state
from support.mqtt import PublishingUnit

__all__ = [
    "LIMITS",
    "Cluster",
    "FleetUnit",
    "Row",
    "fleet_toml",
    "guarded_broker",
    "ingesting",
    "postgresql",
    "stored_rows",
    "until",
]

LIMITS = "max_inflight_messages 1000", "max_queued_messages 10000"
Row = tuple[str, int, *tuple[object, ...]]
"""Serial, time in s, the columns of the second, and its values by quantity."""


@contextlib.contextmanager
def postgresql() -> Iterator[Cluster]:
    """A cluster that runs; a skip where Debian's package is not installed."""
    need(programs() is not None, "PostgreSQL is not installed (Debian package postgresql)")
    with server("fsync=off") as cluster:
        yield cluster


def fleet_toml(folder: Path, port: int, connection: str, more: str = "") -> Path:
    path = folder / "fleet.toml"
    text = f'[broker]\nhost = "127.0.0.1"\nport = {port}\n{more}\n[database]\nconnection = "{connection}"\n'
    path.write_text(text)
    return path


def guarded_broker(folder: Path, *users: str) -> tuple[str, ...]:
    """The worked example of docs/fleet.md: each unit has its own user, and its own topics."""
    passwords, rights = folder / "passwords", folder / "acl"
    passwords.touch(0o600)
    for user in users:
        words = [need_program("mosquitto_passwd", "mosquitto"), "-b", passwords, user, "secret"]
        subprocess.run(words, check=True)
        login = folder / user
        login.touch(0o600)
        login.write_text(f"{user}\nsecret\n")
    rights.write_text(
        "user ingest\ntopic read altd/+/outbox\ntopic write altd/+/ack\ntopic readwrite altd/ingest/+\n"
        "pattern write altd/%u/#\npattern read altd/%u/ack\n"
    )
    return "allow_anonymous false", f"password_file {passwords}", f"acl_file {rights}", *LIMITS


@dataclass
class FleetUnit:
    """A unit whose history is written by the second, and sent by the real publisher."""

    serial: str
    folder: Path
    store: Store = field(init=False)
    history: History = field(init=False)
    outbox: Outbox = field(init=False)
    written_s: int = START_S

    def __post_init__(self) -> None:
        self.folder.mkdir(exist_ok=True)
        self.history = History(self.path, serial=self.serial)
        self.open(Outbox(self.history))

    @property
    def path(self) -> Path:
        return self.folder / "history.db"

    def open(self, outbox: Outbox) -> None:
        """As a daemon that starts, and begins a new stream."""
        self.store = Store(self.path, MAX_BYTES, renamed(ABOUT, serial=self.serial), has_outbox=True)
        self.outbox = outbox

    def write(self, seconds: int = 0, x_mm: float = 10.0) -> None:
        """Write seconds of one measurement, and delete what was acknowledged."""
        items: list[Any] = []
        for _ in range(seconds):
            self.written_s += 1
            items += [state(self.written_s), sample(self.written_s, x_mm + self.written_s % 100 * 1e-3)]
        made = batch(self.written_s + 5, items)
        self.outbox.mark = self.store.write(
            type(made)(made.monotonic_ns, made.wall_us, made.items, (), self.outbox.acknowledged)
        ).outbox

    def waiting(self) -> int:
        return self.outbox.mark.waiting

    def close(self) -> None:
        self.store.end(None)

    @contextlib.asynccontextmanager
    async def running(self, port: int, **settings: object) -> AsyncIterator[PublishingUnit]:
        """Published under supervision, while acknowledgements reach the history."""
        unit = PublishingUnit.made(port, serial=self.serial, outbox=self.outbox, **settings)
        trimming = asyncio.create_task(self._trim())
        try:
            async with unit.running():
                yield unit
        finally:
            trimming.cancel()
            await asyncio.gather(trimming, return_exceptions=True)
            await self.history.end()

    async def _trim(self) -> None:
        while True:
            self.write()
            await asyncio.sleep(0.05)

    def rows(self) -> set[Row]:
        """All seconds of the history, as ``stored_rows`` has those of the database."""
        rows: set[Row] = set()
        with Reader(self.path) as reader:
            for point in reader.summaries(SECONDS, 0, 2**52):
                values = sorted((key, (v.mean, v.sigma, v.low, v.high)) for key, v in point.values.items())
                counts = point.n, point.n_valid, point.worst, point.worst_code, point.lost_to
                rows.add((self.serial, point.t_us // 10**6, *counts, tuple(values)))
        return rows


def stored_rows(connection: str) -> list[Row]:
    """All seconds of the database, in the order of their sequences."""
    with psycopg.connect(connection) as opened:
        found = opened.execute(
            "SELECT serial, extract(epoch FROM time)::bigint, n, n_valid, s.worst, s.cause, lost_to, "
            "quantities FROM altd.seconds AS s JOIN altd.units ON units.id = unit ORDER BY serial, sequence"
        ).fetchall()
    return [(*row[:7], tuple(sorted((key, tuple(value)) for key, value in row[7].items()))) for row in found]


async def until(condition: Callable[[], bool], within_s: float = 60.0) -> None:
    deadline_s = time.monotonic() + within_s
    while not condition():
        assert time.monotonic() < deadline_s
        await asyncio.sleep(0.05)
