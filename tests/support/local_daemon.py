"""A daemon that plays a recording and is asked through its local socket."""

import contextlib
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from support.played_unit import PlayedUnit, PlayingDaemon, playing


@dataclass(frozen=True)
class LocalDaemon:
    """Its process, its settings and its socket."""

    daemon: PlayingDaemon
    config: Path
    socket: Path


@contextlib.contextmanager
def local_daemon(unit: PlayedUnit, folder: Path) -> Iterator[LocalDaemon]:
    """It measures when this returns."""
    socket = folder / "altd.sock"
    with playing(unit, folder, subprocess.DEVNULL, more=f'[local]\nsocket = "{socket}"\n') as daemon:
        daemon.wait_until_valid()
        yield LocalDaemon(daemon, folder / "altd.toml", socket)
