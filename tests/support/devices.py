"""A device that takes nothing, which no test can break: as root a copy of it, else the computer's own."""

import os
import stat
from contextlib import suppress
from pathlib import Path


def full_device(folder: Path) -> Path:
    path = folder / "full"
    with suppress(PermissionError):
        os.mknod(path, stat.S_IFCHR | 0o666, os.makedev(1, 7))
        return path
    return Path("/dev/full")
