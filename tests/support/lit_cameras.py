"""Cameras and frame LEDs on a test's clock: what a frame shows depends on when it was exposed."""

import numpy as np

from altd.acquisition.lamps.controller import FrameLamps
from altd.acquisition.self_check.frames import MarkedFrames
from altd.ports import LampsError
from altd.records import Frame
from altd.status.health import Health
from support.clock import FakeClock, settle

PERIOD_S = 0.05
CAMERAS = ("front", "rear")
DARK = np.zeros((8, 8), np.uint8)
LIT = np.full((8, 8), 200, np.uint8)


class Leds:
    """LEDs that switch at once; ``refuses`` makes them fail."""

    def __init__(self) -> None:
        self.lit = False
        self.refuses = ""
        self.switched: list[bool] = []

    def open(self) -> None:
        self.lit = False

    def switch(self, on: bool) -> None:
        if self.refuses:
            raise LampsError(self.refuses)
        if on is not self.lit:
            self.switched.append(on)
        self.lit = on

    def close(self) -> None:
        self.lit = False


class QuickLamps(FrameLamps):
    """The daemon's side of the LEDs without a thread, which would not know the test's clock."""

    def __init__(self, leds: Leds, clock: FakeClock) -> None:
        super().__init__(leds, Health(clock).component("lamps"), clock)
        self.leds = leds
        self.lost = ""

    @property
    def complaint(self) -> str:
        return self.lost

    async def apply(self, setpoint: bool) -> None:
        self.leds.switch(setpoint)

    def request(self, setpoint: bool) -> None:
        self.leds.lit = setpoint


class LitCameras:
    """Two cameras at 20 exposures a second; a frame comes 5 ms after its middle."""

    def __init__(self, clock: FakeClock, leds: Leds) -> None:
        self.clock = clock
        self.leds = leds
        self.sequence = 0
        self.silent: set[str] = set()
        self.changing: set[int] = set()
        self.exposure_ms = 2.0
        self.marked: list[Frame] = []

    async def expose(self, marks: MarkedFrames, count: int = 1) -> None:
        """Let so many exposures pass, and have their frames marked."""
        for _ in range(count):
            await self.clock.advance(PERIOD_S - 0.005)
            t_ns, lit = self.clock.monotonic_ns(), self.leds.lit
            await self.clock.advance(0.005)
            for camera in CAMERAS:
                if camera not in self.silent:
                    pixels = LIT if lit else DARK
                    changing = self.sequence in self.changing
                    frame = Frame(
                        camera, self.sequence, t_ns, pixels, exposure_ms=self.exposure_ms, changing=changing
                    )
                    self.marked.append(marks.mark(frame))
            self.sequence += 1
            await settle()
