"""Exposure control of one camera: sample the brightness, choose and apply a setpoint, mark affected frames.

Two threads of the camera use one ``ExposureControl``. The locating thread calls ``sample``, which replaces
``setpoint``; the acquiring thread calls ``opened``, ``apply`` and ``mark``. They exchange frozen records,
each replaced as a whole; so are the ``figures`` that health shows.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from altd.acquisition.auto_exposure.rule import (
    ExposureRule,
    Setting,
    ceiling_of,
    limits_of,
    sample_brightness,
    setting_for,
)
from altd.config import ExposureSettings
from altd.ports import Camera, CameraRefusedError, ExposureRange
from altd.records import Frame, NoSpot, Spot

MAX_MARKED_FRAMES = 4
"""Maximum number of frames after a change whose exposure is unknown, unless they carry it. One or two are in
a driver's buffers or being exposed at the change."""
_EXPOSURE_TIME_TOLERANCE = 0.05
"""Relative tolerance of an exposure time that a frame carries."""
_GAIN_TOLERANCE_DB = 0.5


@dataclass(frozen=True, slots=True)
class Applied:
    """A setting that the camera accepted."""

    setting: Setting


@dataclass(frozen=True, slots=True)
class Refused:
    """A setting that the camera refused; it keeps the previous one. ``complaint`` is the reason."""

    complaint: str


@dataclass(frozen=True, slots=True)
class ExposureFigures:
    """Exposure of a camera in health, from its last sampled frame; None: not known."""

    exposure_control: str
    level: float
    exposure_ms: float | None
    gain_db: float | None
    changes: int


@dataclass(frozen=True, slots=True)
class _Ability:
    """Possible settings of the open camera: none without ``limits`` or if it refuses settings."""

    limits: ExposureRange | None = None
    refuses: bool = False


class ExposureControl:
    """Exposure control of one camera; it outlives the open camera, and reapplies the setpoint on reopening.

    ``setpoint`` may be replaced at any time. It keeps the config's value unless ``sample`` is called and the
    control is ``auto``. ``figures`` is None until the first frame is sampled.
    """

    def __init__(self, settings: ExposureSettings, fps: float, window: int) -> None:
        self.setpoint = Setting(settings.exposure_ms, settings.gain_db)
        self.figures: ExposureFigures | None = None
        self._settings = settings
        self._fps = fps
        self._window = window
        self._ability = _Ability()
        self._requested: Setting | None = None
        self._applied: Setting | None = None
        self._gain_stays = False
        self._marks_left = 0
        self._rule: tuple[ExposureRange, ExposureRule] | None = None
        """The exposure rule and the limits it was made for."""
        self._changes = 0
        self._ceiling: float | None = None
        """Largest value of the camera below full scale; without it a clipped spot would seem dim."""

    def sample(self, frame: Frame, found: Spot | NoSpot) -> None:
        """Sample the brightness of a frame in which ``found`` was located; update the setpoint if needed.

        Frames exposed under LEDs or during a change of exposure are ignored.
        """
        if frame.changing or frame.leds_on:
            return
        ability = self._ability
        if (ceiling := ceiling_of(frame, found)) is not None:
            self._ceiling = ceiling
        elif self._ceiling is not None and frame.pixels.max() > self._ceiling:
            self._ceiling = None
        brightness = sample_brightness(frame, found, self._ceiling)
        # the camera reports an invalid exposure time, or reports none and was never set
        exposed = frame.exposure_ms is not None and frame.exposure_ms > 0
        if (
            self._settings.control == "auto"
            and ability.limits is not None
            and not ability.refuses
            and exposed
        ):
            if self._rule is None or self._rule[0] != ability.limits:
                self._rule = ability.limits, ExposureRule(ability.limits, self._window)
            present = Setting(frame.exposure_ms or 0.0, frame.gain_db or 0.0)
            if (setting := self._rule[1].next(brightness, present)) is not None:
                self.setpoint = setting
                self._changes += 1
        self.figures = ExposureFigures(
            self._control_text(ability),
            round(brightness.level, 2),
            None if frame.exposure_ms is None else float(f"{frame.exposure_ms:.3g}"),
            None if frame.gain_db is None else round(frame.gain_db, 1),
            self._changes,
        )

    def opened(self, camera: Camera) -> None:
        """Read the limits of the camera, which was just opened, and let the setpoint be applied again."""
        able = None if self._settings.control == "camera" else camera.exposure_range
        self._ability = _Ability(None if able is None else limits_of(self._settings, able, self._fps))
        self._requested, self._applied, self._marks_left = None, None, 0

    @property
    def is_due(self) -> bool:
        """Whether the setpoint has not been requested from the camera yet."""
        return self._ability.limits is not None and self.setpoint != self._requested

    def apply(self, camera: Camera) -> Applied | Refused:
        """Set the camera to the setpoint, between two frames; raises CameraError if the camera fails."""
        limits = self._ability.limits
        assert limits is not None  # noqa: S101  it is due
        self._requested = setting = self.setpoint
        if self._settings.control == "auto":
            setting = setting_for(setting.light, limits)
        try:
            camera.set_exposure(setting.exposure_ms, setting.gain_db)
        except CameraRefusedError as error:
            self._ability = _Ability(limits, refuses=True)
            return Refused(str(error))
        self._gain_stays = self._applied is not None and self._applied.gain_db == setting.gain_db
        self._applied, self._marks_left = setting, MAX_MARKED_FRAMES
        self._ability = _Ability(limits)
        return Applied(setting)

    def mark(self, frame: Frame) -> Frame:
        """Return the frame with its exposure time and gain, and with ``changing`` until they are certain.

        The first frame after a change is always marked, so that a window can locate the change.
        """
        setting = self._applied
        if setting is None:
            return frame
        if 0 < self._marks_left < MAX_MARKED_FRAMES and self._is_exposed_with(setting, frame):
            self._marks_left = 0
        changing = self._marks_left > 0
        self._marks_left -= changing
        return replace(
            frame,
            exposure_ms=setting.exposure_ms if frame.exposure_ms is None else frame.exposure_ms,
            gain_db=setting.gain_db if frame.gain_db is None else frame.gain_db,
            changing=frame.changing or changing,
        )

    def _is_exposed_with(self, setting: Setting, frame: Frame) -> bool:
        """Whether a frame carries this setting; False for a frame without an exposure time."""
        if frame.exposure_ms is None:
            return False
        if frame.gain_db is None:
            gain_fits = self._gain_stays
        else:
            gain_fits = abs(frame.gain_db - setting.gain_db) <= _GAIN_TOLERANCE_DB
        return (
            gain_fits
            and abs(frame.exposure_ms - setting.exposure_ms) <= _EXPOSURE_TIME_TOLERANCE * setting.exposure_ms
        )

    def _control_text(self, ability: _Ability) -> str:
        control = self._settings.control
        if control == "camera":
            return control
        if ability.limits is None:
            return f"{control}, but this camera has no adjustable setting"
        return f"{control}, but the camera refuses" if ability.refuses else control
