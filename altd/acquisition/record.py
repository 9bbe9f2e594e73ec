"""Records every exposure of all cameras for replay, paired as the measurement would pair them."""

from __future__ import annotations

import asyncio
import itertools
import math
from collections.abc import AsyncGenerator, Callable
from contextlib import aclosing
from dataclasses import replace
from pathlib import Path

from altd.acquisition.exposures_writer import FPS, ExposuresWriter, RecordingPlan
from altd.acquisition.frame_sets import FrameSets
from altd.measuring.pairing import Pair
from altd.ports import Lamps
from altd.records import Frame

_SETTLE_S = 0.05
"""Time from the driver's switching to settled light: the LED and a slow line follow with a delay."""


async def switched_exposures(sets: FrameSets, lamps: Lamps) -> AsyncGenerator[Pair[Frame], None]:
    """Yield complete exposures with the LEDs off and on in turn; the LEDs are dark at the end.

    The caller must close the generator (``contextlib.aclosing``). Raises LampsError, CameraError if a
    camera's source ends or delivers nothing, and a driver's own failure.
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


async def record(
    sets: FrameSets,
    path: Path,
    plan: RecordingPlan,
    progress: Callable[[int, int], None] = lambda done, planned: None,
    lamps: Lamps | None = None,
) -> int:
    """Write a recording of the cameras' frame sets; return the number of exposures.

    Ends after ``plan.seconds`` of exposures, at the end of all sources, or on cancellation; the exposures
    written so far are complete. Exposures during a change of a camera's exposure are not kept. ``progress``
    is called after each exposure with the number kept and the number planned. Raises BadInputError if the
    folder cannot be used, CameraError for a camera that cannot be opened at the start, and a driver's own
    failure; the recording waits for a camera that is lost later.

    With ``lamps`` the frame LEDs are switched off and on in turn, and only exposures between the switchings
    are kept. Then a lost camera raises CameraError, and lost lamps raise LampsError.
    """
    sink = ExposuresWriter(path, plan, {camera.name: camera for camera in sets.cameras}, sets.clock.utc)
    try:
        async with sets:
            if lamps is not None:
                async with aclosing(switched_exposures(sets, lamps)) as exposures:
                    async for pair in exposures:
                        sink.write(pair)
                        progress(sink.exposures, math.ceil(sink.exposures * plan.seconds / sink.length_s))
                        if sink.length_s >= plan.seconds:
                            break
                return sink.exposures
            while sink.length_s < plan.seconds and not sets.is_at_end:
                for pair in await sets.settled():
                    changing = any(frame.changing for frame in pair.all_items)
                    if sink.length_s < plan.seconds and not changing:
                        sink.write(pair)
                        progress(sink.exposures, round(plan.seconds * FPS))
            sets.check()
            return sink.exposures
    finally:
        sink.close()
