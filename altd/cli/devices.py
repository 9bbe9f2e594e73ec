"""``altd devices``: what is connected to this computer."""

from __future__ import annotations

import argparse

SUMMARY = "list cameras, GPIO lines and serial ports as the config wants them"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """None."""


def run(_options: argparse.Namespace) -> int:
    """Print them."""
    from altd.app.connected_devices import lines

    for line in lines():
        print(line, flush=True)
    return 0
