"""The nouns of the self-check: what it is given and what it says."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Any

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
    """One target in one check: frames with its frame LEDs on and frames with them off, one at least of each.

    All are of one camera, size and depth; frames in which the LEDs were switched are none of them. The laser
    spot may be in them, and need not stand still.
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
        """Shift_u_px, shift_v_px, turn_deg, scale_ppm, as (4,)."""
        return np.array([*self.shift_px, self.turn_deg, self.scale_ppm])

    def now_px(self, then_px: FloatArray) -> FloatArray:
        """The current places, (n, 2), of places (n, 2) of the calibrated picture."""
        about = np.asarray(self.about_px)
        now: FloatArray = about + self.shift_px + (then_px - about) @ self._matrix().T
        return now

    def then_px(self, now_px: FloatArray) -> FloatArray:
        """The places (n, 2) in the calibrated picture of places (n, 2) of the current one."""
        about = np.asarray(self.about_px)
        then: FloatArray = about + (now_px - about - self.shift_px) @ np.linalg.inv(self._matrix()).T
        return then

    @property
    def affine(self) -> FloatArray:
        """The same as (2, 3): now = affine · (u, v, 1) of then, as OpenCV takes it."""
        matrix = self._matrix()
        about = np.asarray(self.about_px)
        return np.column_stack([matrix, about + self.shift_px - matrix @ about])

    def covariance_at_px2(self, u_px: float, v_px: float) -> FloatArray:
        """Covariance (2, 2) in px² of where a place is seen now (to first order: of where it was, too)."""
        right, down = u_px - self.about_px[0], v_px - self.about_px[1]
        design = design_rows(right, down)
        covariance: FloatArray = design @ self.covariance @ design.T
        return covariance

    def _matrix(self) -> FloatArray:
        """Scale and turn, (2, 2)."""
        turn, scale = math.radians(self.turn_deg), 1.0 + 1e-6 * self.scale_ppm
        cos, sin = scale * math.cos(turn), scale * math.sin(turn)
        return np.array([[cos, -sin], [sin, cos]])


def design_rows(right_px: float, down_px: float) -> FloatArray:
    """The motion of a place so far from the centroid, (2, 4) px by (shift px, px, turn °, scale ppm)."""
    turn, scale = math.radians(1.0), 1e-6
    return np.array(
        [[1.0, 0.0, -down_px * turn, right_px * scale], [0.0, 1.0, right_px * turn, down_px * scale]]
    )


@dataclass(frozen=True, slots=True, eq=False)
class TargetDrift:
    """The result of a check for one target.

    ``leds`` holds the state of each reference, in the calibration's order; ``leds_found`` counts those
    used. ``foreign_px`` are lights that switch with the LEDs and are none of them. ``similarity`` is None
    where too few LEDs were found. ``rms_px`` is the root mean square of the used LEDs' distances from it, an
    axis; ``is_similarity`` is False where that is more than their noise explains: then print, LEDs and camera
    disagree, and nothing is corrected. ``significance`` is the Mahalanobis distance of (shift, turn, scale)
    from none, √χ² with four degrees of freedom: chance alone exceeds 4.9 in one check of 10,000.
    ``detail`` says for people what was seen, empty when all is well.
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


@dataclass(frozen=True, slots=True)
class Limits:
    """From where on a drift matters, in units of the measurement.

    A drift counts by what it would do to a measurement: ``…_mm`` to the place on any target, ``…_deg`` to
    yaw and pitch, at the beam's place and wherever else in the calibrated area it may be. Up to ``suspect_…``
    all is good. ``release_share``: a verdict that is worse than good ends once the drift is below that share
    of its limit. ``compensate_mm``: no place is corrected by more than that. ``min_leds``: with fewer the
    verdict is unknown.
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
    """The verdict on one part: a target, in mm, or ``yaw, pitch``, in °.

    ``error`` is the largest error anywhere in the calibrated area. Above ``suspect`` and ``bad``
    it gives that verdict. ``error`` and ``sigma`` are None if too few LEDs were found.
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
    """The result of one check.

    ``effects`` holds, by the keys of the beam (``yaw_deg``, ``pitch_deg``, ``x_mm``, ``y_mm``), what the
    drift makes of a measurement at the beam's place, measured minus true, with its sigma; it is empty where
    no two targets could be judged. ``reasons`` says in words what kept it from being good, worst first.
    ``is_whole`` is False where of a target, or of the direction, nothing is known: the verdict is then that
    of the rest. ``parts`` are the parts of the verdict, the worst first.
    """

    verdict: Verdict
    targets: Mapping[str, TargetDrift]
    effects: Mapping[str, Value]
    reasons: tuple[str, ...] = ()
    is_whole: bool = True
    parts: tuple[PartVerdict, ...] = ()


_DECIMALS = {"x_mm": 4, "y_mm": 4, "yaw_deg": 5, "pitch_deg": 5}
_KEYS = ("yaw_deg", "pitch_deg", "x_mm", "y_mm")


def as_object(check: SelfCheck) -> dict[str, Any]:
    """The answer of ``altd selfcheck``; unknown values are null."""
    effects = check.effects
    values = {key: round(effects[key].value, _DECIMALS[key]) if key in effects else None for key in _KEYS}
    sigmas = {key: effects[key].sigma if key in effects else None for key in _KEYS}
    return {
        "verdict": str(check.verdict),
        "reasons": list(check.reasons),
        "parts": [_of_part(part) for part in check.parts],
        "targets": {name: _of_target(drift) for name, drift in check.targets.items()},
        **values,
        "sigma": {
            key: None if sigma is None else round(sigma, _DECIMALS[key]) for key, sigma in sigmas.items()
        },
    }


def _of_part(part: PartVerdict) -> dict[str, Any]:
    known = {
        key: round(value, 5) if isinstance(value, float) else value for key, value in asdict(part).items()
    }
    del known["reason"]
    return {**known, "verdict": str(part.verdict)}


def _of_target(drift: TargetDrift) -> dict[str, Any]:
    fitted = drift.similarity
    return {
        "leds_expected": drift.leds_expected,
        "leds_found": drift.leds_found,
        "shift_px": None if fitted is None else [round(part, 4) for part in fitted.shift_px],
        "turn_deg": None if fitted is None else round(fitted.turn_deg, 5),
        "scale_ppm": None if fitted is None else round(fitted.scale_ppm, 1),
        "rms_px": None if drift.rms_px is None else round(drift.rms_px, 4),
        "significance": None if drift.significance is None else round(drift.significance, 2),
        "is_similarity": None if fitted is None else drift.is_similarity,
        "leds": [str(state) for state in drift.leds],
        "foreign_px": [[round(u, 1), round(v, 1)] for u, v in drift.foreign_px],
        "detail": drift.detail,
    }
