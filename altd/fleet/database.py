"""PostgreSQL: migrations, and the single transaction that writes batches into the tables."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import LiteralString

import psycopg

from altd.errors import BadInputError, one_line
from altd.fleet.settings import FleetSettings
from altd.status.outbox import Batch, Second

MIGRATIONS = sorted((Path(__file__).parent / "migrations").glob("*.sql"))
VERSION = len(MIGRATIONS)
CONNECT_TIMEOUT_S = 10
STATEMENT_TIMEOUT_S = 60
LINK_TIMEOUT_S = 20
"""Time after which a server whose host or cable is gone is given up; by default minutes or two hours."""
_LOCK = 0x616C7464
"""Key of the advisory lock of migrations (``altd``); plus 1, that of maintenance."""

_MAX_PARTS = 100
"""Maximum number of received ranges of a stream; with more, only the first is kept, the rest is resent."""


_UNIT: LiteralString = (
    "INSERT INTO altd.units (serial) VALUES (%s) "
    "ON CONFLICT (serial) DO UPDATE SET serial = excluded.serial RETURNING id"
)
_FILE: LiteralString = (
    "INSERT INTO altd.files (unit, file) VALUES (%s, %s) "
    "ON CONFLICT (unit, file) DO UPDATE SET file = excluded.file RETURNING id"
)


@dataclass(frozen=True, slots=True)
class Progress:
    """Progress of a unit's stream after a commit: all sequences up to this one are in the database."""

    serial: str
    stream: str
    sequence: int


def connect(settings: FleetSettings) -> psycopg.Connection:
    """Connect, in UTC and with commits to disk; raises psycopg.OperationalError and BadInputError."""
    options = (
        "-c timezone=UTC -c client_encoding=UTF8 -c synchronous_commit=on "
        f"-c statement_timeout={STATEMENT_TIMEOUT_S}s"
    )
    text = settings.database.connection
    try:
        return psycopg.connect(
            text,
            autocommit=True,
            connect_timeout=CONNECT_TIMEOUT_S,
            options=options,
            application_name="altd",
            keepalives_idle=LINK_TIMEOUT_S // 2,
            keepalives_interval=LINK_TIMEOUT_S // 4,
            keepalives_count=2,
            tcp_user_timeout=LINK_TIMEOUT_S * 1000,
        )
    except psycopg.ProgrammingError as error:
        raise BadInputError("database.connection", one_line(str(error).strip())) from error


def version_of(connection: psycopg.Connection) -> int:
    """Version of the tables; 0: there are none."""
    found = connection.execute("SELECT to_regclass('altd.version')").fetchone()
    if found is None or found[0] is None:
        return 0
    row = connection.execute("SELECT max(version) FROM altd.version").fetchone()
    return 0 if row is None or row[0] is None else int(row[0])


def migrate(connection: psycopg.Connection) -> None:
    """Migrate the tables to this version, one instance at a time; raises BadInputError for newer ones."""
    with connection.transaction():
        connection.execute("SELECT pg_advisory_xact_lock(%s)", (_LOCK,))
        version = version_of(connection)
        if version > VERSION:
            text = f"the tables are of version {version}, and this program knows {VERSION}"
            raise BadInputError("database.connection", text)
        if version == 0:
            connection.execute("CREATE SCHEMA IF NOT EXISTS altd")
            connection.execute("CREATE TABLE altd.version (version integer PRIMARY KEY)")
        for number, path in enumerate(MIGRATIONS[version:], version + 1):
            connection.execute(path.read_bytes())
            connection.execute("INSERT INTO altd.version VALUES (%s)", (number,))


def identity_of(connection: psycopg.Connection) -> str:
    """Return the identity of the database."""
    row = connection.execute("SELECT id FROM altd.identity").fetchone()
    return "" if row is None else str(row[0])


