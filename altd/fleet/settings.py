"""``fleet.toml``: the settings of ``altd ingest`` and ``altd fleet``."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, ValidationError

from altd.config.fields import expected, field_at
from altd.config.interfaces import BrokerSettings
from altd.config.places import Place, Places
from altd.config.wording import UNUSABLE, WHY
from altd.errors import BadInputError, did_you_mean
from altd.files.documents import TomlError, parse_toml
from altd.files.reading import check_rights, read_file
from altd.files.table import Table, shown

_MAX_BYTES = 1 << 16


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
    content = read_file(path, _MAX_BYTES)
    try:
        document = parse_toml(content)
        settings = FleetSettings.model_validate(document)
    except TomlError as error:
        place = "" if error.line is None or error.column is None else f"{Place(error.line, error.column)}: "
        raise BadInputError(path, f"{place}{error}") from error
    except ValidationError as error:
        text = content.decode()
        raise BadInputError(path, *_faults(error, document, Places(text, tomllib.loads(text)))) from error
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


def _faults(error: ValidationError, document: dict[str, Any], places: Places) -> Iterator[str]:
    for detail in error.errors(include_url=False):
        keys = tuple(detail["loc"])
        of_key = places.key if detail["type"] == "extra_forbidden" else places.value
        place = of_key(keys) or places.nearest(keys)
        where = f"{f'{place}: ' if place else ''}{'.'.join(map(str, keys))}"
        if detail["type"] == "extra_forbidden":
            above = field_at(keys[:-1], document, FleetSettings)
            table = FleetSettings if above is None or not keys[:-1] else above[0]
            names = list(table.model_fields)
            suggestion = did_you_mean(keys[-1], names)
            yield f"{where}: there is no such key; possible: {', '.join(names)}{suggestion}"
        elif detail["type"] == "missing":
            yield f"{where}: this key is missing"
        elif "faults" in detail.get("ctx", {}):
            yield f"{where}: {'; '.join(text for _, text in detail['ctx']['faults'])}"
        else:
            found = field_at(keys, document, FleetSettings)
            takes = "" if found is None else f"; possible: {expected(*found, shown)}"
            yield f"{where}: {shown(detail['input'])} {WHY.get(detail['type'], UNUSABLE)}{takes}"
