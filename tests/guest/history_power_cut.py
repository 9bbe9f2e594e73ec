"""Says what the last power cut left of a history on a real ext4, and records on until the next one."""

import os
import sqlite3
import subprocess
import sys
from pathlib import Path

from support.history_crash import HistoryLostError, judged, write

from altd.history import opening
from altd.history import store as store_module

DISK = Path("/run/disk")

synchronous, last, first = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
console = os.open("/dev/console", os.O_WRONLY)


def tell(line: str) -> None:
    os.write(console, f"{line}\n".encode())


def with_less_care(path: Path) -> sqlite3.Connection:
    connection = opening.open_to_write(path)
    connection.execute(f"PRAGMA synchronous = {synchronous}")
    return connection


if synchronous != "FULL":
    store_module.open_to_write = with_less_care
DISK.mkdir()
subprocess.run(["mount", "-t", "ext4", "/dev/ubda", str(DISK)], check=True)  # replays its journal
path = DISK / "history.db"
try:
    left = judged(path, last) if path.exists() else 0
    tell(f"LEFT {left}")
except HistoryLostError as error:
    tell(f"BROKEN {error}")
    sys.exit(1)
write(path, first, lambda sequence, t_ns: tell(f"N {sequence} {t_ns}"))
