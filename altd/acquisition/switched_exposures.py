"""Exposures with the frame LEDs off and on in turn, none of them while they were being switched."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import AsyncGenerator
from dataclasses import replace

from altd.acquisition.frame_sets import FrameSets
from altd.measuring.pairing import Pair
from altd.ports import Lamps
from altd.records import Frame

_SETTLE_S = 0.05
"""The driver has switched; the LED's light and a slow line follow."""


async def switched_exposures(sets: FrameSets, lamps: Lamps) -> AsyncGenerator[Pair[Frame], None]:
    """One complete exposure with the LEDs off, one with them on, and so on; the LEDs are dark at the end.

    To be closed by the caller (``contextlib.aclosing``). Raises LampsError, CameraError when a camera is
    at its end or delivers nothing, and a driver's own failure.
    """
    await sets.after(sets.clock.monotonic_ns(), 1)  # a camera must be open before its output can be switched
    try:
        await asyncio.to_thread(lamps.open)
        for on in itertools.cycle((False, True)):
            await asyncio.to_thread(lamps.switch, on)
            await sets.clock.sleep(_SETTLE_S)
            for pair in await sets.after(sets.clock.monotonic_ns(), 1):
                frames = {name: replace(frame, leds_on=on) for name, frame in pair.items.items()}
                yield replace(pair, items=frames)
    finally:
        await asyncio.shield(asyncio.to_thread(lamps.close))
