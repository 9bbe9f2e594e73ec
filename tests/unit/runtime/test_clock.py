"""The time of day of instants of the monotonic clock."""

import time
from datetime import UTC, datetime, timedelta

from altd.runtime.clock import SystemClock


def test_an_instant_ten_days_ago_has_the_time_of_day_of_then() -> None:
    clock, ago = SystemClock(), timedelta(days=10)
    before = datetime.now(UTC)
    found = clock.utc(time.monotonic_ns() - int(ago.total_seconds()) * 10**9)
    assert abs(found + ago - before) < timedelta(seconds=60)
