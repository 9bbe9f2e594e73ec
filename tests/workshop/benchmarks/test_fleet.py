"""The benchmarks of the fleet find all that was sent, and its demo shows units that fail."""

import asyncio
import signal

import psycopg
import pytest
from support.cli import Outcome, altd
from support.fleet import postgresql
from support.foreign import need, need_program

from altd.fleet.database import migrate
from benchmarks import demo_fleet
from benchmarks.postgresql import programs


def measured(module: str, *arguments: str) -> Outcome:
    need(programs() is not None, "PostgreSQL is not installed (Debian package postgresql)")
    need_program("mosquitto")
    return altd(*arguments, module=module)


def test_no_row_is_lost_or_twice() -> None:
    outcome = measured(
        "benchmarks.fleet",
        *["--units", "20", "--hz", "3", "--seconds", "3", "--backlog", "3000", "--backlog-units", "4"],
    )
    assert outcome.status == 0, outcome
    assert "live: 20 units, 60 rows a second, 3 s" in outcome.out
    assert "  rows 180, lost 0, twice 0" in outcome.out
    assert "backlog: 3000 rows of 4 units" in outcome.out


def test_twenty_units_are_shown() -> None:
    outcome = measured("benchmarks.demo_fleet", "--seconds", "20")
    assert outcome.status == 0, outcome
    assert outcome.out.rpartition("unit")[2].count("ALT-00") >= 19, outcome.out


async def test_the_demo_waits_for_a_database_that_restarts(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(demo_fleet, "_SHOWN_EVERY_S", 0.05)

    async def shown(text: str) -> None:
        async with asyncio.timeout(60):
            while text not in capsys.readouterr().out:
                assert not showing.done(), showing.exception()
                await asyncio.sleep(0.01)

    with postgresql() as cluster:
        connection = cluster.new_database()
        with psycopg.connect(connection) as opened:
            migrate(opened)
        showing = asyncio.create_task(demo_fleet.show_units(connection))
        await shown("newest")
        cluster.stop(signal.SIGINT)
        await shown("database.connection: ")
        cluster.start()
        await shown("newest")
        showing.cancel()
