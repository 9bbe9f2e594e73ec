"""Check by identity and view whether a target's camera is the calibrated one, in the same place."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from statistics import median

from altd.measuring.calibration import TargetCalibration
from altd.reasons import Reason
from altd.records import CameraIdentity, Fault, FaultCause, Frame, NoSpot, Spot
from altd.vision.fingerprint import Fingerprint, ViewOutcome, ViewVerdict
from altd.vision.frame_analysis import FrameAnalysis
from altd.vision.texture import TextureSample

_EXAMINATION_INTERVAL_NS = 190_000_000
"""Every fourth frame at 20 per second: a window of 20 contains at most three frames of a displaced camera."""
_MAX_FRAME_GAP_NS = 400_000_000
"""After a longer gap, or a step back in time, another camera may deliver: everything is examined again."""
_INITIAL_EXAMINATIONS = 3
_MAX_MOVE_DIAMETERS = 0.25
_MIN_FRAMES_BETWEEN_EXAMINATIONS = 4
_STACKED_FRAMES = 8
"""Number of dim frames evaluated together: at 3 % of the light a shift was found in six of them."""
_MAX_SHIFT_MM = 0.11
"""Maximum shift of the picture on the target: 0.4 px at 3.6 px/mm. Heat moves such an image by 0.1 to 0.3 px,
of which up to a third more is measured."""
_MAX_SHIFTS_MM = 0.2
"""Maximum sum of the shifts of two targets: 0.041° at 280 mm if they move against each other."""
_MAX_JUMP_PX = 0.5
_MAX_JUMP_MEDIANS = 3.0
"""Maximum distance from the position predicted by steady motion: a shifted picture shifts its spot. The
larger of both limits applies, or a shaking beam would have most frames examined. A knock hidden by it is
found at the next regular examination."""
_COMPARED_JUMPS = 12
_ESTABLISHED_AFTER_VERDICTS = 3


@dataclass(frozen=True, slots=True)
class ViewStatus:
    """State of a target's camera after one of its frames; read by other threads than the checking one.

    ``has_fingerprint``: the calibration has data to verify it. ``verified_ns`` is the time of the last
    verification, ``wrong`` and ``doubt`` are texts on what is wrong or not known, ``shift_px`` is the shift
    of the picture, ``frame_ns`` the time of the last frame compared with the calibration; None: not known.
    ``certain_shift_mm`` is the last shift on the target that a flat shows, 0 if there is none.
    """

    target: str
    has_fingerprint: bool
    verified_ns: int | None
    wrong: str
    doubt: str
    sensor_is_same: bool
    shift_px: float | None
    frame_ns: int | None
    certain_shift_mm: float = 0.0

    def figures(self, now_ns: int) -> dict[str, float | str]:
        """Return the figures for health: whether the view is verified, since when, and the picture's shift.

        If no frame arrived for a while before ``now_ns``, it contains only the time of verification.
        """
        figures: dict[str, float | str] = {f"view_{self.target}": self._verdict_text(now_ns)}
        if self.shift_px is not None and not self._is_silent(now_ns):
            figures[f"view_shift_{self.target}_px"] = round(self.shift_px, 3)
        return figures

    def _is_silent(self, now_ns: int) -> bool:
        return self.frame_ns is not None and now_ns - self.frame_ns > _MAX_FRAME_GAP_NS

    def _verdict_text(self, now_ns: int) -> str:
        if not self.has_fingerprint:
            return "could not be verified: the calibration has no fingerprint of the camera"
        if not self.wrong and self.verified_ns is not None:
            return f"verified {max(now_ns - self.verified_ns, 0) * 1e-9:.0f} s ago"
        if self._is_silent(now_ns):
            return "could not be verified: no frames"
        if self.wrong:
            return f"wrong: {self.wrong}"
        sensor = "the sensor is verified, its view " if self.sensor_is_same else ""
        return f"{sensor}could not be verified: {self.doubt}"


def shift_fault(views: Iterable[ViewStatus]) -> Fault | None:
    """Return the fault if the pictures of two targets are shifted by too much in sum, else None."""
    shifted = sorted(views, key=lambda view: view.certain_shift_mm)[-2:]
    total_mm = sum(view.certain_shift_mm for view in shifted)
    if total_mm <= _MAX_SHIFTS_MM:
        return None
    names = " and ".join(view.target for view in shifted)
    detail = f"the pictures of {names} lie {total_mm:.2f} mm aside in sum, the limit is {_MAX_SHIFTS_MM} mm"
    return Fault(Reason.WRONG_CAMERA, shifted[-1].target, detail)


class ViewCheck:
    """Check of one camera, frame by frame; its memory holds the results of the last frames.

    A frame is examined, for about a millisecond, when the camera starts or resumes delivery, when the spot
    has jumped or is in a new place, and every 0.2 s; each frame while dim ones are evaluated together. A
    wrong view counts at once. After three such verdicts only a frame that verifies the view ends it, before
    that any frame in which nothing wrong is found.
    """

    def __init__(
        self,
        target: TargetCalibration,
        expected: Sequence[CameraIdentity],
        other_place_of: Callable[[CameraIdentity, str], str] = lambda _, __: "",
    ) -> None:
        self._target = target.name
        self._other_place_of = other_place_of
        self._fingerprint = target.fingerprint
        self._px_per_mm = target.px_per_mm
        self._expected = expected
        self._last_ns: int | None = None
        self._reset()

    def _reset(self) -> None:
        self._wrong: ViewVerdict | None = None
        self._wrong_verdicts = 0
        self.displaced_px = 0.0
        """Uncertainty that the picture's shift adds to spots that are not rejected."""
        self._certain_shift_mm = 0.0
        self._restart_examination()

    def _restart_examination(self) -> None:
        """Examine the next frames; an earlier finding, wrong or displaced, holds until they refute it."""
        self._doubt = "no frame has been examined yet"
        self._shift_px: float | None = None
        self._verified_ns: int | None = None
        self._sensor_is_same = False
        self._examined = 0
        self._examined_ns = 0
        self._frames_since = 0
        self._place: Spot | None = None
        self._last: Spot | None = None
        self._before_last: Spot | None = None
        self._jumps_px: deque[float] = deque(maxlen=_COMPARED_JUMPS)
        self._faint: deque[TextureSample] = deque(maxlen=_STACKED_FRAMES - 1)
        """Samples of the last examined frames too dim to decide alone, since the last jump of the spot."""

    def compare_with(self, fingerprint: Fingerprint | None) -> None:
        """Compare frames from now on with another fingerprint; the next one is examined."""
        self._fingerprint = fingerprint
        self._restart_examination()

    def objection(
        self, analysis: FrameAnalysis, spot: Spot | NoSpot, camera: CameraIdentity | None
    ) -> NoSpot | None:
        """Return why a frame's spot must not be measured; None if there is no objection to the camera.

        ``camera`` is the identity of the camera that delivered the frame.
        """
        for expected in self._expected:
            if camera is not None and (difference := camera.difference_from(expected)):
                self._reset()
                self._doubt = difference
                place = self._other_place_of(camera, self._target)
                cause = FaultCause.SWAPPED if place else FaultCause.OTHER_CAMERA
                return NoSpot(Reason.WRONG_CAMERA, f"{difference} as calibrated or configured{place}", cause)
        frame = analysis.frame
        last_ns, self._last_ns = self._last_ns, frame.t_ns
        if last_ns is not None and not 0 <= frame.t_ns - last_ns <= _MAX_FRAME_GAP_NS:
            self._restart_examination()
        self._frames_since += 1
        has_jumped = self._has_jumped(spot)
        if has_jumped:
            self._faint.clear()  # the earlier samples may show another view
        if self._fingerprint is not None and self._is_due(frame, spot, has_jumped):
            self._examine(self._fingerprint, analysis, spot)
        self._before_last, self._last = self._last, spot if isinstance(spot, Spot) else None
        wrong = self._wrong
        return None if wrong is None else NoSpot(Reason.WRONG_CAMERA, wrong.reason, wrong.cause)

    @property
    def status(self) -> ViewStatus:
        """State after the last frame."""
        return ViewStatus(
            self._target,
            self._fingerprint is not None,
            self._verified_ns,
            "" if self._wrong is None else self._wrong.reason,
            self._doubt,
            self._sensor_is_same,
            self._shift_px,
            self._last_ns,
            self._certain_shift_mm,
        )

    def _is_due(self, frame: Frame, spot: Spot | NoSpot, has_jumped: bool) -> bool:
        is_established = self._wrong_verdicts >= _ESTABLISHED_AFTER_VERDICTS
        if (self._wrong is not None and not is_established) or self._examined == 0:
            return True
        if self._verified_ns is None and self._examined < _INITIAL_EXAMINATIONS:
            return True
        if frame.t_ns - self._examined_ns >= _EXAMINATION_INTERVAL_NS:
            return True
        if 0 < len(self._faint) < _STACKED_FRAMES - 1:
            return True
        if not isinstance(spot, Spot):
            return False
        if self._place is None or self._last is None or has_jumped:
            return True
        moved_px = math.hypot(spot.u_px - self._place.u_px, spot.v_px - self._place.v_px)
        return (
            self._frames_since >= _MIN_FRAMES_BETWEEN_EXAMINATIONS
            and moved_px > _MAX_MOVE_DIAMETERS * spot.diameter_px
        )

    def _has_jumped(self, spot: Spot | NoSpot) -> bool:
        """Return whether a spot is far from the position predicted by the motion between the last two."""
        last, before = self._last, self._before_last or self._last
        if not isinstance(spot, Spot) or last is None or before is None:
            return False
        jump_px = math.hypot(spot.u_px - 2 * last.u_px + before.u_px, spot.v_px - 2 * last.v_px + before.v_px)
        jumps_px = self._jumps_px
        usual_px = median(jumps_px) if len(jumps_px) == _COMPARED_JUMPS else 0.0
        jumps_px.append(jump_px)
        return jump_px > max(_MAX_JUMP_PX, _MAX_JUMP_MEDIANS * usual_px)

    def _examine(self, fingerprint: Fingerprint, analysis: FrameAnalysis, spot: Spot | NoSpot) -> None:
        fingerprint = replace(fingerprint, max_shift_px=_MAX_SHIFT_MM * self._px_per_mm)
        verdict = fingerprint.examine(analysis, isinstance(spot, Spot), tuple(self._faint))
        if verdict.faint is None:
            self._faint.clear()
        else:
            self._faint.append(verdict.faint)
        self._examined += 1
        self._examined_ns, self._frames_since = analysis.frame.t_ns, 0
        self._place = spot if isinstance(spot, Spot) else None
        self._doubt = verdict.reason if verdict.outcome is ViewOutcome.UNDECIDED else ""
        self._sensor_is_same = verdict.is_same_sensor
        if verdict.shift_px is not None:
            self._shift_px = verdict.shift_px
        if verdict.displaced_px is not None:
            self.displaced_px = verdict.displaced_px
            self._certain_shift_mm = (verdict.shift_px or 0.0) / self._px_per_mm
        if verdict.outcome is ViewOutcome.REFUTED:
            self._wrong = verdict
            self._wrong_verdicts += 1
            self._verified_ns = None
            return
        if verdict.outcome is ViewOutcome.VERIFIED:
            self._verified_ns = analysis.frame.t_ns
        if self._wrong is not None and self._is_cleared(verdict, self._wrong):
            self._wrong, self._wrong_verdicts = None, 0

    def _is_cleared(self, verdict: ViewVerdict, wrong: ViewVerdict) -> bool:
        if verdict.outcome is ViewOutcome.VERIFIED or (wrong.is_other_sensor and verdict.is_same_sensor):
            return True
        if wrong.is_print_seen and verdict.is_print_seen is False:
            return True
        return self._wrong_verdicts < _ESTABLISHED_AFTER_VERDICTS
