from __future__ import annotations

import asyncio
import contextlib
import os

import pytest

from hw_sim.demo_lines import Line


async def heard(descriptor: int, length: int) -> bytes:
    data = b""
    while len(data) < length:
        with contextlib.suppress(BlockingIOError):
            data += os.read(descriptor, 100)
        await asyncio.sleep(0.002)
    return data


async def test_a_line_carries_both_ways_and_keeps_nothing_for_who_comes_late() -> None:
    with Line() as line:
        forwarding = asyncio.create_task(line.forward())
        unit = os.open(line.unit_end, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        try:
            for round_ in (b"1", b"2"):
                os.write(unit, b"nobody hears " + round_)
                await asyncio.sleep(0.1)
                far = os.open(line.far_end, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
                await asyncio.sleep(0.1)
                os.write(unit, b"out " + round_)
                os.write(far, b"in " + round_)
                assert await heard(far, 5) == b"out " + round_
                assert await heard(unit, 4) == b"in " + round_
                os.write(unit, b"not read " + round_)
                await asyncio.sleep(0.1)
                os.close(far)
                await asyncio.sleep(0.1)
        finally:
            os.close(unit)
            forwarding.cancel()
            with pytest.raises(asyncio.CancelledError):
                await forwarding
