"""The history of checks over restarts, on real files; each day is one process's life."""

from __future__ import annotations

import json
import logging
import math
import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from support import evidence
from support.clock import FakeClock

from altd.acquisition.self_check import memory as memory_of
from altd.acquisition.self_check.memory import SAVE_INTERVAL_S, CheckMemory
from altd.files.documents import checksum_of
from altd.measuring.calibration import Calibration
from altd.selfcheck.records import SelfCheck, Similarity, TargetDrift, Verdict
from altd.status.health import Component, State

CALIBRATION = evidence.calibration()
FIRST = CALIBRATION.created + timedelta(hours=1)
NAME = "self-checks.json"
SIGMA_PX, RADIUS_PX = 0.003, 330.0


def check(shift_px: float, verdict: Verdict = Verdict.GOOD) -> SelfCheck:
    """Of both targets, each with that shift to the right."""
    to_px = np.array([1.0, 1.0, math.radians(RADIUS_PX), 1e-6 * RADIUS_PX])
    moved = Similarity((376.0, 240.0), (shift_px, 0.0), 0.0, 0.0, np.diag((SIGMA_PX / to_px) ** 2), RADIUS_PX)
    drift = {name: TargetDrift(name, 6, 6, (), similarity=moved, rms_px=0.0) for name in ("front", "rear")}
    return SelfCheck(verdict, drift, {})


