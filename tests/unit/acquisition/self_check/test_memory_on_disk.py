"""The file that keeps the history of checks: damaged, forged, on a disk that is full, away or hangs."""

import json
import os
import subprocess
import sys
import threading
from datetime import timedelta
from pathlib import Path

import pytest
from support.foreign import on_small_disk
from support.remembered_checks import CALIBRATION, FIRST, NAME, Unit, check

from altd.acquisition.self_check import memory as memory_of
from altd.acquisition.self_check.memory import SAVE_INTERVAL_S, CheckMemory
from altd.files.documents import checksum_of
from altd.status.health import State


def spoilt(path: Path, **entries: object) -> bytes:
    """The file with these entries of the front target, under a checksum that fits."""
    document = json.loads(path.read_bytes())
    del document["checksum"]
    document["targets"]["front"] |= entries
    return json.dumps({**document, "checksum": checksum_of(document)}).encode()


DAY = {"number": 20_777, "checks": 1, "sums": [0.0] * 4, "variances": [1e-5] * 4}
FORGED: dict[str, dict[str, object]] = {
    "drift_of_no_day": {"drifts": True, "days": []},
    "infinite": {"above": [1e300] * 4},
    "negative_variance": {"today": DAY | {"variances": [-1.0] * 4}},
    "no_check": {"today": DAY | {"checks": 0}},
    "same_day_twice": {"days": [DAY, DAY], "today": DAY | {"number": 20_778}},
    "too_many_days": {"days": [DAY | {"number": n} for n in range(31)]},
    "no_radius": {"radius_px": 0.0},
    "three_numbers": {"below": [0.0] * 3},
    "foreign_key": {"more": 1},
}


@pytest.mark.parametrize("forged", FORGED)
async def test_a_forged_file_is_told_once_and_begins_anew(
    forged: str, unit: Unit, warnings: list[str]
) -> None:
    await unit.run((0.0, FIRST))
    unit.path.write_bytes(spoilt(unit.path, **FORGED[forged]))
    await is_begun_anew(unit, warnings)


async def is_begun_anew(unit: Unit, warnings: list[str]) -> None:
    """One warning that names the file; then it is written again and good."""
    tomorrow = FIRST + timedelta(days=1)
    assert await unit.run((0.0, tomorrow), (0.0, tomorrow)) == ""
    (warning,) = warnings
    assert warning.startswith(f"self-check history: starts again: {unit.path}: ")
    assert unit.component.state is State.OK
    assert unit.days() == 1
    assert [entry.name for entry in unit.path.parent.iterdir()] == [NAME]


