"""Thousands of hostile inputs at each interface beside its readers; `make bench-hostile`: 100,000 at each."""

import pytest
from fuzz.hostile.runner import run

pytestmark = pytest.mark.real_time

INPUTS = {"http": 4_000, "websocket": 1_500, "local": 1_500, "modbus": 2_000, "console": 500, "mqtt": 1_500}
TRIED = {
    "http": {"200", "400", "401", "403", "404", "405", "415", "431"},
    "websocket": {"400", "404", "426", "431", "close 1003", "close 1009", "cut", "open"},
    "local": {"200", "400", "403", "404", "405", "431"},
    "modbus": {"answered", "garbled", "silent"},
    "console": {"shown"},
    "mqtt": {"packets", "connections ended"},
}


@pytest.mark.parametrize("face", INPUTS)
async def test_nothing_gets_more_than_the_contract_says_nor_in_the_way_of_who_reads(face: str) -> None:
    tally = await run(face, INPUTS[face])
    assert tally.wrong == []
    assert tally.answers.total() >= INPUTS[face] - 100
    assert set(tally.answers) >= TRIED[face], "nothing was tried"
    assert tally.polls > 5
    assert tally.slowest_poll_s < 2.0
    assert tally.memory_mb[1] < tally.memory_mb[0] + 60
    if face == "websocket":
        assert tally.pictures > 50
