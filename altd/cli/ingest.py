"""``altd ingest``: writes messages of many units from the broker into PostgreSQL."""

from __future__ import annotations

import argparse
import logging
from contextlib import suppress
from pathlib import Path

from altd.process.endings import EndedBySignal
from altd.process.logs import logging_to_stderr

SUMMARY = "take the units' outboxes from a broker into PostgreSQL (extra altd[fleet])"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument("--config", type=Path, required=True, metavar="FILE", help="settings, fleet.toml")


def run(options: argparse.Namespace) -> int:
    """Run until a signal ends it; return status 0, as a service does."""
    from altd.fleet.settings import check_client, load_fleet_settings

    settings = load_fleet_settings(options.config)
    check_client()
    from altd.fleet.ingest import Ingest

    ingest = Ingest(settings)
    with logging_to_stderr(logging.INFO), suppress(EndedBySignal):
        ingest.run()
    return 0
