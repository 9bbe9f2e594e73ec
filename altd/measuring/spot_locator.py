"""One camera's part of the measuring chain: from a frame to its spot or the reason why there is none."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

from altd.measuring.calibration import TargetCalibration
from altd.measuring.freshness import FreshnessCheck
from altd.measuring.spot_trend import SuddenResidual
from altd.measuring.view_check import ViewCheck, ViewStatus
from altd.reasons import Reason
from altd.records import CameraIdentity, FaultCause, Frame, NoSpot, Spot
from altd.vision.dust import DustCount, count_dust
from altd.vision.fingerprint import Fingerprint
from altd.vision.flat import Flat
from altd.vision.frame_analysis import FrameAnalysis
from altd.vision.frame_leds import count_lit_leds, with_leds_as_cause
from altd.vision.localise import locate_in

_CHANGING = NoSpot(Reason.EXPOSURE_CHANGING)
DUST_INTERVAL_NS = 5 * 10**9
"""Time between dust counts: dust settles over weeks, and a count takes one to three milliseconds."""
_UNDER_LEDS = NoSpot(Reason.SPOT_MISSING, f"not looked for, {FaultCause.LEDS_LIT.meaning}")


@dataclass(frozen=True, slots=True, eq=False)
class Appearance:
    """Appearance of a target: its response to even light, and its constant features; None: not known."""

    flat: Flat | None
    fingerprint: Fingerprint | None


@dataclass(frozen=True, slots=True)
class Located:
    """Result for one frame. It is frozen, because one thread makes it and another reads it.

    ``spot`` is the spot to measure, ``found`` what the localiser found, whichever camera delivered; None in a
    repeated frame. ``breaks`` counts the camera's frames, up to this one, that no window may span; the count
    of the next frame includes one that is lost. These are frames exposed during a change, located by another
    flat or of another view, and the second and later ones of consecutive repeated frames: a single repeated
    frame is lost, with two in a row the camera is frozen. ``view`` is the state of the camera, ``dust`` the
    dust over the spot, counted at intervals; None: not known. ``leds_on``: the frame LEDs were lit, or being
    switched. Such a frame is not analysed, and its exposure not measured; it only shows that its camera
    delivers. ``opaque`` is the frame's; with switched targets ``is_shown`` is whether that is this camera's
    own target, and otherwise ``found`` is None. ``behind_ns`` is the delay of the spot's row after
    the frame's time (``Frame.row_delay_ns``).
    """

    camera: str
    sequence: int
    t_ns: int
    spot: Spot | NoSpot
    breaks: int
    found: Spot | NoSpot | None
    view: ViewStatus
    leds_on: bool = False
    dust: DustCount | None = None
    opaque: str = ""
    is_shown: bool = True
    behind_ns: int = 0


class SpotLocator:
    """Locates the spot in each frame of one camera, and compares the frame with earlier ones.

    ``identity`` returns the identity of the delivering camera, ``expected`` is the one required in addition
    to the calibrated one, ``other_place_of`` returns at which other target a camera was calibrated
    (``Calibration``). ``is_switched``: only frames with this target opaque show it. One thread calls
    ``locate``, with one frame after the other.
    """

    def __init__(
        self,
        camera: str,
        target: TargetCalibration,
        identity: Callable[[], CameraIdentity | None] = lambda: None,
        expected: CameraIdentity | None = None,
        other_place_of: Callable[[CameraIdentity, str], str] = lambda _, __: "",
        is_switched: bool = False,
    ) -> None:
        self.camera = camera
        self._is_switched = is_switched
        self._target = target
        self.appearance = Appearance(target.flat, target.fingerprint)
        """Appearance used to locate spots and to check the view; another thread may replace it."""
        self._last_appearance = self.appearance
        self._identity = identity
        self._freshness = FreshnessCheck()
        self._is_frozen = False
        """Whether the last frame was a repeat."""
        self._breaks = 0
        self._dust_ns: int | None = None
        self._sudden = SuddenResidual()
        cameras = (target.camera, expected or CameraIdentity())
        self._view_check = ViewCheck(target, cameras, other_place_of)

    def locate(self, frame: Frame) -> Located:
        """Return the spot of a frame; a frame with lit frame LEDs is not searched."""
        if frame.leds_on:
            self._breaks += frame.changing
            return self._located(frame, _UNDER_LEDS, None, leds_on=True)
        was_frozen = self._is_frozen
        repeated = self._freshness.repeated(frame)
        self._is_frozen = bool(repeated)
        analysis = FrameAnalysis(frame, self._target.localiser)
        is_changed = self._takes_another_flat()
        self._breaks += frame.changing or is_changed or (bool(repeated) and was_frozen)
        found = None if repeated else self._found(analysis)
        spot = NoSpot(Reason.FRAME_REPEATED, repeated) if found is None else self._checked(analysis, found)
        return self._located(frame, spot, found, self._dust(analysis, spot))

    def _takes_another_flat(self) -> bool:
        """Use the newest appearance from this frame on; return whether its flat is another one."""
        before, self._last_appearance = self._last_appearance, self.appearance
        if self._last_appearance.fingerprint is not before.fingerprint:
            self._view_check.compare_with(self._last_appearance.fingerprint)
        return self._last_appearance.flat is not before.flat

    def _located(
        self,
        frame: Frame,
        spot: Spot | NoSpot,
        found: Spot | NoSpot | None,
        dust: DustCount | None = None,
        leds_on: bool = False,
    ) -> Located:
        is_shown = not self._is_switched or frame.opaque == self._target.name
        return Located(
            self.camera,
            frame.sequence,
            frame.t_ns,
            spot,
            self._breaks,
            found if is_shown else None,
            self._view_check.status,
            leds_on,
            dust,
            frame.opaque,
            is_shown,
            0 if isinstance(spot, NoSpot) else frame.row_delay_ns(spot.v_px),
        )

    @property
    def view(self) -> ViewStatus:
        """Current state of the camera."""
        return self._view_check.status

    def _dust(self, analysis: FrameAnalysis, spot: Spot | NoSpot) -> DustCount | None:
        """Return the dust over a spot, counted at intervals; a rejected spot may be covered by anything."""
        fingerprint = self._last_appearance.fingerprint
        texture = None if fingerprint is None else fingerprint.texture
        t_ns = analysis.frame.t_ns
        if isinstance(spot, NoSpot) or texture is None:
            return None
        if self._dust_ns is not None and 0 <= t_ns - self._dust_ns < DUST_INTERVAL_NS:
            return None
        self._dust_ns = t_ns
        return count_dust(analysis, texture)

    def _found(self, analysis: FrameAnalysis) -> Spot | NoSpot:
        target = self._target
        flat = self._last_appearance.flat
        spot = _CHANGING if analysis.frame.changing else locate_in(analysis, flat, target.spot)
        if isinstance(spot, NoSpot) and len(target.leds_px):
            lit = count_lit_leds(analysis.found, target.leds_px)
            spot = with_leds_as_cause(spot, lit, len(target.leds_px))
        return spot

    def _checked(self, analysis: FrameAnalysis, spot: Spot | NoSpot) -> Spot | NoSpot:
        """Return the spot if the camera and its view are the calibrated ones, otherwise the objection."""
        check = self._view_check
        if (objection := check.objection(analysis, spot, self._identity())) is not None:
            self._breaks += 1  # the frames before it are not reliable either
            return objection
        spot = spot if self._is_switched else self._sudden.checked(spot)  # a clear target shows another light
        if not check.displaced_px:
            return spot
        if isinstance(spot, NoSpot):
            return replace(spot, spot=None)
        return replace(spot, excess_px=math.hypot(spot.excess_px, check.displaced_px))
