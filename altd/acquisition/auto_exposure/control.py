"""Exposure of one camera: the loop looks and wishes, the camera's own thread sets, between two frames."""

from __future__ import annotations

from dataclasses import replace

from altd.acquisition.auto_exposure.rule import ExposureRule, Setting, limits_of, look, setting_for
from altd.config import ExposureSettings
from altd.ports import Camera, CameraRefusedError, ExposureRange
from altd.records import Frame, NoSpot, Spot
from altd.status.health import Component

MARKED_FRAMES = 4
"""So many frames after a change belong to nobody, unless they tell: what waits in a driver's buffers or is
just being exposed is one or two of them."""
_AS_WISHED = 0.05
_AS_WISHED_DB = 0.5


class ExposureSetter:
    """The thread's side. ``wish`` may be replaced from the loop at any time; what stands in it is set.

    It outlives the camera: a camera that was opened again gets what was last wished for.
    """

    def __init__(self, control: ExposureSettings, fps: float) -> None:
        self.wish = Setting(control.exposure_ms, control.gain_db)
        self.limits: ExposureRange | None = None
        """Within which may be wished; None before the camera was opened, and where it has nothing to set."""
        self.refused = False
        """The camera did not take the last wish; it goes on with what it had."""
        self._control = control
        self._fps = fps
        self._asked: Setting | None = None
        self._set: Setting | None = None
        self._marked_left = 0
        self._gain_stays = False

    def opened(self, camera: Camera) -> None:
        """The camera was opened: whatever was set before is set again."""
        able = camera.exposure_range
        self.limits = limits_of(self._control, able, self._fps) if able is not None else None
        self._asked, self._set, self._marked_left, self.refused = None, None, 0, False

    def set(self, camera: Camera) -> str | None:
        """Set what is new in ``wish``: "" when the camera took it, else why it did not; None: nothing is new.

        Raises CameraError when the camera fails.
        """
        wish = self.wish
        if self.limits is None or wish == self._asked:
            return None
        self._asked = wish
        setting = setting_for(wish.light, self.limits) if self._control.control == "auto" else wish
        try:
            camera.set_exposure(setting.exposure_ms, setting.gain_db)
        except CameraRefusedError as error:
            self.refused = True
            return str(error)
        self._gain_stays = self._set is not None and self._set.gain_db == setting.gain_db
        self._set, self._marked_left, self.refused = setting, MARKED_FRAMES, False
        return ""

    def marked(self, frame: Frame) -> Frame:
        """The frame with what it was exposed with, and with ``changing`` until that is certain.

        The first frame after a change is always marked: a window must see where it lies.
        """
        if self._set is None:
            return frame
        if 0 < self._marked_left < MARKED_FRAMES and self._is_as_wished(frame, self._set):
            self._marked_left = 0
        changing = self._marked_left > 0
        self._marked_left -= changing
        return replace(
            frame,
            exposure_ms=self._set.exposure_ms if frame.exposure_ms is None else frame.exposure_ms,
            gain_db=self._set.gain_db if frame.gain_db is None else frame.gain_db,
            changing=frame.changing or changing,
        )

    def _is_as_wished(self, frame: Frame, setting: Setting) -> bool:
        """Whether a frame tells that it was exposed so; one that tells nothing does not."""
        if frame.exposure_ms is None:
            return False
        if frame.gain_db is None:
            gain_fits = self._gain_stays
        else:
            gain_fits = abs(frame.gain_db - setting.gain_db) <= _AS_WISHED_DB
        return gain_fits and abs(frame.exposure_ms - setting.exposure_ms) <= _AS_WISHED * setting.exposure_ms


class ExposureKeeper:
    """The loop's side: what is seen of the spot becomes wishes and, in the camera's health, figures."""

    def __init__(self, control: ExposureSettings, fps: float, window: int, component: Component) -> None:
        self.setter = None if control.control == "camera" else ExposureSetter(control, fps)
        """What the camera's thread sets with; None: nothing is set."""
        self._control = control.control
        self._window = window
        self._component = component
        self._limits: ExposureRange | None = None
        self._rule: ExposureRule | None = None

    def see(self, frame: Frame, spot: Spot | NoSpot) -> None:
        """Take a frame, with what the localiser made of it. Frames under LEDs are none of ours."""
        if frame.changing or frame.leds_on:
            return
        sight = look(frame, spot)
        told: dict[str, float] = {}
        if frame.exposure_ms is not None:
            told["exposure_ms"] = float(f"{frame.exposure_ms:.3g}")
        if frame.gain_db is not None:
            told["gain_db"] = round(frame.gain_db, 1)
        self._component.observe(
            {"exposure_control": self._in_words(), "level": round(sight.level, 2), **told}
        )
        setter = self.setter
        if self._control != "auto" or setter is None or setter.limits is None or setter.refused:
            return
        if self._rule is None or setter.limits != self._limits:
            self._limits, self._rule = setter.limits, ExposureRule(setter.limits, self._window)
        if frame.exposure_ms is None or not frame.exposure_ms > 0:
            return  # a camera that tells nonsense
        setting = self._rule.next(sight, Setting(frame.exposure_ms, frame.gain_db or 0.0))
        if setting is not None:
            setter.wish = setting
            self._component.count("exposure_changes")

    def _in_words(self) -> str:
        setter = self.setter
        if setter is None:
            return self._control
        if setter.limits is None:
            return f"{self._control}, but this camera has nothing to set"
        return f"{self._control}, but the camera refuses" if setter.refused else self._control
