"""Protocols of the unit's surroundings; drivers and simulators implement them."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum
from typing import Protocol, runtime_checkable

from altd.records import CameraIdentity, Frame, Origin
from altd.records.sensors import Quality


class CameraError(Exception):
    """A camera that cannot deliver; the service closes it, reports it and opens it again."""


class CameraNotFoundError(CameraError):
    """There is no such camera now."""


class CameraBusyError(CameraError):
    """Another program holds the camera."""


class CameraLostError(CameraError):
    """The camera was there and went away, or broke off its stream."""


class CameraRefusedError(CameraError):
    """The camera does not do what it is asked for: a format, a size, a rate, a setting."""


class CameraTimeoutError(CameraError):
    """No frame came in time; the camera stays open."""


class CameraMistimedError(CameraError):
    """A frame arrived whose time of exposure is unknown; the camera stays open."""

    def __init__(self, sequence: int, sentence: str) -> None:
        super().__init__(sentence)
        self.sequence = sequence


class CameraEndedError(CameraError):
    """The source is at its end and will not deliver again (a recording that was played)."""


@dataclass(frozen=True, slots=True)
class ExposureRange:
    """The settable range of a camera. Without a settable gain, both gains are the same."""

    shortest_ms: float
    longest_ms: float
    smallest_gain_db: float
    largest_gain_db: float


class Camera(Protocol):
    """A source of frames. The calls block and are made from one thread that belongs to this camera."""

    @property
    def name(self) -> str:
        """The name under which the config and the frames know this camera."""

    @property
    def origin(self) -> Origin:
        """The origin of the frames; simulated ones are marked in every output.

        A camera may find out only when it is opened.
        """

    @property
    def playback(self) -> bool:
        """Whether the frames are those of a recording, of whatever origin; every output marks it."""

    @property
    def identity(self) -> CameraIdentity | None:
        """Which camera this is, known once open; None: the source cannot tell."""

    @property
    def waits(self) -> bool:
        """Whether the source waits until a frame was taken; otherwise an untaken frame is dropped."""

    @property
    def exposure_range(self) -> ExposureRange | None:
        """The ranges of exposure and gain, known once open; None: the camera can set neither."""

    def open(self) -> None:
        """Get hold of the camera and let it run as it was set up to; raises CameraError."""

    def next_frame(self, timeout_s: float) -> Frame:
        """The next frame, waiting at most ``timeout_s``; raises CameraError or one of its kinds."""

    def set_exposure(self, exposure_ms: float, gain_db: float) -> None:
        """Apply this from one of the next frames on, as nearly as the camera can; raises CameraError."""

    def close(self) -> None:
        """Release the camera; harmless when it is not open."""


@runtime_checkable
class SwitchingCamera(Camera, Protocol):
    """A camera with output lines, on which LEDs may hang."""

    def switch_output(self, line: str, on: bool) -> None:
        """Set an output line, by the camera's own name of it; raises CameraError, also while it is not open.

        Blocks, and unlike the other calls comes from any thread.
        """


@runtime_checkable
class TemperatureCamera(Camera, Protocol):
    """A camera that may measure its own temperature."""

    def celsius(self) -> float | None:
        """The temperature inside now, °C; None: it measures none. Raises CameraError, also while it is shut.

        Blocks, and unlike the other calls comes from any thread.
        """


class StageError(Exception):
    """A stage that did not do what it was asked to; the sentence says why."""


class StageNotFoundError(StageError):
    """There is no such port, or nothing on it that answers."""


class StageLostError(StageError):
    """The stage went away or restarted: its position is unknown."""


class StageAlarmError(StageError):
    """The stage's controller locked itself, for a limit for instance."""


class StageTimeoutError(StageError):
    """The stage is there but does not answer, or does not move."""


class StageRefusedError(StageError):
    """The stage's controller does not take a command, or its settings do not do."""


class StageStoppedError(StageError):
    """``stop`` was called."""


class Stage(Protocol):
    """An xy stage that carries the laser; x and y are those of the unit frame, mm.

    The calls block and are made one after the other; ``stop`` alone comes from another thread.
    """

    def open(self) -> None:
        """Get hold of the stage; raises StageError."""

    def home(self) -> None:
        """Make the position known in the way that is set up for this stage; raises StageError."""

    def move_to(self, x_mm: float, y_mm: float) -> None:
        """Move there and return once the stage is at rest there; raises StageError."""

    def position(self) -> tuple[float, float]:
        """The position that the stage reports, (x, y) in mm; raises StageError."""

    def stop(self) -> None:
        """End a movement that is under way; it and every later one raise StageStoppedError."""

    def close(self) -> None:
        """Release the stage; harmless when it is not open."""


class InclinometerError(Exception):
    """An inclinometer that gives no reading; the sentence says why, and ``quality`` in one word."""

    quality = Quality.DEFECT