class Writer:
    """Writes batches through one connection."""

    def __init__(self, connection: psycopg.Connection, settings: FleetSettings) -> None:
        self._connection = connection
        self._keep = timedelta(days=settings.retention.seconds_days)
        self._ids: dict[tuple[str, str], tuple[int, int]] = {}
        self._days: set[datetime] = set()
        connection.execute(
            "CREATE TEMP TABLE staged (LIKE altd.seconds INCLUDING DEFAULTS) ON COMMIT DELETE ROWS"
        )

    def write(self, batches: Sequence[Batch], refused: Mapping[tuple[str, str], int]) -> list[Progress]:
        """Commit batches, and the numbers of refused messages by unit and reason.

        Existing rows stay as they are. Raises psycopg.Error; then nothing is written.
        """
        self._make_days(row.t_s for batch in batches for row in batch.rows)
        known = self._ids.copy()
        with self._connection.transaction():
            progress = self._write(batches, known) if batches else []
            if refused:
                self._count(refused)
        self._ids = known
        return progress

    def _make_days(self, seconds: Iterable[int]) -> None:
        """Create partitions, except for days of wrong clocks."""
        now = datetime.now(UTC)
        for number in {t_s // 86_400 for t_s in seconds}:
            day = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(days=number)
            if day not in self._days and now - self._keep < day < now + timedelta(days=1):
                self._connection.execute("SELECT altd.make_day(%s)", (day,))
                self._days.add(day)

    def _write(self, batches: Sequence[Batch], ids: dict[tuple[str, str], tuple[int, int]]) -> list[Progress]:
        execute = self._connection.execute
        serials = self._lock_units(batches, ids)
        with self._connection.cursor().copy(
            "COPY staged (unit, time, file, sequence, boot, n, n_valid, worst, cause, lost_to, quantities) "
            "FROM STDIN"
        ) as copy:
            for batch in batches:
                copy.write(copied_lines(batch, *ids[batch.serial, batch.file]))
        execute(
            "WITH new AS (INSERT INTO altd.seconds SELECT * FROM staged "
            "ORDER BY unit, time, file, sequence ON CONFLICT DO NOTHING RETURNING unit, time) "
            "INSERT INTO altd.stale (unit, hour) SELECT DISTINCT unit, date_trunc('hour', time) FROM new "
            "ON CONFLICT DO NOTHING"
        )
        newest: dict[tuple[int, str], Batch] = {}
        received: dict[tuple[int, str], list[str]] = {}
        for batch in batches:
            stream = ids[batch.serial, batch.file][0], batch.stream
            newest[stream] = max(newest.get(stream, batch), batch, key=lambda each: each.last)
            received.setdefault(stream, []).append(f"[1,{batch.oldest}),[{batch.first},{batch.last}]")
        rows = [
            (*stream, f"{{{','.join(received[stream])}}}", batch.last, batch.newest)
            for stream, batch in newest.items()
        ]
        progress = []
        latest = []
        for unit, stream, sequence, seen in execute(
            "INSERT INTO altd.streams AS old (unit, stream, received, seen, newest) SELECT * FROM "
            "unnest(%s::int[], %s::text[], %s::int8multirange[], %s::bigint[], %s::bigint[]) "
            "ON CONFLICT (unit, stream) DO UPDATE SET updated = now(), "
            "received = CASE WHEN (SELECT count(*) FROM unnest(old.received)) < %s "
            "THEN old.received ELSE int8multirange(int8range(1, altd.contiguous(old.received) + 1)) END "
            "+ excluded.received, seen = greatest(old.seen, excluded.seen), "
            "newest = greatest(old.newest, excluded.newest) "
            "RETURNING unit, stream, altd.contiguous(received), seen",
            (*map(list, zip(*rows, strict=True)), _MAX_PARTS),
        ):
            progress.append(Progress(serials[unit], stream, sequence))
            batch = newest[unit, stream]
            if batch.rows and batch.last >= seen:
                latest.append((unit, batch.rows[-1], ids[batch.serial, batch.file][1], batch.dropped))
        self._show(latest)
        return progress

    def _lock_units(
        self, batches: Sequence[Batch], ids: dict[tuple[str, str], tuple[int, int]]
    ) -> dict[int, str]:
        """Find or create the batches' units and files, and lock the units; return the serials by id."""
        while True:
            for serial, file in sorted({(batch.serial, batch.file) for batch in batches} - ids.keys()):
                unit = self._find_id(_UNIT, serial)
                ids[serial, file] = unit, self._find_id(_FILE, unit, file)
            serials = {ids[batch.serial, batch.file][0]: batch.serial for batch in batches}
            locked = self._connection.execute(  # in one order, so that instances do not deadlock
                "SELECT id FROM altd.units WHERE id = ANY(%s) ORDER BY id FOR UPDATE", (sorted(serials),)
            ).fetchall()
            if len(locked) == len(serials):
                return serials
            ids.clear()  # a unit was deleted since its id was found

    def _find_id(self, sql: LiteralString, *values: object) -> int:
        row = self._connection.execute(sql, values).fetchone()
        assert row is not None  # noqa: S101  DO UPDATE returns the existing row
        return int(row[0])

    def _show(self, latest: Sequence[tuple[int, Second, int, int]]) -> None:
        """Store the newest second of each unit, for the table of the fleet."""
        rows = [(unit, file, row.t_s, row.worst, row.cause, dropped) for unit, row, file, dropped in latest]
        if not rows:
            return
        units, files, times_s, worst, causes, dropped = map(list, zip(*rows, strict=True))
        self._connection.execute(
            "UPDATE altd.units SET last_time = to_timestamp(t_s), heard = now(), worst = new.worst, "
            "cause = new.cause FROM unnest(%s::int[], %s::bigint[], %s::int[], %s::text[]) "
            "AS new (unit, t_s, worst, cause) WHERE id = unit",
            (units, times_s, worst, causes),
        )
        self._connection.execute(
            "UPDATE altd.files SET dropped = new.dropped FROM unnest(%s::int[], %s::bigint[]) "
            "AS new (file, dropped) WHERE id = new.file AND files.dropped < new.dropped",
            (files, dropped),
        )

    def _count(self, refused: Mapping[tuple[str, str], int]) -> None:
        rows = [(unit, reason, count) for (unit, reason), count in sorted(refused.items())]
        self._connection.execute(
            "INSERT INTO altd.refused AS old (unit, reason, count) "
            "SELECT coalesce(serial, ''), reason, sum(count) "
            "FROM unnest(%s::text[], %s::text[], %s::bigint[]) AS new (unit, reason, count) "
            "LEFT JOIN altd.units ON serial = new.unit GROUP BY 1, 2 ORDER BY 1, 2 "
            "ON CONFLICT (unit, reason) DO UPDATE SET count = old.count + excluded.count, last = now()",
            [list(column) for column in zip(*rows, strict=True)],
        )


def copied_lines(batch: Batch, unit: int, file: int) -> str:
    """Rows in the text format of COPY; no text of a batch contains a character that needs escaping."""
    lines = []
    for row in batch.rows:
        known = (
            f'"{key}":[{mean},{"null" if sigma is None else sigma},{low},{high}]'
            for key, value in zip(batch.quantities, row.values, strict=True)
            if value is not None
            for mean, sigma, low, high in (value,)
        )
        time = datetime.fromtimestamp(row.t_s, UTC).isoformat()
        about = (unit, time, file, *row[:2], *row[3:8])
        lines.append("\t".join(map(str, about)) + f"\t{{{','.join(known)}}}\n")
    return "".join(lines)


def maintain(connection: psycopg.Connection, settings: FleetSettings) -> int | None:
    """Delete old rows, create tomorrow's partition and roll up one due hour of each unit.

    Returns the number of hours; None: another instance does it at this time. Raises psycopg.Error.
    """
    held = connection.execute("SELECT pg_try_advisory_lock(%s)", (_LOCK + 1,)).fetchone()
    if held is None or not held[0]:
        return None
    try:
        connection.execute("SET lock_timeout = '2s'")
        connection.execute("SELECT altd.make_day(date_trunc('day', now()) + interval '1 day')")
        keep = settings.retention
        connection.execute("SELECT altd.retain(%s, %s)", (keep.seconds_days, keep.minutes_days))
        hours, unit = 0, 0
        while (row := connection.execute("SELECT altd.roll_up(%s)", (unit,)).fetchone()) and row[0]:
            hours, unit = hours + 1, row[0]
    finally:
        connection.execute("SELECT pg_advisory_unlock(%s)", (_LOCK + 1,))
    return hours
