"""The messages that an ingest holds while its database is away."""

from __future__ import annotations

from ctypes.util import find_library
from pathlib import Path
from unittest.mock import Mock

from support.foreign import need

from altd.fleet.settings import load_fleet_settings


def test_messages_of_a_connection_that_ended_are_not_kept(tmp_path: Path) -> None:
    """A broker that comes and goes while the database is away delivers the same thousand again and again."""
    need(find_library("pq") is not None, "libpq is not installed (Debian package libpq5)")
    from altd.fleet.ingest import Ingest

    (tmp_path / "fleet.toml").write_text(
        '[broker]\nhost = "broker"\n[database]\nconnection = "dbname=altd"\n'
    )
    ingest, connected = Ingest(load_fleet_settings(tmp_path / "fleet.toml")), Mock(is_failure=False)
    client, message = Mock(), Mock(payload=b"")
    for _ in range(100):
        ingest._on_connect(Mock(), None, None, connected, None)  # noqa: SLF001  as paho calls it
        for _ in range(1000):
            ingest._on_message(client, None, message)  # noqa: SLF001
    assert ingest._messages.qsize() == 1000  # noqa: SLF001
