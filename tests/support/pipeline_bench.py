"""The pipeline between frame sets and a board, with a chain that a test controls and a clock it drives."""

import asyncio

from altd.acquisition.frame_pairs import FramePairs
from altd.acquisition.locating import LocatedPairs
from altd.acquisition.pipeline import Pipeline
from altd.instruments.beam.instrument import QUANTITIES
from altd.measuring.pairing import Pair, Pairer
from altd.measuring.spot_locator import Located
from altd.reasons import Reason
from altd.records import Frame, Measurement
from altd.status.board import Board
from altd.status.health import Health
from support.clock import FakeClock
from support.located import located, paired
from support.measurements import measurement


class Chain:
    """Replaces the measuring chain: a measurement for every frame set with the rear camera."""

    silent_after_s = 0.4

    def __init__(self, pairer: Pairer[Frame]) -> None:
        self.pairer = pairer
        self.broken = False
        self.frame_sets = 0
        self.spot = "spot_missing"
        self.shift: dict[str, float | str] = {}

    def add(self, pair: Pair[Located]) -> Measurement | None:
        if self.broken:
            raise ZeroDivisionError("a defect")
        return measurement(pair.sequence, pair.t_ns) if "rear" in pair.items else None

    def silence(self, t_ns: int) -> Measurement:
        return measurement(0, t_ns, Reason.CAMERA_SILENT)

    def seen(self) -> str:
        return f"front: {self.spot}"

    def figures(self) -> dict[str, float | str | None]:
        return {"skew_ms": 0.25, **self.shift}


class Bench:
    """A pipeline with its surroundings."""

    def __init__(self) -> None:
        self.clock = FakeClock()
        self.board = Board(self.clock, 1.0, QUANTITIES)
        pairer: Pairer[Frame] = Pairer(("front", "rear"), "sequence", 10_000_000, 30_000_000)
        self.pairs = FramePairs(pairer, lambda: None, self.clock)
        self.located = LocatedPairs(self.pairs)
        self.chain = Chain(pairer)
        self.component = Health(self.clock).component("measuring")
        self.progress = 0
        self.pipeline = Pipeline(
            self.located,
            self.chain,  # type: ignore[arg-type]  # it replaces one
            self.board,
            self.component,
            self.count,
        )
        self.task = asyncio.create_task(self.pipeline.run())

    def count(self) -> None:
        self.progress += 1

    def put(self, *cameras: str, sequence: int) -> None:
        """Frames of one exposure come, and are located at once."""
        t_ns = self.pairs.delivered_ns = self.clock.monotonic_ns()
        self.located.put(paired(*(located(camera, sequence, t_ns) for camera in cameras)))