class Unit:
    """The memory of one daemon after the other, in one folder."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / NAME
        self.clock = FakeClock()
        self.component = Component("self-check history", self.clock)

    async def run(
        self, *checks: tuple[float, datetime], calibration: Calibration = CALIBRATION, pause_s: float = 600.0
    ) -> str:
        """One daemon that makes these checks; what it says of a drift at its end."""
        memory = CheckMemory(calibration, self.clock)
        memory.keep_in(self.path, self.component)
        for shift_px, time in checks:
            await memory.add(check(shift_px), time)
            await memory.save()
            self.clock.now_ns += round(pause_s * 1e9)
        await memory.end()
        return memory.slow_drift

    async def told_after_days(self, px_a_day: float, days: int = 12) -> int | None:
        """Days of a drift until it is told, with a start each day; None: never."""
        for day in range(days):
            if await self.run((px_a_day * day, FIRST + timedelta(days=day))):
                return day
        return None

    def days(self) -> int:
        """How many days the file holds."""
        kept = json.loads(self.path.read_bytes())["targets"]["front"]
        return 1 + len(kept["days"])


@pytest.fixture
def unit(tmp_path: Path) -> Unit:
    return Unit(tmp_path)


@pytest.fixture
def warnings(caplog: pytest.LogCaptureFixture) -> Iterator[list[str]]:
    said: list[str] = []
    handler = logging.Handler(logging.WARNING)
    handler.emit = lambda record: said.append(record.getMessage())  # type: ignore[method-assign]
    logging.getLogger("altd").addHandler(handler)
    yield said
    logging.getLogger("altd").removeHandler(handler)


async def test_a_unit_that_starts_anew_each_day_finds_a_slow_drift(unit: Unit, warnings: list[str]) -> None:
    told = await unit.told_after_days(0.02)
    assert told is not None
    assert told <= 10
    sentence = await unit.run((0.02 * told, FIRST + timedelta(days=told)))
    assert "front drifts by 0.020 px a day" in sentence
    assert unit.component.state is State.OK
    assert warnings == []


async def test_a_restart_changes_nothing_of_what_is_found(unit: Unit, tmp_path: Path) -> None:
    checks = [(0.004 * n, FIRST + timedelta(hours=5 * n)) for n in range(40)]
    other = Unit(tmp_path / "other")
    other.path.parent.mkdir()
    at_once = await unit.run(*checks)
    for one in checks:
        in_parts = await other.run(one)
    assert at_once == in_parts != ""
    assert unit.path.read_bytes() == other.path.read_bytes()


async def test_another_calibration_begins_anew_and_is_no_fault(unit: Unit, warnings: list[str]) -> None:
    assert await unit.told_after_days(0.02) is not None
    for other in (
        replace(CALIBRATION, created=CALIBRATION.created + timedelta(seconds=1)),
        replace(CALIBRATION, unit_serial="TEST-2"),
        evidence.calibration(
            evidence.target("front"), replace(evidence.target("rear"), leds_px=np.full((4, 2), 9.5))
        ),
    ):
        assert await unit.run((0.2, FIRST + timedelta(days=12)), calibration=other) == ""
        assert unit.days() == 1
    assert warnings == []


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
    """One warning that names the file; then it is written anew and good."""
    tomorrow = FIRST + timedelta(days=1)
    assert await unit.run((0.0, tomorrow), (0.0, tomorrow)) == ""
    (warning,) = warnings
    assert warning.startswith(f"self-check history: begins anew: {unit.path}: ")
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


async def test_days_that_have_not_come_yet_count_as_the_last_ones(unit: Unit, warnings: list[str]) -> None:
    """A file of the future, and a clock that is set back by years while the daemon runs."""
    await unit.run((0.0, FIRST + timedelta(days=3000)))
    assert await unit.run((0.0, FIRST)) == ""
    assert unit.days() == 1
    assert len(warnings) == 1
    ahead, back = FIRST + timedelta(days=3001), FIRST + timedelta(days=1)
    await unit.run((0.0, ahead), (0.0, back))
    assert len(warnings) == 2
    assert unit.days() == 2
    assert json.loads(unit.path.read_bytes())["targets"]["front"]["today"]["number"] == (
        back.timestamp() // 86400
    )


@pytest.mark.parametrize("wrong_days", [1, 8])
async def test_a_clock_that_was_ahead_for_a_while_hides_no_drift(
    unit: Unit, warnings: list[str], wrong_days: int
) -> None:
    """After days of drift the clock is years ahead for some days, and then set."""
    told = await unit.told_after_days(0.02)
    assert told is not None
    for day in range(told + 1, told + 1 + wrong_days):
        await unit.run((0.02 * day, FIRST + timedelta(days=day + 3000)))
    last = told + wrong_days
    sentence = await unit.run((0.02 * last, FIRST + timedelta(days=last)))
    assert "front drifts by 0.0" in sentence
    assert len(warnings) == 1
    after = FIRST + timedelta(days=last + 1)
    assert "drifts" in await unit.run((0.02 * (last + 1), after))
    assert len(warnings) == 1
    assert unit.component.state is State.OK


async def test_a_clock_set_back_by_less_than_a_day_loses_nothing(unit: Unit, warnings: list[str]) -> None:
    later = [(0.0, FIRST + timedelta(days=day)) for day in range(4)]
    await unit.run(*later)
    await unit.run((0.0, FIRST + timedelta(days=2, hours=12)))
    assert unit.days() == 4
    assert warnings == []


async def test_a_clock_that_was_not_set_yet_neither_counts_nor_costs_the_history(unit: Unit) -> None:
    told = await unit.told_after_days(0.02)
    assert told is not None
    kept = unit.path.read_bytes()
    assert "drifts" in await unit.run((0.0, datetime(1970, 1, 1, 0, 1, tzinfo=UTC)))
    assert unit.path.read_bytes() == kept
    in_1970_and_now = (0.0, datetime(1970, 1, 1, tzinfo=UTC)), (0.2, FIRST + timedelta(days=told))
    assert "drifts" in await unit.run(*in_1970_and_now)


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
    reader, writer = os.pipe()  # reading hangs until somebody writes
    real = memory_of.read_file

    def hanging(path: Path, largest_bytes: int) -> bytes:
        os.read(reader, 1)
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
    os.write(writer, b"..")
    while unit.days() == 1:
        await memory.add(check(0.0), tomorrow)
        await memory.save()
    await memory.end()
    assert unit.days() == 2


FILLING = """
import asyncio, pathlib, sys
from test_memory import Unit, FIRST
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
    mount = f"mount -t tmpfs -o size=64k tmpfs {tmp_path} && exec {sys.executable} - {tmp_path} {15 << 12}"
    done = subprocess.run(
        ["unshare", "-rm", "sh", "-c", mount],
        input=FILLING,
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | {"PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path])},
    )
    said = f"not kept: {tmp_path / NAME}: No space left on device"
    assert done.stdout == f"degraded {said} True ['recording', '{NAME}']\n", done.stderr
    assert done.stderr == f"self-check history: {said}\n"


async def knows_bad(unit: Unit, calibration: Calibration = CALIBRATION) -> bool:
    """What a daemon that starts now knows of the last verdict."""
    memory = CheckMemory(calibration, unit.clock)
    memory.keep_in(unit.path, unit.component)
    was_bad = await memory.was_bad()
    await memory.end()
    return was_bad


@pytest.mark.parametrize("time", [FIRST, None, datetime(1970, 1, 1, tzinfo=UTC)], ids=str)
async def test_a_bad_verdict_is_known_at_the_next_start_whatever_the_clock_said(
    unit: Unit, time: datetime | None, warnings: list[str]
) -> None:
    """It is written at once, though the history was written a moment ago, and so is its end."""
    assert not await knows_bad(unit)
    memory = CheckMemory(CALIBRATION, unit.clock)
    memory.keep_in(unit.path, unit.component)
    await memory.add(check(0.0), FIRST)
    await memory.save()
    for verdict, is_bad in (
        (Verdict.BAD, True),
        (Verdict.UNKNOWN, True),
        (Verdict.SUSPECT, False),
        (Verdict.BAD, True),
        (Verdict.GOOD, False),
        (Verdict.BAD, True),
    ):
        await memory.add(check(0.0, verdict), time)
        await memory.save()
        assert await knows_bad(unit) is is_bad
    await memory.end()
    other = replace(CALIBRATION, created=CALIBRATION.created + timedelta(seconds=1))
    assert not await knows_bad(unit, other)
    assert warnings == []


async def test_a_check_without_a_verdict_is_none(unit: Unit) -> None:
    memory = CheckMemory(CALIBRATION, unit.clock)
    memory.keep_in(unit.path, unit.component)
    await memory.add(check(1.0, Verdict.UNKNOWN), FIRST)
    await memory.add(check(1.0), None)
    await memory.save()
    await memory.end()
    assert not unit.path.exists()
