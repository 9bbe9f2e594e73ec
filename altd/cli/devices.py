"""``altd devices``: what is connected to this computer."""

from __future__ import annotations

import argparse

from altd.process.standard_streams import say

SUMMARY = "list the connected cameras, GPIO lines and serial ports as settings name them"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command takes none."""


def run(_options: argparse.Namespace) -> int:
    """Print what is connected."""
    from altd.app.connected_devices import lines

    for line in lines():
        say(line)
    return 0
