"""Thousands of hostile requests beside a poller; `make bench-hostile` sends 100,000."""

from __future__ import annotations

import pytest

from benchmarks.hostile_http import run

REQUESTS = 25_000


@pytest.mark.real_time
async def test_no_request_gets_more_than_the_contract_says_nor_in_the_way_of_a_poller() -> None:
    tally = await run(REQUESTS)
    assert tally.wrong == []
    assert tally.statuses.total() >= REQUESTS - 100
    assert {"200", "400", "401", "403", "404", "405", "415", "431"} <= set(tally.statuses), (
        "nothing was tried"
    )
    assert tally.polls > 100
    assert tally.slowest_poll_s < 2.0
