"""The daemon on large frames: what is measured of it is there, and a loop that stands still is seen."""

import asyncio
import time

import pytest

from benchmarks.frame_sizes import Ticker, make_large_material, measure_size


@pytest.mark.alone
def test_values_and_answers_come_from_frames_of_another_size() -> None:
    figures = measure_size(make_large_material(1504, 960, 8), 2.0)
    assert (figures.width, figures.height) == (1504, 960)
    assert figures.pairs >= 30
    assert figures.modbus.count >= 50
    assert figures.stalls.count >= 100  # one a millisecond on an idle machine
    assert 0 < figures.modbus.p50_ms <= figures.modbus.p99_ms <= figures.modbus.max_ms


async def test_a_loop_that_stands_still_for_30_ms_comes_so_late() -> None:
    with Ticker() as ticker:
        await asyncio.sleep(0.01)
        time.sleep(0.03)  # noqa: ASYNC251  this is what is to be seen
        before = len(ticker.late_ns)
        while len(ticker.late_ns) < max(before + 1, 10):  # noqa: ASYNC110  a tick is no event
            await asyncio.sleep(0.005)
    assert 28e6 < max(ticker.late_ns) < 10e9
