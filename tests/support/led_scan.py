"""A scan without a table and without a simulator: frames drawn by hand, their LEDs lit as the lamps are."""

import functools
import itertools
import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np

from altd.config import Config
from altd.ports import LampsError
from altd.records import CameraIdentity, Frame, Origin, PixelArray
from support.clock import FakeClock
from support.led_frames import Scene
from support.unit_toml import TARGETS

PERIOD_S = 0.05
_VARIANTS = 16
"""As many pictures of each light, one after the other: no two of a check are the same."""


@functools.cache
def _pictures(name: str, scene: Scene) -> dict[bool, list[PixelArray]]:
    """By whether the LEDs are lit."""
    view = scene.view(np.random.default_rng(ord(name[0])), pairs=_VARIANTS)
    return {on: [frame.pixels for frame in frames] for on, frames in ((True, view.lit), (False, view.dark))}


def scan_settings(calibration: Path, **scan: object) -> Config:
    """A grid of 4 × 4 nodes with one exposure each, and two LED pairs."""
    camera = {"driver": "v4l2", "device": "/dev/video9", "fps": 20}
    grid = {"columns": 4, "rows": 4, "exposures": 1, "settle_s": 0, "led_pairs": 2}
    return Config.model_validate(
        {
            "unit": {"serial": "TEST-1", "calibration": calibration},
            "targets": TARGETS,
            "cameras": {"front": camera, "rear": camera},
            "measuring": {"pair_by": "sequence", "window": 4},
            "scan": {**grid, **scan},
        }
    )


class ScanLamps:
    """See ``altd.ports.Lamps``; ``refuses`` makes them fail."""

    def __init__(self) -> None:
        self.lit = False
        self.refuses = ""
        self.switched: list[bool] = []

    def open(self) -> None:
        if self.refuses:
            raise LampsError(self.refuses)

    def switch(self, on: bool) -> None:
        self.switched.append(on)
        self.lit = on

    def close(self) -> None:
        self.lit = False


class LedCamera:
    """A camera before a scene whose LEDs follow the lamps, 20 exposures a second of the test's clock."""

    origin = Origin.CAMERA
    playback = False
    waits = False
    exposure_range = None

    def __init__(
        self, name: str, scene: Scene, lamps: ScanLamps, clock: FakeClock, serial: str | None = None
    ) -> None:
        self.name = name
        self._clock = clock
        self._closed = threading.Event()
        self.identity = CameraIdentity(serial)
        self._lamps = lamps
        self._pictures = {on: itertools.cycle(of) for on, of in _pictures(name, scene).items()}
        self._number = -1

    def open(self) -> None: ...

    def next_frame(self, timeout_s: float) -> Frame:
        pixels = next(self._pictures[self._lamps.lit])  # as they were when the exposure began
        self._clock.wait(self._closed, PERIOD_S)
        self._number += 1
        return Frame(self.name, self._number, self._clock.monotonic_ns() - round(0.5e9 * PERIOD_S), pixels)

    def set_exposure(self, exposure_ms: float, gain_db: float) -> None: ...

    def close(self) -> None: ...


class StillStage:
    """See ``altd.ports.Stage``: it is where it was sent; ``at`` is called before each movement."""

    def __init__(self, at: Callable[[float, float], None] = lambda x_mm, y_mm: None) -> None:
        self._at = at
        self._place_mm = (0.0, 0.0)

    def open(self) -> None: ...

    def home(self) -> None: ...

    def move_to(self, x_mm: float, y_mm: float) -> None:
        self._at(x_mm, y_mm)
        self._place_mm = (x_mm, y_mm)

    def position(self) -> tuple[float, float]:
        return self._place_mm

    def stop(self) -> None: ...

    def close(self) -> None: ...


class Told:
    """See ``altd.acquisition.scan.scanner.ProgressReporter``."""

    def __init__(self) -> None:
        self.said: list[str] = []

    def report(self, line: str) -> None:
        self.said.append(line)

    def progress(self, done: int, total: int, doing: str) -> None: ...