class InclinometerNotFoundError(InclinometerError):
    """There is no such port, or it went away."""

    quality = Quality.NO_PORT


class InclinometerTimeoutError(InclinometerError):
    """Nothing answers in time."""

    quality = Quality.NO_ANSWER


class InclinometerDisturbedError(InclinometerError):
    """The received bytes are no answer to the request: damaged, foreign, too long, or the request itself."""

    quality = Quality.BAD_ANSWER


class InclinometerWrongError(InclinometerError):
    """The answering device is not the expected sensor, or is set up differently."""

    quality = Quality.WRONG_SENSOR


class InclinometerRefusedError(InclinometerError):
    """The sensor says that it cannot measure as it is set up."""

    quality = Quality.INVALID_SETTING


@dataclass(frozen=True, slots=True)
class InclinometerAccuracy:
    """The maker's specification: limits of error, ±, in degrees, and the temperatures at which they hold.

    ``cross_axis_deg`` is the error from a tilt about the other axis, ``step_deg`` the last digit.
    """

    limit_deg: float
    from_c: float
    to_c: float
    limit_elsewhere_deg: float
    cross_axis_deg: float
    step_deg: float


@dataclass(frozen=True, slots=True)
class InclinometerReading:
    """One reading: angles against gravity in the sensor's own sense, within ±180°; None: it has no such axis.

    ``t_ns`` is when it was measured at the earliest, on the monotonic clock. ``words`` are all registers that
    were read, as they came: what measures moves their last digits.
    """

    t_ns: int
    roll_deg: float
    pitch_deg: float | None
    temperature_c: float
    words: tuple[int, ...]


class Inclinometer(Protocol):
    """A sensor of inclination. The calls block and are made from one thread."""

    @property
    def name(self) -> str:
        """Its type and address, for people."""

    @property
    def accuracy(self) -> InclinometerAccuracy:
        """The accuracy of its angles."""

    def open(self) -> None:
        """Open the port and check that it is this sensor; raises InclinometerError."""

    def read(self) -> InclinometerReading:
        """The current reading; raises InclinometerError."""

    def close(self) -> None:
        """Release the port; harmless when it is not open."""


class LampsError(Exception):
    """Lamps that cannot be had or switched; the sentence says why."""


class Lamps(Protocol):
    """The frame LEDs. The calls block."""

    def open(self) -> None:
        """Get hold of them, dark; raises LampsError."""

    def switch(self, on: bool) -> None:
        """Light or darken all of them; raises LampsError."""

    def close(self) -> None:
        """Darken and release them; harmless when they are not open."""


class Switches(Protocol):
    """The voltage of switched glasses: with it a glass is clear, without it opaque. The calls block."""

    def open(self) -> None:
        """Get hold of them, all glasses without voltage; raises LampsError."""

    def show(self, opaque: str) -> None:
        """Take the voltage off the glass of this target, and apply it to all others; raises LampsError.

        Empty: no glass has it.
        """

    def close(self) -> None:
        """Take the voltage off all glasses and release them; harmless when they are not open."""


class Indicator(StrEnum):
    """The lamps on the housing (App. A.1.4)."""

    DATA = "data"
    ERROR = "error"
    POWER = "power"
    OK = "ok"


class Indicators(Protocol):
    """The lamps on the housing. The calls block."""

    def open(self) -> None:
        """Get hold of them, dark; raises LampsError."""

    def show(self, lit: frozenset[Indicator]) -> None:
        """Light these and darken the others; raises LampsError."""

    def close(self) -> None:
        """Darken and release them; harmless when they are not open."""


class ThermometerError(Exception):
    """A temperature that cannot be read; the sentence says why."""


class Thermometer(Protocol):
    """A temperature of the unit."""

    @property
    def name(self) -> str:
        """The name under which the config knows it."""

    def celsius(self) -> float | None:
        """The temperature now, °C; blocks. None: none is available, and that is no fault of its own.

        Raises ThermometerError.
        """


class Stop(Protocol):
    """An event of ``threading`` that tells a thread to end."""

    def wait(self, timeout: float) -> bool:
        """Block until it is set, or for ``timeout`` seconds; returns whether it is set."""

    def is_set(self) -> bool:
        """Whether it is set."""


class Clock(Protocol):
    """Time, so that a test can run an hour in a second."""

    def monotonic_ns(self) -> int:
        """The clock on which frames are stamped."""

    def utc(self, t_ns: int) -> datetime | None:
        """The UTC of an instant on the monotonic clock; None when it is not known."""

    async def sleep(self, seconds: float) -> None:
        """Let ``seconds`` pass on this clock."""

    def wait(self, stop: Stop, seconds: float) -> None:
        """Block a thread until ``seconds`` have passed on this clock, or until ``stop`` is set."""
