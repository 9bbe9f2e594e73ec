"""``altd record``: the cameras of a config, recorded."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from altd.acquisition.record import record
from altd.app.parts import cameras_of, exposure_controls_of
from altd.config import Config
from altd.recording.header import Kind, target_headers, unit_header
from altd.recording.writer import refuse_used_folder
from altd.runtime.clock import SystemClock
from altd.status.health import Health


async def record_of(
    config: Config,
    place: Path,
    folder: Path,
    seconds: float,
    kind: Kind,
    progress: Callable[[int, int], None] = lambda done, planned: None,
) -> int:
    """Record from the config's cameras into ``folder``; returns the number of exposures.

    ``progress`` is told after each of them how many of how many there are.
    """
    refuse_used_folder(folder)
    cameras = cameras_of(config, place)
    clock = SystemClock()
    return await record(
        list(cameras.values()),
        folder,
        unit_header(config.unit.serial, config.targets),
        config.measuring,
        Health(clock),
        clock.utc,
        seconds,
        kind,
        exposure=exposure_controls_of(config),
        progress=progress,
        targets=target_headers(config.targets),
    )