@pytest.mark.parametrize("damage", ["cut", "turned", "empty", "noise", "list", "deep", "large", "twice"])
async def test_a_damaged_file_is_told_once_and_begins_anew(
    damage: str, unit: Unit, warnings: list[str]
) -> None:
    await unit.run((0.0, FIRST))
    content = unit.path.read_bytes()
    unit.path.write_bytes(
        {
            "cut": content[: len(content) // 2],
            "turned": content.replace(b'"checks": 1', b'"checks": 2', 1),
            "empty": b"",
            "noise": bytes(range(256)),
            "list": b"[]",
            "deep": b"[" * 200_000,
            "large": content + b" " * (1 << 20),
            "twice": content.replace(b'"format"', b'"format": "", "format"', 1),
        }[damage]
    )
    await is_begun_anew(unit, warnings)


async def test_what_is_no_file_is_told_and_not_replaced(unit: Unit, warnings: list[str]) -> None:
    os.mkfifo(unit.path)
    await unit.run((0.0, FIRST), (0.0, FIRST))
    assert [warning.partition(":")[0] for warning in warnings] == ["self-check history"] * 2
    assert unit.component.state is State.DEGRADED
    assert "not kept" in unit.component.message
    assert unit.path.is_fifo()


async def test_the_file_stays_small_and_is_not_written_at_every_check(unit: Unit) -> None:
    await unit.run(*((0.01, FIRST + timedelta(days=day)) for day in range(200)))
    assert unit.days() == 31
    assert unit.path.stat().st_size < 20_000
    before = unit.path.stat().st_mtime_ns
    soon = FIRST + timedelta(days=300)
    await unit.run((0.0, soon), *((0.0, soon) for _ in range(5)), pause_s=SAVE_INTERVAL_S / 10)
    written = json.loads(unit.path.read_bytes())["targets"]["front"]["today"]["checks"]
    assert written == 1
    assert unit.path.stat().st_mtime_ns > before


async def test_a_folder_that_is_not_there_is_told_once_and_found_when_it_comes(
    tmp_path: Path, warnings: list[str]
) -> None:
    unit = Unit(tmp_path / "later")
    memory = CheckMemory(CALIBRATION, unit.clock)
    memory.keep_in(unit.path, unit.component)
    for _ in range(3):
        await memory.add(check(0.0), FIRST)
        await memory.save()
    assert warnings == [f"self-check history: not kept: {unit.path}: No such file or directory"]
    assert unit.component.state is State.DEGRADED
    unit.path.parent.mkdir()
    await memory.add(check(0.0), FIRST)
    await memory.save()
    await memory.end()
    assert (unit.component.state, unit.component.message) == (State.OK, f"1 day in {unit.path}")


async def test_a_disk_that_hangs_holds_a_check_for_a_moment_and_its_history_is_not_lost(
    unit: Unit, monkeypatch: pytest.MonkeyPatch, warnings: list[str]
) -> None:
    await unit.run((0.0, FIRST))
    kept = unit.path.read_bytes()
    monkeypatch.setattr(memory_of, "_DISK_TIMEOUT_S", 0.05)
    answers, real = threading.Event(), memory_of.read_file

    def hanging(path: Path, largest_bytes: int) -> bytes:
        answers.wait()
        return real(path, largest_bytes)

    monkeypatch.setattr(memory_of, "read_file", hanging)
    memory = CheckMemory(CALIBRATION, unit.clock)
    memory.keep_in(unit.path, unit.component)
    tomorrow = FIRST + timedelta(days=1)
    for _ in range(2):
        await memory.add(check(0.0), tomorrow)
        await memory.save()
    assert unit.path.read_bytes() == kept
    assert warnings == ["self-check history: not read: the disk does not answer within 2 s"]
    answers.set()
    while unit.days() == 1:
        await memory.add(check(0.0), tomorrow)
        await memory.save()
    await memory.end()
    assert unit.days() == 2


FILLING = """
import asyncio, pathlib, sys
from support.remembered_checks import FIRST, Unit
from datetime import timedelta
unit = Unit(pathlib.Path(sys.argv[1]))
async def main():
    await unit.run((0.0, FIRST))
    kept = unit.path.read_bytes()
    (unit.path.parent / "recording").write_bytes(bytes(int(sys.argv[2])))
    await unit.run(*((0.01 * day, FIRST + timedelta(days=day)) for day in range(1, 40)))
    print(unit.component.state, unit.component.message, unit.path.read_bytes() == kept,
          sorted(p.name for p in unit.path.parent.iterdir()))
asyncio.run(main())
"""


def test_on_a_full_disk_the_old_history_stays_and_it_is_told(tmp_path: Path) -> None:
    """A real disk of 64 kB that something else has filled, in a mount namespace of its own."""
    done = subprocess.run(
        on_small_disk(tmp_path, "64k", f"exec {sys.executable} - {tmp_path} {15 << 12}"),
        input=FILLING,
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
    )
    said = f"not kept: {tmp_path / NAME}: No space left on device"
    assert done.stdout == f"degraded {said} True ['recording', '{NAME}']\n", done.stderr
    assert done.stderr == f"self-check history: {said}\n"
