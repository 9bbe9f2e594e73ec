"""One camera's part of the measuring chain: a frame in, its spot or the reason why there is none out."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

from altd.measuring.calibration import TargetCalibration
from altd.measuring.freshness import FreshnessCheck
from altd.measuring.view_check import ViewCheck, ViewStatus
from altd.reasons import Reason
from altd.records import CameraIdentity, Frame, NoSpot, Spot
from altd.vision.frame_analysis import FrameAnalysis
from altd.vision.frame_leds import count_lit_leds, with_leds_as_cause
from altd.vision.localise import locate_in

_CHANGING = NoSpot(Reason.EXPOSURE_CHANGING)


@dataclass(frozen=True, slots=True)
class Located:
    """What a frame holds. Everything in it is frozen: it is read by another thread than made it.

    ``spot`` is what is to be measured, ``found`` what the localiser saw, whosever camera it is; None in a
    frame that is not new. ``breaks`` counts the camera's frames, up to this one, that no window may reach
    across, so one that gets lost is in the next one's: frames that were exposed during a change, or of
    another view, and the second and later ones of a row that are not new: one that comes twice is lost, with
    two in a row the camera stands still. ``view`` is what is known of the camera.
    """

    camera: str
    sequence: int
    t_ns: int
    spot: Spot | NoSpot
    breaks: int
    found: Spot | NoSpot | None
    view: ViewStatus


class SpotLocator:
    """Locates the spot in each frame of one camera, and holds the frame against those before it.

    ``identity`` tells which camera delivers, ``expected`` which should, beside the one that was calibrated.
    One thread calls ``locate``, with one frame after the other.
    """

    def __init__(
        self,
        camera: str,
        target: TargetCalibration,
        identity: Callable[[], CameraIdentity | None] = lambda: None,
        expected: CameraIdentity | None = None,
    ) -> None:
        self.camera = camera
        self._target = target
        self._identity = identity
        self._freshness = FreshnessCheck()
        self._stands_still = False
        """The last frame was not new."""
        self._breaks = 0
        self._view_check = ViewCheck(target, (target.camera, expected or CameraIdentity()))

    def locate(self, frame: Frame) -> Located:
        """The spot of a frame that was taken with the frame LEDs off."""
        stood_still = self._stands_still
        repeated = self._freshness.repeated(frame)
        self._stands_still = bool(repeated)
        analysis = FrameAnalysis(frame, self._target.localiser)
        self._breaks += frame.changing or (bool(repeated) and stood_still)
        found = None if repeated else self._found(analysis)
        spot = NoSpot(Reason.FRAME_REPEATED, repeated) if found is None else self._checked(analysis, found)
        view = self._view_check.status
        return Located(self.camera, frame.sequence, frame.t_ns, spot, self._breaks, found, view)

    @property
    def view(self) -> ViewStatus:
        """What is known of the camera now."""
        return self._view_check.status

    def _found(self, analysis: FrameAnalysis) -> Spot | NoSpot:
        target = self._target
        spot = _CHANGING if analysis.frame.changing else locate_in(analysis, target.flat, target.spot)
        if isinstance(spot, NoSpot) and len(target.leds_px):
            lit = count_lit_leds(analysis.found, target.leds_px)
            spot = with_leds_as_cause(spot, lit, len(target.leds_px))
        return spot

    def _checked(self, analysis: FrameAnalysis, spot: Spot | NoSpot) -> Spot | NoSpot:
        """The spot as far as the camera and its view are those that were calibrated."""
        check = self._view_check
        if (objection := check.objection(analysis, spot, self._identity())) is not None:
            self._breaks += 1  # the exposures before it are not to be believed either
            return objection
        if check.displaced_px and isinstance(spot, Spot):
            return replace(spot, excess_px=math.hypot(spot.excess_px, check.displaced_px))
        return spot
