"""Protocols of the unit's surroundings; drivers and simulators implement them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum
from typing import Protocol, runtime_checkable

from altd.records import CameraIdentity, Frame, Origin
from altd.records.sensors import Quality


class Device(Protocol):
    """A device that is opened before its other calls. The calls block; they raise the errors of its kind."""

    def open(self) -> None:
        """Open it; lamps are dark then, glasses without voltage."""

    def close(self) -> None:
        """Release it, dark or without voltage; harmless when it is not open."""


class CameraError(Exception):
    """The camera cannot deliver; the service closes it, reports it and opens it again."""


class CameraNotFoundError(CameraError):
    """There is no such camera now."""


class CameraBusyError(CameraError):
    """Another program uses the camera."""


class CameraLostError(CameraError):
    """The camera disappeared, or stopped its stream."""


class CameraRefusedError(CameraError):
    """The camera refuses a request: a format, a size, a rate, a setting."""


class CameraTimeoutError(CameraError):
    """No frame arrived in time; the camera stays open."""


class CameraMistimedError(CameraError):
    """A frame arrived whose time of exposure is unknown; the camera stays open."""

    def __init__(self, sequence: int, sentence: str) -> None:
        super().__init__(sentence)
        self.sequence = sequence


class CameraEndedError(CameraError):
    """The source has ended and will not deliver again (a recording that was played)."""


@dataclass(frozen=True, slots=True)
class ExposureRange:
    """Settable range of a camera. Without a settable gain, both gains are the same."""

    shortest_ms: float
    longest_ms: float
    smallest_gain_db: float
    largest_gain_db: float


class Camera(Device, Protocol):
    """A source of frames. The calls are made from one thread that belongs to this camera."""

    @property
    def name(self) -> str:
        """Name of this camera in the config and in the frames."""

    @property
    def origin(self) -> Origin:
        """Origin of the frames; simulated ones are marked in every output.

        A camera may determine it only when it is opened.
        """

    @property
    def playback(self) -> bool:
        """Whether the frames are those of a recording, of whatever origin; every output marks it."""

    @property
    def identity(self) -> CameraIdentity | None:
        """Identity of the camera, known once open; None: the source has none."""

    @property
    def waits(self) -> bool:
        """Whether the source waits until a frame was taken; otherwise an untaken frame is dropped."""

    @property
    def exposure_range(self) -> ExposureRange | None:
        """Ranges of exposure and gain, known once open; None: the camera can set neither."""

    def next_frame(self, timeout_s: float) -> Frame:
        """Return the next frame, waiting at most ``timeout_s``; raises CameraError or a subclass."""

    def set_exposure(self, exposure_ms: float, gain_db: float) -> None:
        """Apply exposure time and gain soon, as precisely as the camera can; raises CameraError."""


@runtime_checkable
class SwitchingCamera(Camera, Protocol):
    """A camera with output lines that may switch LEDs."""

    def switch_output(self, line: str, on: bool) -> None:
        """Set an output line, by the camera's own name of it; raises CameraError, also if not open.

        Blocks, and unlike the other calls is made from any thread.
        """


@runtime_checkable
class TemperatureCamera(Camera, Protocol):
    """A camera that may measure its own temperature."""

    def celsius(self) -> float | None:
        """Return the temperature inside, °C; None: not measured. Raises CameraError, also if not open.

        Blocks, and unlike the other calls is made from any thread.
        """


@runtime_checkable
class AutomaticCamera(Camera, Protocol):
    """A camera that may change its picture automatically."""

    @property
    def automatic(self) -> tuple[str, ...]:
        """Its own names of automatic modes that stay on although the config does not ask for them."""


class StageError(Exception):
    """The stage did not do what was requested; the message gives the reason."""


class StageNotFoundError(StageError):
    """There is no such port, or no stage answers on it."""


class StageLostError(StageError):
    """The stage disappeared or restarted: its position is unknown."""


class StageAlarmError(StageError):
    """The stage's controller locked itself, for example because of a limit."""


class StageTimeoutError(StageError):
    """The stage is there but does not answer, or does not move."""


class StageRefusedError(StageError):
    """The stage's controller refuses a command, or its settings are unsuitable."""


class StageStoppedError(StageError):
    """``stop`` was called."""


class Stage(Device, Protocol):
    """An xy stage that carries the laser; x and y are those of the unit frame, mm.

    The calls are made one after the other; only ``stop`` is called from another thread.
    """

    def home(self) -> None:
        """Determine the position in the way configured for this stage; raises StageError."""

    def move_to(self, x_mm: float, y_mm: float) -> None:
        """Move to a position and return once the stage is at rest there; raises StageError."""

    def position(self) -> tuple[float, float]:
        """Return the position that the stage reports, (x, y) in mm; raises StageError."""

    def stop(self) -> None:
        """Stop a movement in progress; it and every later one raise StageStoppedError."""


