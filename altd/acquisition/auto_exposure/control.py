"""Exposure of one camera: how bright its spot is, what it should be set to, setting it, marking its frames.

Two threads of the camera use one ``ExposureControl``. The one that locates spots calls ``sample``, which
replaces ``setpoint``; the one that acquires frames calls ``opened``, ``apply`` and ``mark``. What one of them
wants of the other are frozen records, replaced as a whole; so are the ``figures`` that health shows.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from altd.acquisition.auto_exposure.rule import (
    ExposureRule,
    Setting,
    limits_of,
    sample_brightness,
    setting_for,
)
from altd.config import ExposureSettings
from altd.ports import Camera, CameraRefusedError, ExposureRange
from altd.records import Frame, NoSpot, Spot

MAX_MARKED_FRAMES = 4
"""So many frames after a change have an unknown exposure, unless they carry it: one or two wait in a driver's
buffers or are just being exposed."""
_EXPOSURE_TIME_TOLERANCE = 0.05
"""Relative, of an exposure time that a frame carries."""
_GAIN_TOLERANCE_DB = 0.5


@dataclass(frozen=True, slots=True)
class Applied:
    """The camera took a setting."""

    setting: Setting


@dataclass(frozen=True, slots=True)
class Refused:
    """The camera did not take a setting and keeps the previous one. ``complaint`` says why."""

    complaint: str


@dataclass(frozen=True, slots=True)
class ExposureFigures:
    """A camera's exposure in health, of the last frame that carries it; None: that is not known."""

    exposure_control: str
    level: float
    exposure_ms: float | None
    gain_db: float | None
    changes: int


@dataclass(frozen=True, slots=True)
class _Ability:
    """The possible settings of the open camera: none without ``limits`` or when it refuses."""

    limits: ExposureRange | None = None
    refuses: bool = False


class ExposureControl:
    """One camera's control; it outlives the camera, which gets the setpoint again when it is opened again.

    ``setpoint`` may be replaced at any time. It stays what the config says unless ``sample`` is called and
    the control is ``auto``. ``figures`` is None until a frame was sampled.
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
        """With the limits that it was made for."""
        self._changes = 0

    def sample(self, frame: Frame, found: Spot | NoSpot) -> None:
        """Take a frame with what the localiser found in it; a setting that would do better is the setpoint.

        Frames under LEDs or of a change tell nothing.
        """
        if frame.changing or frame.leds_on:
            return
        ability = self._ability
        brightness = sample_brightness(frame, found)
        # without an exposure time the camera reports nonsense, or reports nothing and was never set
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
        """The camera was opened: whatever was set before is set again."""
        able = None if self._settings.control == "camera" else camera.exposure_range
        self._ability = _Ability(None if able is None else limits_of(self._settings, able, self._fps))
        self._requested, self._applied, self._marks_left = None, None, 0

    @property
    def is_due(self) -> bool:
        """Whether there is a setpoint that the camera was not asked for yet."""
        return self._ability.limits is not None and self.setpoint != self._requested

    def apply(self, camera: Camera) -> Applied | Refused:
        """Set the camera to the setpoint, between two frames; raises CameraError when the camera fails."""
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
        """The frame with what it was exposed with, and with ``changing`` until that is certain.

        The first frame after a change is always marked: a window must see where it lies.
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
        """Whether a frame tells that it was exposed so; one that tells nothing does not."""
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
            return f"{control}, but this camera has nothing to set"
        return f"{control}, but the camera refuses" if ability.refuses else control
