"""``altd fleet``: all units, as stored in the database."""

from __future__ import annotations

import json
from collections.abc import Sequence
from datetime import timedelta
from typing import Any

import psycopg

from altd.errors import BadInputError, one_line
from altd.fleet.database import connect, version_of
from altd.fleet.settings import FleetSettings
from altd.reasons import Signal
from altd.records import utc_text
from altd.status.health import duration

KEYS = (
    "unit",
    "last_time",
    "heard",
    "worst",
    "cause",
    "lag_s",
    "valid_share",
    "backlog",
    "dropped",
    "refused",
)
_MAX_AHEAD = timedelta(minutes=1)
"""Advance of a unit's clock over the database's that needs no mark."""

_SIGNALS = {signal.severity: str(signal) for signal in Signal}
_HEAD = ("unit", "newest", "state", "cause", "lag", "valid in 1 h", "backlog", "dropped", "refused")


def units(settings: FleetSettings) -> list[dict[str, Any]]:
    """Return a row for each unit; raises BadInputError if they cannot be read."""
    try:
        with connect(settings) as connection:
            if version_of(connection) == 0:
                raise BadInputError("database.connection", "no ingest has made its tables there")
            rows = connection.execute(f"SELECT {', '.join(KEYS)} FROM altd.fleet").fetchall()  # noqa: S608
    except psycopg.Error as error:
        raise BadInputError("database.connection", one_line(str(error).strip())) from error
    return [dict(zip(KEYS, row, strict=True)) for row in rows]


def as_json(rows: Sequence[dict[str, Any]]) -> str:
    """Return the rows as one JSON list."""
    return json.dumps(
        [
            {
                key: utc_text(value) if key in ("last_time", "heard") and value else value
                for key, value in row.items()
            }
            for row in rows
        ]
    )


def as_text(rows: Sequence[dict[str, Any]]) -> list[str]:
    """Return the rows as a table for a terminal, with the worst fault and the longest silence visible."""
    table = [_HEAD, *(_cells(row) for row in rows)]
    widths = [max(len(row[place]) for row in table) for place in range(len(_HEAD))]
    return [
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in table
    ]


def _cells(row: dict[str, Any]) -> tuple[str, ...]:
    share, lag_s, time = row["valid_share"], row["lag_s"], row["last_time"]
    return (
        row["unit"],
        "-" if time is None else f"{utc_text(time)[:19]}Z{_ahead(time - row['heard'])}",
        "-" if row["worst"] is None else _SIGNALS[row["worst"]],
        row["cause"] or "-",
        "-" if lag_s is None else duration(lag_s),
        "-" if share is None else f"{100 * share:.1f} %",
        "-" if row["backlog"] is None else duration(float(row["backlog"])),
        str(row["dropped"]),
        str(row["refused"]),
    )


def _ahead(advance: timedelta) -> str:
    return f" +{duration(advance.total_seconds())}" if advance > _MAX_AHEAD else ""