class InclinometerError(Exception):
    """The inclinometer gives no reading; the message gives the reason, ``quality`` its code."""

    quality = Quality.DEFECT


class InclinometerNotFoundError(InclinometerError):
    """There is no such port, or it disappeared."""

    quality = Quality.NO_PORT


class InclinometerTimeoutError(InclinometerError):
    """No device answers in time."""

    quality = Quality.NO_ANSWER


class InclinometerDisturbedError(InclinometerError):
    """The received bytes do not answer the request: damaged, foreign, too long, or the request itself."""

    quality = Quality.BAD_ANSWER


class InclinometerWrongError(InclinometerError):
    """The answering device is not the expected sensor, or has other settings."""

    quality = Quality.WRONG_SENSOR


class InclinometerRefusedError(InclinometerError):
    """The sensor reports that it cannot measure with its settings."""

    quality = Quality.INVALID_SETTING


@dataclass(frozen=True, slots=True)
class InclinometerAccuracy:
    """The maker's specification: limits of error, ±, in degrees, and the temperatures at which they hold.

    ``cross_axis_deg`` is the error from a tilt about the other axis, ``step_deg`` the last digit,
    ``deg_per_k`` the limit of the zero's change per kelvin from the temperature of the levelling, or 20 °C.
    Angles beyond ±``range_deg`` are not measured; a sensor of 360° has no such limit. Roll is the
    inclination of the unit's x axis (``roll_is_inclination``) or a rotation about its z axis.
    """

    limit_deg: float
    from_c: float
    to_c: float
    limit_elsewhere_deg: float
    cross_axis_deg: float
    step_deg: float
    deg_per_k: float = 0.0
    range_deg: float = math.inf
    roll_is_inclination: bool = False


@dataclass(frozen=True, slots=True)
class InclinometerReading:
    """One reading: angles against gravity in the sensor's own sense, within ±180°; None: no such axis.

    ``t_ns`` is the earliest time of the measurement, on the monotonic clock. ``words`` are all registers as
    they were read: the last digits of a working sensor change.
    """

    t_ns: int
    roll_deg: float
    pitch_deg: float | None
    temperature_c: float
    words: tuple[int, ...]


class Inclinometer(Device, Protocol):
    """A sensor of inclination; opening checks that it is this sensor. The calls are made from one thread."""

    @property
    def name(self) -> str:
        """Type and address, for people."""

    @property
    def accuracy(self) -> InclinometerAccuracy:
        """Accuracy of its angles."""

    def read(self) -> InclinometerReading:
        """Return the current reading; raises InclinometerError."""


class LampsError(Exception):
    """The lamps cannot be opened or switched; the message gives the reason."""


class Lamps(Device, Protocol):
    """The frame LEDs."""

    def switch(self, on: bool) -> None:
        """Switch all LEDs on or off; raises LampsError."""


class Switches(Device, Protocol):
    """Voltage of switched glasses: with voltage a glass is clear, without it opaque."""

    def show(self, opaque: str) -> None:
        """Switch this target's glass off (opaque) and all others on; raises LampsError.

        Empty: no glass has voltage.
        """


class Indicator(StrEnum):
    """Lamps on the housing (App. A.1.4)."""

    DATA = "data"
    ERROR = "error"
    POWER = "power"
    OK = "ok"


class Indicators(Device, Protocol):
    """The lamps on the housing."""

    def show(self, lit: frozenset[Indicator]) -> None:
        """Switch these lamps on and the others off; raises LampsError."""


class ThermometerError(Exception):
    """The temperature cannot be read; the message gives the reason."""


class Thermometer(Protocol):
    """A temperature of the unit."""

    @property
    def name(self) -> str:
        """Name in the config."""

    def celsius(self) -> float | None:
        """Return the temperature now, °C; blocks. None: not available, which is not a fault of its own.

        Raises ThermometerError.
        """


class Stop(Protocol):
    """An event of ``threading`` that signals a thread to end."""

    def wait(self, timeout: float) -> bool:
        """Block until it is set, or for ``timeout`` seconds; returns whether it is set."""

    def is_set(self) -> bool:
        """Whether it is set."""


class Clock(Protocol):
    """Time, so that a test can run an hour in a second."""

    def monotonic_ns(self) -> int:
        """Return the clock on which frames are stamped, ns."""

    def utc(self, t_ns: int) -> datetime | None:
        """Return the UTC of an instant on the monotonic clock; None: not known."""

    async def sleep(self, seconds: float) -> None:
        """Sleep for ``seconds`` on this clock."""

    def wait(self, stop: Stop, seconds: float) -> None:
        """Block a thread until ``seconds`` have passed on this clock, or until ``stop`` is set."""
