"""Power cuts while a history is written to an ext4 of a real kernel; the next boot replays its journal.

A User-Mode Linux has the disk, a file of this machine. Killing it loses what the guest had not yet given to
the disk. ``ALTD_BENCH_POWER_CUTS=50`` cuts more often, ``ALTD_BENCH_SYNCHRONOUS=NORMAL`` tries SQLite's other
way.
"""

import os
import random
import re
import shutil
import subprocess
import time
from pathlib import Path

import pytest
from support.foreign import need
from support.guest import cut_power
from support.history_crash import FIRST_SEQUENCE_STEP, MAX_LOST_S, Loss, loss_of

CUTS = int(os.environ.get("ALTD_BENCH_POWER_CUTS", "3"))
SYNCHRONOUS = os.environ.get("ALTD_BENCH_SYNCHRONOUS", "FULL")
LAST_S = 4.0
"""The cuts are spread over so many seconds after the first measurement."""
NOTE = re.compile(r"^N (\d+) (\d+)\r?$", re.MULTILINE)
LEFT = re.compile(r"^(?:LEFT (\d+)|BROKEN (.*))\r?$", re.MULTILINE)


class Moment:
    """So long after the first measurement was published."""

    def __init__(self, after_s: float) -> None:
        self._after_s = after_s
        self._due_s: float | None = None

    def is_due(self, console: str) -> bool:
        if self._due_s is None and NOTE.search(console):
            self._due_s = time.monotonic() + self._after_s
        return self._due_s is not None and time.monotonic() >= self._due_s


@pytest.mark.real_time
@pytest.mark.timeout(120 + 60 * CUTS)
def test_a_power_cut_loses_less_than_a_second_and_never_the_file(tmp_path: Path) -> None:
    make = shutil.which("mkfs.ext4") or shutil.which("mkfs.ext4", path="/usr/sbin:/sbin") or ""
    need(bool(make), "mkfs.ext4 is not installed (Debian package e2fsprogs)")
    disk = tmp_path / "disk"
    with disk.open("wb") as file:
        file.truncate(64 << 20)
    subprocess.run([make, "-q", "-F", str(disk)], check=True)
    folder = tmp_path / "guest"
    folder.mkdir()
    draw = random.Random(3)
    published: dict[int, int] = {}
    losses: list[Loss] = []
    for number in range(CUTS + 1):
        moment = Moment((number + draw.random()) * LAST_S / CUTS if number < CUTS else 0.0)
        numbers = (max(number - 1, 0) * FIRST_SEQUENCE_STEP, number * FIRST_SEQUENCE_STEP)
        console = cut_power(
            folder,
            "history_power_cut.py",
            SYNCHRONOUS,
            *numbers,
            kernel_arguments=(f"ubd0={disk}",),
            is_due=moment.is_due,
        )
        left = LEFT.search(console)
        assert left is not None, console
        assert left[2] is None, left[2]
        if number:
            losses.append(loss_of(published, numbers[0], int(left[1])))
        published = {int(note[1]): int(note[2]) for note in NOTE.finditer(console)}
    lost_s = sorted(loss.lost_s for loss in losses)
    total = sum(loss.published for loss in losses)
    print(f"{CUTS} power cuts, {total} measurements published, no file damaged")
    print(f"lost: {lost_s[len(lost_s) // 2]:.2f} s in the median, {lost_s[-1]:.2f} s at most")
    assert total > 50 * CUTS
    if SYNCHRONOUS == "FULL":
        assert lost_s[-1] <= MAX_LOST_S
