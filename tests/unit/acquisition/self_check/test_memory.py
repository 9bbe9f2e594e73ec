"""The history of checks over restarts; each day is one process's life."""

import json
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from support import evidence
from support.remembered_checks import CALIBRATION, FIRST, Unit, check

from altd.acquisition.self_check.memory import CheckMemory
from altd.measuring.calibration import Calibration
from altd.selfcheck.records import Verdict
from altd.status.health import State


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


async def knows_bad(unit: Unit, calibration: Calibration = CALIBRATION) -> bool:
    """The last verdict, as a daemon that starts now knows it."""
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
