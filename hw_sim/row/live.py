"""A row in real time: its cameras and the switches of its glasses, behind altd's ports."""

import threading
import time
from dataclasses import replace

from altd.records import Frame
from hw_sim.camera import Schedule, SimulatedCamera
from hw_sim.row.row import FPS, Row

EXPOSURE_MS = 2.0
"""Exposure time stated in the frames; the rendered light is that at its middle."""


class LiveRow:
    """Scene of the cameras, see ``hw_sim.camera.Scene``, and its ``altd.ports.Switches``."""

    def __init__(self, row: Row) -> None:
        self.row = row
        self.serial = row.config.serial
        self._start_ns = time.monotonic_ns()
        self._lock = threading.Lock()
        self.silent = frozenset[str]()
        """Names of cameras that deliver nothing."""

    def t_s(self, t_ns: int) -> float:
        """Time of the row at an instant of the monotonic clock."""
        return (t_ns - self._start_ns) * 1e-9

    def cameras(self) -> dict[str, SimulatedCamera]:
        """Cameras on one schedule, by the names of their targets."""
        schedule = Schedule(round(1e9 / FPS), real_time=True)
        return {name: SimulatedCamera(self, name, schedule, waits=False) for name in self.row.config.names}

    def stick(self, target: str, state: str) -> None:
        """Hold the glass of a target ``opaque`` or ``clear`` from now on; empty: it follows its switch."""
        with self._lock:
            glass = self.row.glasses[target]
            glass.config = replace(glass.config, stuck=state)

    def lag_ns(self, camera: str) -> int:
        """Delay of a camera: always 0."""
        return 0

    def is_silent(self, camera: str) -> bool:
        """Whether the camera is in ``silent``."""
        return camera in self.silent

    def drops(self, camera: str, sequence: int) -> bool:
        """Whether a frame is lost: never."""
        return False

    def switch_leds(self, camera: str, on: bool) -> None:
        """Do nothing: a row has no LEDs."""

    def set_camera(self, camera: str, *, exposure_ms: float | None = None, gain: float | None = None) -> None:
        """Do nothing: the exposure is fixed."""

    def expose(self, camera: str, sequence: int, t_ns: int) -> Frame:
        """Frame of a target's camera."""
        with self._lock:
            pixels = self.row.expose(camera, self.t_s(t_ns))
        return Frame(camera, sequence, t_ns, pixels, exposure_ms=EXPOSURE_MS)

    def open(self) -> None:
        """Remove the voltage from all glasses."""
        self.show("")

    def show(self, opaque: str) -> None:
        """Apply voltage to all glasses except this one; none if ``opaque`` is empty."""
        with self._lock:
            t_s = self.t_s(time.monotonic_ns())
            for name, glass in self.row.glasses.items():
                glass.switch(not opaque or name == opaque, t_s)

    def close(self) -> None:
        """Remove the voltage from all glasses."""
        self.show("")
