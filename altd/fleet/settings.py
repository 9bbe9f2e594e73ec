"""``fleet.toml``: the settings of ``altd ingest`` and ``altd fleet``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import Field

from altd.config.interfaces import BrokerSettings
from altd.config.loading import load_tables
from altd.errors import BadInputError
from altd.files.reading import check_rights
from altd.files.table import Table


class FleetBrokerSettings(BrokerSettings):
    """The broker that the units publish to: any broker of MQTT 5 with shared subscriptions."""

    group: Annotated[str, Field(pattern=r"^[A-Za-z0-9_.-]+$", max_length=60)] = "altd"
    """Name of the shared subscription: the instances of one group share the messages."""


class DatabaseSettings(Table):
    """The database, PostgreSQL 14 or later."""

    connection: Annotated[str, Field(min_length=1, max_length=1000)]
    """Connection string of libpq, such as `host=/run/postgresql dbname=altd`. `passfile` in it names the file
    with the password."""


class RetentionSettings(Table):
    """Retention times; summaries of 1 h are kept indefinitely."""

    seconds_days: Annotated[int, Field(ge=8, le=36_500)] = 93
    """Days for which summaries of 1 s are kept."""
    minutes_days: Annotated[int, Field(ge=8, le=36_500)] = 731
    """Days for which summaries of 1 min are kept."""


class FleetSettings(Table):
    """All settings of ``fleet.toml``."""

    broker: FleetBrokerSettings
    database: DatabaseSettings
    retention: RetentionSettings = RetentionSettings()


def load_fleet_settings(path: Path) -> FleetSettings:
    """Read and check the file; relative paths in it start in its folder.

    Raises BadInputError that names the file and, for each fault, line, column and key.
    """
    check_rights(path)
    settings = load_tables(path, FleetSettings)
    broker = settings.broker
    paths = {
        name: path.parent / value
        for name in ("ca", "certificate", "key", "credentials")
        if (value := getattr(broker, name)) is not None
    }
    return settings.model_copy(update={"broker": broker.model_copy(update=paths)})


def check_client() -> None:
    """Raise BadInputError if the database's client is missing: psycopg, or the libpq that it loads."""
    try:
        import psycopg  # noqa: F401
    except ImportError as error:
        text = "needs psycopg, which comes with the extra altd[fleet], and libpq (Debian package libpq5)"
        raise BadInputError("database.connection", text) from error
