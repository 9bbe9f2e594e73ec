"""The unit's cameras behind ``altd.ports.Camera``: one schedule of frame sets, two readers."""

import threading
import time
from typing import Protocol

from altd.ports import CameraError, CameraTimeoutError, ExposureRange
from altd.records import CameraIdentity, Frame, Origin
from hw_sim.unit import CAMERAS, Unit

EXPOSURE_RANGE = ExposureRange(0.02, 40.0, 0.0, 24.0)
_REMEMBERED = 8


class Schedule:
    """Exposure times of the frame sets: number k at ``start + k`` periods, the same for every camera.

    In real time the schedule starts at the first ``begin``; otherwise at 0, on its own clock.
    """

    def __init__(self, period_ns: int, *, real_time: bool) -> None:
        self._period_ns = period_ns
        self._real_time = real_time
        self._start_ns = 0
        self._begun = not real_time
        self._lock = threading.Lock()

    def begin(self) -> None:
        """Start the schedule unless another camera has started it."""
        with self._lock:
            if not self._begun:
                self._start_ns = time.monotonic_ns()
                self._begun = True

    def time_ns(self, sequence: int) -> int:
        """Middle of a frame set's exposure."""
        return self._start_ns + sequence * self._period_ns

    def due(self, after: int, lag_ns: int) -> tuple[int, int]:
        """The frame set to deliver next to a reader at ``after``, and the time until it is complete, ns.

        In real time it is the newest complete frame set, otherwise the next one.
        """
        if not self._real_time:
            return after + 1, 0
        passed_ns = time.monotonic_ns() - self._start_ns - lag_ns
        newest = passed_ns // self._period_ns
        if newest > after:
            return newest, 0
        return after + 1, (after + 1) * self._period_ns - passed_ns


class RealTimeLamps:
    """The frame LEDs of a unit whose cameras run in real time; see ``altd.ports.Lamps``."""

    def __init__(self) -> None:
        self._switched: tuple[tuple[int, bool], ...] = ((0, False),)

    def open(self) -> None:
        """Switch the LEDs off."""
        self.switch(False)

    def switch(self, on: bool) -> None:
        """Switch the LEDs on or off, for all later exposures."""
        self._switched = (*self._switched[-_REMEMBERED:], (time.monotonic_ns(), on))

    def close(self) -> None:
        """Switch the LEDs off."""
        self.switch(False)

    def lit_at(self, t_ns: int) -> bool:
        """State at ``t_ns``; a frame may be rendered after the LEDs were switched again."""
        return next((on for since_ns, on in reversed(self._switched) if since_ns <= t_ns), False)


class Scene(Protocol):
    """Source of the cameras' frames, by camera name; implemented by ``Unit`` and ``LiveRow``."""

    @property
    def serial(self) -> str:
        """Serial number of the unit."""

    def lag_ns(self, camera: str) -> int:
        """Delay of a camera relative to the schedule."""

    def is_silent(self, camera: str) -> bool:
        """Whether a camera delivers nothing."""

    def drops(self, camera: str, sequence: int) -> bool:
        """Whether a camera loses this frame."""

    def switch_leds(self, camera: str, on: bool) -> None:
        """Switch the frame LEDs in the view of a camera on or off."""

    def set_camera(self, camera: str, *, exposure_ms: float | None = None, gain: float | None = None) -> None:
        """Set exposure time or gain from the next frame on."""

    def expose(self, camera: str, sequence: int, t_ns: int) -> Frame:
        """Frame of a camera."""


class SimulatedCamera:
    """One camera of a simulated unit; see ``altd.ports.Camera``."""

    def __init__(
        self, unit: Scene, name: str, schedule: Schedule, waits: bool, lamps: RealTimeLamps | None = None
    ) -> None:
        self._unit = unit
        self._lamps = lamps
        self._name = name
        self._schedule = schedule
        self._waits = waits
        self._closed = threading.Event()
        self._closed.set()
        self._last = -1

    @property
    def name(self) -> str:
        """Name of the camera and of its target."""
        return self._name

    @property
    def origin(self) -> Origin:
        """Origin of the frames, always simulated; every output reports it."""
        return Origin.SIMULATED

    @property
    def playback(self) -> bool:
        """Whether frames are played back; here they are computed live."""
        return False

    @property
    def identity(self) -> CameraIdentity:
        """Identity of one camera of one simulated unit."""
        return CameraIdentity(f"{self._unit.serial}-{self._name}", "simulated", "hw_sim")

    @property
    def waits(self) -> bool:
        """Whether frames wait until they are fetched; false in real time."""
        return self._waits

    @property
    def exposure_range(self) -> ExposureRange:
        """Exposure and gain ranges of an ordinary sensor."""
        return EXPOSURE_RANGE

    def open(self) -> None:
        """Open the camera; the schedule continues."""
        self._schedule.begin()
        self._closed.clear()

    def next_frame(self, timeout_s: float) -> Frame:
        """The newest frame not yet delivered, rendered during this call."""
        deadline_ns = time.monotonic_ns() + round(timeout_s * 1e9)
        while not self._closed.is_set():
            lag_ns = self._unit.lag_ns(self._name)
            sequence, wait_ns = self._schedule.due(self._last, lag_ns)
            left_ns = max(deadline_ns - time.monotonic_ns(), 0)
            if wait_ns > left_ns or self._unit.is_silent(self._name):
                self._closed.wait(left_ns * 1e-9)
                raise CameraTimeoutError(f"{self._name}: no frame within {timeout_s:g} s")
            if wait_ns > 0:
                self._closed.wait(wait_ns * 1e-9)
                continue
            self._last = sequence
            if not self._unit.drops(self._name, sequence):
                t_ns = self._schedule.time_ns(sequence) + lag_ns
                if self._lamps is not None:
                    self._unit.switch_leds(self._name, self._lamps.lit_at(t_ns))
                return self._unit.expose(self._name, sequence, t_ns)
        raise CameraError(f"{self._name}: the camera is not open")

    def set_exposure(self, exposure_ms: float, gain_db: float) -> None:
        """Set exposure time and gain from the next frame on."""
        self._unit.set_camera(self._name, exposure_ms=exposure_ms, gain=10.0 ** (gain_db / 20.0))

    def close(self) -> None:
        """Close the camera; a waiting ``next_frame`` ends."""
        self._closed.set()


def make_cameras(
    unit: Unit, *, real_time: bool = True, lamps: RealTimeLamps | None = None
) -> tuple[SimulatedCamera, ...]:
    """Cameras of a unit, front and rear, on one schedule; ``lamps`` switches its LEDs, in real time.

    In real time frame sets arrive at the unit's rate on ``time.monotonic_ns``, and a late caller gets the
    newest. Otherwise they are delivered as fast as they are fetched, none is skipped, and time starts at 0.
    """
    schedule = Schedule(unit.config.period_ns, real_time=real_time)
    return tuple(SimulatedCamera(unit, name, schedule, waits=not real_time, lamps=lamps) for name in CAMERAS)
