"""Keep frames for replay: every exposure of all cameras, paired as the measurement would pair them."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import aclosing
from pathlib import Path

from altd.acquisition.exposures_writer import FPS, ExposuresWriter, RecordingPlan
from altd.acquisition.frame_sets import FrameSets
from altd.acquisition.switched_exposures import switched_exposures
from altd.ports import Lamps


async def record(
    sets: FrameSets,
    path: Path,
    plan: RecordingPlan,
    progress: Callable[[int, int], None] = lambda done, planned: None,
    lamps: Lamps | None = None,
) -> int:
    """Write a recording of the cameras' frame sets; returns the number of exposures.

    Ends after ``plan.seconds`` of exposures, when all sources are at their end, or on cancellation; what was
    written until then is whole. What was exposed while a camera's exposure was being set is not kept.
    ``progress`` is told after each exposure how many of how many are kept. Raises BadInputError when the
    folder cannot be used, CameraError for a camera that cannot be opened at the beginning, and a driver's own
    failure; a camera that is lost later is waited for.

    ``lamps``: the frame LEDs are switched off and on in turn, and only exposures between are kept. Then a
    lost camera is a CameraError, and lost lamps are a LampsError.
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
                    changing = any(frame.changing for frame in pair.items.values())
                    if sink.length_s < plan.seconds and not changing:
                        sink.write(pair)
                        progress(sink.exposures, round(plan.seconds * FPS))
            sets.check()
            return sink.exposures
    finally:
        sink.close()
