"""Data types of the self-check: its input and its results."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from altd.records import FloatArray, Frame, Value


class Verdict(StrEnum):
    """The result of a check of the unit's geometry."""

    GOOD = "good"
    SUSPECT = "suspect"
    BAD = "bad"
    UNKNOWN = "unknown"


class LedState(StrEnum):
    """The state of one of the calibration's LEDs in a check; only those ``used`` are fitted."""

    USED = "used"
    DARK = "dark"
    DIM = "dim"
    CUT = "cut"
    HIDDEN = "hidden"
    ALWAYS_LIT = "always_lit"
    DISPLACED = "displaced"
    UNSTEADY = "unsteady"


@dataclass(frozen=True, slots=True, eq=False)
class LedView:
    """One target in one check: frames with its frame LEDs on and frames with them off, at least one of each.

    All are of one camera, size and depth, without frames in which the LEDs were switched. They may contain
    the laser spot, which may move.
    """

    lit: tuple[Frame, ...]
    dark: tuple[Frame, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Similarity:
    """Motion of a target's picture since the calibration: position now from position then, px.

    now = about + shift + (1 + scale) · R(turn) · (then − about), with R positive from u to v. ``about_px`` is
    the centroid of all the calibration's LEDs of the target, ``radius_px`` their rms distance from it;
    ``covariance`` (4, 4) is that of (shift_u_px, shift_v_px, turn_deg, scale_ppm).
    """

    about_px: tuple[float, float]
    shift_px: tuple[float, float]
    turn_deg: float
    scale_ppm: float
    covariance: FloatArray
    radius_px: float

    @property
    def vector(self) -> FloatArray:
        """Vector of shift_u_px, shift_v_px, turn_deg, scale_ppm, as (4,)."""
        return np.array([*self.shift_px, self.turn_deg, self.scale_ppm])

    def now_px(self, then_px: FloatArray) -> FloatArray:
        """Return the current positions, (n, 2), of positions (n, 2) in the calibrated picture."""
        about = np.asarray(self.about_px)
        now: FloatArray = about + self.shift_px + (then_px - about) @ self._matrix().T
        return now

    def then_px(self, now_px: FloatArray) -> FloatArray:
        """Return the positions (n, 2) in the calibrated picture of current positions (n, 2)."""
        about = np.asarray(self.about_px)
        then: FloatArray = about + (now_px - about - self.shift_px) @ np.linalg.inv(self._matrix()).T
        return then

    @property
    def affine(self) -> FloatArray:
        """The same as (2, 3): now = affine · (u, v, 1) of then, in OpenCV's form."""
        matrix = self._matrix()
        about = np.asarray(self.about_px)
        return np.column_stack([matrix, about + self.shift_px - matrix @ about])

    def covariance_at_px2(self, u_px: float, v_px: float) -> FloatArray:
        """Return the covariance (2, 2) px² of a place's current position; to first order the old one's."""
        right, down = u_px - self.about_px[0], v_px - self.about_px[1]
        design = design_rows(right, down)
        covariance: FloatArray = design @ self.covariance @ design.T
        return covariance

    def _matrix(self) -> FloatArray:
        """Return scale and turn, (2, 2)."""
        turn, scale = math.radians(self.turn_deg), 1.0 + 1e-6 * self.scale_ppm
        cos, sin = scale * math.cos(turn), scale * math.sin(turn)
        return np.array([[cos, -sin], [sin, cos]])


def design_rows(right_px: float, down_px: float) -> FloatArray:
    """Return the motion of a place off the centroid, (2, 4) px by (shift px, px, turn °, scale ppm)."""
    turn, scale = math.radians(1.0), 1e-6
    return np.array(
        [[1.0, 0.0, -down_px * turn, right_px * scale], [0.0, 1.0, right_px * turn, down_px * scale]]
    )


@dataclass(frozen=True, slots=True, eq=False)
class TargetDrift:
    """Result of a check for one target.

    ``leds`` holds the state of each reference, in the calibration's order; ``leds_found`` counts those used.
    ``foreign_px`` are lights that switch with the LEDs and are none of them. ``similarity`` is None if too
    few LEDs were found. ``rms_px`` is the root mean square of the used LEDs' distances from it, per axis;
    ``is_similarity`` is False if that is more than their noise explains: then print, LEDs and camera
    disagree, and nothing is corrected. ``significance`` is the Mahalanobis distance of (shift, turn, scale)
    from none, √χ² with four degrees of freedom: chance alone exceeds 4.9 in one check of 10,000. ``detail``
    is a text for people on the findings, empty if all is well.
    """

    target: str
    leds_expected: int
    leds_found: int
    leds: tuple[LedState, ...]
    foreign_px: tuple[tuple[float, float], ...] = ()
    similarity: Similarity | None = None
    rms_px: float | None = None
    significance: float | None = None
    is_similarity: bool = True
    detail: str = ""

    @property
    def shift_px(self) -> list[float] | None:
        """Shift (u, v) in 0.0001 px; None: not known."""
        return None if self.similarity is None else [round(part, 4) for part in self.similarity.shift_px]


@dataclass(frozen=True, slots=True)
class DriftLimits:
    """Limits above which a drift matters, in units of the measurement.

    A drift counts by its effect on a measurement: ``…_mm`` on the position on any target, ``…_deg`` on yaw
    and pitch, at the beam's place and anywhere else in the calibrated area. Up to ``suspect_…`` the verdict
    is good. ``release_share``: suspect and bad clear once the drift is below that share of their
    limit. ``compensate_mm``: maximum correction of a position. ``min_leds``: with fewer LEDs the verdict is
    unknown.
    """

    suspect_mm: float = 0.03
    suspect_deg: float = 0.01
    bad_mm: float = 0.1
    bad_deg: float = 0.03
    release_share: float = 0.8
    compensate_mm: float = 0.5
    min_leds: int = 3


@dataclass(frozen=True, slots=True)
class PartVerdict:
    """Verdict on one part: a target, in mm, or ``yaw, pitch``, in °.

    ``error`` is the largest error anywhere in the calibrated area. Above ``suspect`` and ``bad`` it gives
    that verdict. ``error`` and ``sigma`` are None if too few LEDs were found.
    """

    of: str
    verdict: Verdict
    reason: str
    unit: str
    error: float | None
    sigma: float | None
    suspect: float
    bad: float


@dataclass(frozen=True, slots=True, eq=False)
class SelfCheck:
    """Result of one check.

    ``effects`` holds, by the keys of the beam (``yaw_deg``, ``pitch_deg``, ``x_mm``, ``y_mm``), the error
    that the drift causes at the beam's place, measured minus true, with its sigma; it is empty unless all of
    at least two targets could be judged. ``reasons`` are texts why the verdict is not good, worst first.
    ``is_whole`` is False if nothing is known of a target or of the direction: the verdict is then that of the
    rest. ``parts`` are the parts of the verdict, the worst first. ``notes`` are findings that do not change
    the verdict.
    """

    verdict: Verdict
    targets: Mapping[str, TargetDrift]
    effects: Mapping[str, Value]
    reasons: tuple[str, ...] = ()
    is_whole: bool = True
    parts: tuple[PartVerdict, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def sentence(self) -> str:
        """Verdict, reasons and notes as text."""
        because = "; ".join((*self.reasons, *self.notes))
        return f"{self.verdict}{f': {because}' if because else ''}"


def unknown(*reasons: str) -> SelfCheck:
    """Return a check without a verdict."""
    return SelfCheck(Verdict.UNKNOWN, {}, {}, reasons)
