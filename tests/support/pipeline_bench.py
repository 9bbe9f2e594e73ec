"""The pipeline between an inbox and a board, with a chain that a test controls and a clock that it drives."""

from __future__ import annotations

import asyncio

from altd.acquisition.inbox import Inbox
from altd.acquisition.pipeline import Pipeline
from altd.instruments.beam.quantities import QUANTITIES
from altd.reasons import Reason
from altd.records import Frame, Measurement
from altd.status.board import Board
from altd.status.health import Health
from support.clock import FakeClock
from support.frames import Blob, frame, light
from support.measurements import measurement

PIXELS = frame(light(Blob(300, 200))).pixels


def shot(camera: str, sequence: int, t_ns: int = 0) -> Frame:
    return Frame(camera, sequence, t_ns, PIXELS)


class Chain:
    """Stands in for the measuring chain: a measurement for every frame of the rear camera."""

    late_frames = 0

    def __init__(self) -> None:
        self.broken = False
        self.exposures = 0
        self.spot = "spot_missing"
        self.shift: dict[str, float | str] = {}

    def push(self, frame: Frame) -> list[Measurement]:
        if self.broken:
            raise ZeroDivisionError("a defect")
        return [measurement(frame.sequence, frame.t_ns)] if frame.camera == "rear" else []

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
        self.inbox = Inbox(("front", "rear"))
        self.chain = Chain()
        self.component = Health(self.clock).component("measuring")
        self.progress = 0
        self.pipeline = Pipeline(
            self.inbox,
            self.chain,  # type: ignore[arg-type]
            self.board,
            self.component,
            self.clock,
            0.4,
            self.count,
        )
        self.task = asyncio.create_task(self.pipeline.run())

    def count(self) -> None:
        self.progress += 1
