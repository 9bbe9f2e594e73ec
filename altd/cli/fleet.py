"""``altd fleet``: the table of all units."""

from __future__ import annotations

import argparse
from pathlib import Path

from altd.process.standard_streams import print_lines

SUMMARY = "print all units with state, lag, share of valid measurements and backlog (extra altd[fleet])"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument("--config", type=Path, required=True, metavar="FILE", help="settings, fleet.toml")
    parser.add_argument("--json", action="store_true", help="print one JSON list instead of text")


def run(options: argparse.Namespace) -> int:
    """Print a line for each unit."""
    from altd.fleet.settings import check_client, load_fleet_settings

    settings = load_fleet_settings(options.config)
    check_client()
    from altd.fleet.table import as_json, as_text, units

    rows = units(settings)
    print_lines(*([as_json(rows)] if options.json else as_text(rows)))
    return 0
