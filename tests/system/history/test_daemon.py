"""The history of a real daemon: over restarts and crashes, and on disks that are full or gone."""

import contextlib
import json
import os
import shutil
import signal
import subprocess
import time
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from support.foreign import need
from support.played_unit import PlayedUnit, PlayingDaemon, playing

from altd.history.reader import Reader
from altd.history.records import StoredEvent
from altd.history.schema import SECONDS


def status(daemon: PlayingDaemon) -> dict[str, Any]:
    with urllib.request.urlopen(f"http://127.0.0.1:{daemon.http}/api/status", timeout=20) as answer:
        document: dict[str, Any] = json.load(answer)
        return document


def until(true: Callable[[], bool], timeout_s: float = 40.0) -> None:
    deadline = time.monotonic() + timeout_s
    while not true():
        assert time.monotonic() < deadline
        time.sleep(0.1)


def end(daemon: PlayingDaemon) -> None:
    daemon.process.send_signal(signal.SIGTERM)
    assert daemon.process.wait(20) == 0


def said_of_history(daemon: PlayingDaemon) -> tuple[str, str]:
    component = status(daemon)["components"]["history"]
    return component["state"], component["message"]


def until_started(path: Path, times: int) -> None:
    """Wait until the history has so many starts of a daemon: it is written some times a second."""
    until(lambda: [event.kind for event in events(path)].count("started") == times)


def events(path: Path) -> list[StoredEvent]:
    with Reader(path) as reader:
        return reader.events(0, 2**62)[::-1]


@contextlib.contextmanager
def keeping(unit: PlayedUnit, folder: Path, path: Path, more: str = "") -> Iterator[PlayingDaemon]:
    with playing(unit, folder, subprocess.DEVNULL, more=f'[history]\nfile = "{path}"\n{more}') as daemon:
        daemon.wait_until_valid()
        yield daemon


def test_what_was_shown_is_in_the_history_with_its_start_end_and_changes(
    played_unit: PlayedUnit, tmp_path: Path
) -> None:
    path = tmp_path / "history.db"
    with keeping(played_unit, tmp_path, path) as daemon:
        shown = [daemon.measurement() for _ in range(20) if time.sleep(0.1) is None]
        published = status(daemon)["components"]["measuring"]["measurements"]
        end(daemon)
    with keeping(played_unit, tmp_path, path, "max_mb = 300\n") as daemon:
        until_started(path, 2)
        daemon.process.kill()
        daemon.process.wait()
    with keeping(played_unit, tmp_path, path, "max_mb = 300\n") as daemon:
        until_started(path, 3)
        end(daemon)
    with Reader(path) as reader:
        stored = reader.measurements_after(0, 5000)
        rows = list(reader.summaries(SECONDS, 0, 2**62))
    assert sum(one.epoch == 1 for one in stored) >= published, "every one"
    first = {one.sequence: one for one in stored if one.epoch == 1 and one.valid}
    for measurement in filter(lambda one: one["valid"], shown):
        kept = first[measurement["sequence"]]
        assert kept.values["x_mm"] == measurement["x_mm"]
        assert kept.values["rear.y_mm"] == measurement["rear"]["y_mm"]
        assert kept.sigmas["yaw_deg"] == measurement["sigma"]["yaw_deg"]
        assert list(kept.status) == measurement["status"]
    assert sum(row.n for row in rows) == len(stored)
    kinds = [event.kind for event in events(path) if event.kind not in ("state", "cause_came", "cause_went")]
    first_start, second, third = (
        ["history", "started", "stopped"],
        ["config", "started"],
        ["not_ended", "config"],
    )
    assert kinds == [*first_start, *second, *third, "started", "stopped"]
    changed = next(event for event in events(path) if event.kind == "config").detail["changed"]
    assert isinstance(changed, dict)
    assert set(changed) == {"history.max_mb", "http.port", "modbus_tcp.port"}
    assert changed["history.max_mb"] == ["400", "300"]


