"""Parts that take seconds are made once a run: the first worker that needs one makes it, others wait."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Callable
from pathlib import Path

import pytest


def made_once(factory: pytest.TempPathFactory, name: str, make: Callable[[Path], object]) -> Path:
    """A folder of the whole run, whichever of its workers asks; ``make`` fills it, no test changes it.

    The tests in a network of their own, in a process of this one, find it too.
    """
    base = Path(os.environ.setdefault("ALTD_MADE_ONCE", str(factory.getbasetemp())))
    if base.name.startswith("popen-"):  # a worker's own, in that of the run
        base = base.parent
    folder, made = base / name, base / f"{name}.made"
    with (base / f"{name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not made.exists():
            folder.mkdir()  # fails where making it failed before: its cause is in the first test's report
            make(folder)
            made.touch()
    return folder
