from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import pytest
from support.measurements import measured as measurement_of

from altd.app.daemon import Daemon
from altd.runtime.clock import SystemClock
from altd.status.health import Health
from hw_sim.demo_figures import Figures
from hw_sim.unit import Unit


@pytest.mark.parametrize(
    ("front", "rear", "measured", "dropped", "late", "lost"),
    [
        (100, 100, 100, 0, 0, 0),
        (101, 100, 100, 0, 0, 0),
        (100, 97, 100, 0, 0, 3),
        (99, 97, 100, 0, 0, 4),
        (99, 99, 99, 0, 0, 1),
        (100, 100, 100, 1, 0, 1),
        (100, 100, 99, 2, 0, 1),
        (100, 100, 100, 0, 1, 1),
    ],
    ids=["none", "one on its way", "rear", "each its own", "the same", "dropped", "both dropped", "late"],
)
async def test_a_pair_is_lost_once_however_its_frames_are(
    front: int, rear: int, measured: int, dropped: int, late: int, lost: int
) -> None:
    health = Health(SystemClock())
    health.component("camera front").count("frames", front)
    health.component("camera rear").count("frames", rear)
    health.component("measuring").count("dropped_front", dropped)
    health.component("measuring").count("late_frames", late)
    figures = Figures(cast("Daemon", SimpleNamespace(health=health)), cast("Unit", None))
    figures.take(measurement_of(None, sequence=99, frames=0), skipped=measured - 1)
    assert figures.pairs_lost == lost


async def test_frames_that_the_daemon_has_not_counted_yet_are_not_lost() -> None:
    health = Health(SystemClock())
    cameras = [health.component(f"camera {name}") for name in ("front", "rear")]
    figures = Figures(cast("Daemon", SimpleNamespace(health=health)), cast("Unit", None))
    shown = []
    for sequence in range(100):
        if sequence % 5 == 0:  # four times a second
            for camera in cameras:
                camera.count("frames", 5 if sequence else 1)
        figures.take(measurement_of(None, sequence=sequence, frames=0), skipped=0)
        shown.append(figures.pairs_lost)
    assert shown == [0] * 100