def test_in_the_folder_that_systemd_gives(
    played_unit: PlayedUnit, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("STATE_DIRECTORY", str(tmp_path))
    with playing(played_unit, tmp_path, subprocess.DEVNULL) as daemon:
        daemon.wait_until_valid()
        until(lambda: said_of_history(daemon)[1].endswith(f" MB in {tmp_path}/history.db"))
        end(daemon)
    assert events(tmp_path / "history.db")[-1].kind == "stopped"


def test_a_disk_that_is_read_only_is_told_and_used_once_it_is_not(
    played_unit: PlayedUnit, tmp_path: Path
) -> None:
    need(os.geteuid() == 0, "to mount a disk needs root")
    disk = tmp_path / "disk"
    disk.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", "size=5m", "tmpfs", str(disk)], check=True)
    try:
        with keeping(played_unit, tmp_path, disk / "history.db") as daemon:
            until(lambda: said_of_history(daemon)[0] == "ok")
            end(daemon)
        subprocess.run(["mount", "-o", "remount,ro", str(disk)], check=True)
        with keeping(played_unit, tmp_path, disk / "history.db") as daemon:
            until(lambda: said_of_history(daemon)[0] == "degraded")
            assert said_of_history(daemon)[1].endswith(f"the folder {disk} cannot be written")
            assert daemon.measurement()["valid"]
            subprocess.run(["mount", "-o", "remount,rw", str(disk)], check=True)
            until(lambda: said_of_history(daemon)[0] == "ok")
            end(daemon)
    finally:
        subprocess.run(["umount", "-l", str(disk)], check=False, stderr=subprocess.DEVNULL)


_SLOW_C = """\
#include <sys/syscall.h>
#include <unistd.h>
int fsync(int file) { sleep(10); return syscall(SYS_fsync, file); }
int fdatasync(int file) { sleep(10); return syscall(SYS_fdatasync, file); }
"""


@pytest.mark.real_time
def test_a_disk_that_takes_ten_seconds_a_write_leaves_the_measurement_as_it_is(
    played_unit: PlayedUnit, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Between SQLite and the kernel is an fsync that takes ten seconds, as that of a worn-out card."""
    need(shutil.which("gcc") is not None, "gcc is not installed")
    library = tmp_path / "slow.so"
    (tmp_path / "slow.c").write_text(_SLOW_C)
    subprocess.run(["gcc", "-shared", "-fPIC", "-o", library, tmp_path / "slow.c"], check=True)
    monkeypatch.setenv("LD_PRELOAD", str(library))
    with keeping(played_unit, tmp_path, tmp_path / "history.db") as daemon:
        until(lambda: said_of_history(daemon)[0] == "degraded")
        assert said_of_history(daemon)[1].startswith("the disk has not answered for ")
        before, begun_s = status(daemon)["components"]["measuring"]["measurements"], time.monotonic()
        longest_s = 0.0
        while time.monotonic() < begun_s + 8.0:
            asked_s = time.monotonic()
            assert daemon.measurement()["valid"]
            longest_s = max(longest_s, time.monotonic() - asked_s)
            time.sleep(0.05)
        after, took_s = status(daemon)["components"]["measuring"]["measurements"], time.monotonic() - begun_s
        assert (after - before) / took_s > 15, "of 20 a second"
        assert longest_s < 1.0
        told_s = time.monotonic()
        end(daemon)
        assert time.monotonic() - told_s < 6.0


@pytest.mark.real_time
def test_a_full_disk_and_one_that_is_gone_leave_the_measurement_as_it_is(
    played_unit: PlayedUnit, tmp_path: Path
) -> None:
    """A real one of 8 MB; then it is emptied, and at last taken away."""
    need(os.geteuid() == 0, "to mount a small disk needs root")
    disk = tmp_path / "disk"
    disk.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", "size=8m", "tmpfs", str(disk)], check=True)
    try:
        path = disk / "history.db"
        filler = disk / "filler"
        with keeping(played_unit, tmp_path, path) as daemon:
            until(lambda: said_of_history(daemon)[0] == "ok")
            with contextlib.suppress(OSError), filler.open("wb") as file:
                while True:
                    file.write(b"x" * 4096)
                    file.flush()
            until(lambda: said_of_history(daemon)[0] == "degraded")
            assert (
                "disk is full" in said_of_history(daemon)[1] or "No space left" in said_of_history(daemon)[1]
            )
            lost_before = status(daemon)["components"]["measuring"]["measurements"]
            time.sleep(1.0)
            assert status(daemon)["components"]["measuring"]["measurements"] >= lost_before + 10
            assert daemon.measurement()["valid"]
            filler.unlink()
            until(lambda: said_of_history(daemon)[0] == "ok")
            subprocess.run(["umount", "-l", str(disk)], check=True)
            until(lambda: said_of_history(daemon)[0] == "degraded" or path.exists())
            assert daemon.measurement()["valid"]
            end(daemon)
    finally:
        subprocess.run(["umount", "-l", str(disk)], check=False, stderr=subprocess.DEVNULL)
