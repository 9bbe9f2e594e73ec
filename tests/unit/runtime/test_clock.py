"""The time of day of instants of the monotonic clock."""

import time
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from altd.runtime.clock import SystemClock, time_zone


def test_an_instant_ten_days_ago_has_the_time_of_day_of_then() -> None:
    clock, ago = SystemClock(), timedelta(days=10)
    before = datetime.now(UTC)
    found = clock.utc(time.monotonic_ns() - int(ago.total_seconds()) * 10**9)
    assert abs(found + ago - before) < timedelta(seconds=60)


@pytest.mark.parametrize(
    "suspended_ns", [(7_000_000, 0), (3_000_000, 5_000_000, 400), (*10 * (9_000_000,), 0)]
)
def test_a_thread_suspended_between_its_clocks_reads_them_again(
    monkeypatch: pytest.MonkeyPatch, suspended_ns: tuple[int, ...]
) -> None:
    """At most ten times: after that the best one counts, wrong by half of what it took."""
    now_ns, pauses = 5 * 10**9, iter(suspended_ns)

    def utc_ns() -> int:
        nonlocal now_ns
        then, now_ns = now_ns, now_ns + next(pauses)
        return 1_800_000_000 * 10**9 + then

    monkeypatch.setattr("altd.runtime.clock.time.monotonic_ns", lambda: now_ns)
    monkeypatch.setattr("altd.runtime.clock.time.time_ns", utc_ns)
    wrong = SystemClock().utc(10**9) - datetime.fromtimestamp(1_800_000_001, UTC)
    assert abs(wrong) <= timedelta(microseconds=1 if len(suspended_ns) < 10 else 4500)


@pytest.mark.parametrize(
    ("to", "zone"),
    [
        ("/usr/share/zoneinfo/Europe/Berlin", "Europe/Berlin"),
        ("../usr/share/zoneinfo/America/Argentina/Ushuaia", "America/Argentina/Ushuaia"),
        ("/usr/share/zoneinfo/Etc/UTC", ""),
        ("/usr/share/zoneinfo/UTC", ""),
        ("/elsewhere", ""),
    ],
)
def test_the_zone_is_that_of_the_link(tmp_path: Path, to: str, zone: str) -> None:
    (tmp_path / "localtime").symlink_to(to)
    assert time_zone(tmp_path / "localtime") == zone


def test_a_copied_or_missing_file_names_no_zone(tmp_path: Path) -> None:
    assert time_zone(tmp_path / "localtime") == ""
    (tmp_path / "localtime").write_bytes(b"TZif2")
    assert time_zone(tmp_path / "localtime") == ""
