"""``altd devices``: lists the devices connected to this computer, in the notation of ``altd.toml``.

Devices that another program uses are left alone, and no setting is changed.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator

from altd.process.standard_streams import print_lines

SUMMARY = "list the connected cameras, GPIO lines and serial ports as settings name them"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add nothing: the command takes no arguments."""


def run(_options: argparse.Namespace) -> int:
    """Print what is connected."""
    for line in lines():
        print_lines(line)
    return 0


def lines() -> Iterator[str]:
    """Yield all devices for a person, by section; a section without devices reports that, or why."""
    from altd.config.drivers import DRIVERS

    for number, driver in enumerate(DRIVERS):
        yield from ("", driver.heading) if number else (driver.heading,)
        yield from _or_none(driver.found())


def _or_none(entries: Iterator[str]) -> Iterator[str]:
    first = next(entries, "  none")
    yield first
    yield from entries
