"""The pipeline between its slots and a board, with a chain that a test controls and a clock it drives."""

from __future__ import annotations

import asyncio

from altd.acquisition.buffers import Buffers
from altd.acquisition.latest_frames import LatestFrames
from altd.acquisition.latest_of_each import LatestOfEach
from altd.acquisition.pipeline import Pipeline
from altd.instruments.beam.quantities import QUANTITIES
from altd.measuring.spot_locator import Located
from altd.reasons import Reason
from altd.records import Measurement
from altd.status.board import Board
from altd.status.health import Health
from support.clock import FakeClock
from support.located import located
from support.measurements import measurement


class Chain:
    """Stands in for the measuring chain: a measurement for every frame of the rear camera."""

    silent_after_s = 0.4
    late_frames = 0
    awaits_partner = False

    def __init__(self) -> None:
        self.broken = False
        self.frame_sets = 0
        self.spot = "spot_missing"
        self.shift: dict[str, float | str] = {}

    def add(self, one: Located) -> list[Measurement]:
        if self.broken:
            raise ZeroDivisionError("a defect")
        return [measurement(one.sequence, one.t_ns)] if one.camera == "rear" else []

    def silence(self, t_ns: int) -> Measurement:
        return measurement(0, t_ns, Reason.CAMERA_SILENT)

    def seen(self) -> str:
        return f"front: {self.spot}"

    def step(self) -> dict[str, float]:
        return {"skew_ms": 0.25}

    def views(self) -> dict[str, float | str]:
        return self.shift


class Bench:
    """A pipeline with its surroundings."""

    def __init__(self) -> None:
        self.clock = FakeClock()
        self.board = Board(self.clock, 1.0, QUANTITIES)
        self.located = LatestOfEach[Located](("front", "rear"), self.clock)
        self.frames = LatestFrames(("front", "rear"))
        self.chain = Chain()
        self.component = Health(self.clock).component("measuring")
        self.progress = 0
        self.pipeline = Pipeline(
            Buffers(self.frames, self.located),
            self.chain,  # type: ignore[arg-type]  # it stands in for one
            self.board,
            self.component,
            self.count,
        )
        self.task = asyncio.create_task(self.pipeline.run())

    def count(self) -> None:
        self.progress += 1

    def put(self, camera: str, sequence: int) -> None:
        self.located.put(located(camera, sequence, self.clock.monotonic_ns()), wait=False)
