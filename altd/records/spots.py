"""Spots in frames, their means over a window, and the motion of spots and beam.

A value is the mean of a past window, or the position of the window's steady motion at its newest exposure
(``MeanSpots.at_newest``). ``Motion.variance_since`` gives the mean square of the true value's distance from
it since then.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from altd.reasons import Reason, Scope
from altd.records.faults import Fault, FaultCause
from altd.records.frames import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class SpotMotion:
    """Motion of the mean spots of a window, u and v of one target after the other, (2 · targets,).

    ``rate_px_per_s`` is the steady motion, ``rate_covariance`` its covariance, px²/s². ``vibration_px2`` is
    the covariance of a single exposure about the steady motion without the spots' own noise: an estimate,
    whose variances may be negative. ``onset_px_per_s`` is the rate at which the newest exposure left the
    others if it is an outlier, else zero; ``onset_s`` is the time of the last of the others. ``spread_s2`` is
    the mean square of the exposures' times. Times count from the middle of the exposures, ``span_s`` is from
    the first to the last, ``newest_s`` is that of the newest exposure, outlier or not. The spots are those at
    ``at_s``.
    """

    rate_px_per_s: npt.NDArray[np.float64]
    rate_covariance: npt.NDArray[np.float64]
    vibration_px2: npt.NDArray[np.float64]
    onset_px_per_s: npt.NDArray[np.float64]
    onset_s: float
    spread_s2: float
    span_s: float
    newest_s: float
    at_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Motion:
    """Motion of one quantity, in its own unit and per second.

    ``rate`` with ``sigma_rate`` is that of the window. ``vibration`` is the standard deviation of the true
    value about the steady motion. ``probable_rate`` is the root mean square of the possible rate,
    ``acceleration`` that of its change in a second, both from earlier windows; None: not known yet.
    ``onset``, ``onset_s``, ``spread_s2`` and ``at_s`` are as in ``SpotMotion``. ``is_in_sigma``: the sigma of
    the value includes the motion at its own instant.
    """

    rate: float
    sigma_rate: float
    vibration: float
    onset: float
    onset_s: float
    spread_s2: float
    probable_rate: float | None = None
    acceleration: float | None = None
    at_s: float = 0.0
    is_in_sigma: bool = False

    def variance_since(self, age_s: float) -> float | None:
        """Return the mean square of the true value's distance from the value, ``age_s`` later.

        It adds to the variance of the value itself. None: not known. A mean of uniformly accelerated motion
        is ahead of the middle by half the acceleration times ``spread_s2``, and so is the line through it:
        the acceleration does not change its slope. Vibration counts in full at any age: 20 exposures per
        second cannot distinguish 2 Hz from 22, so its phase is not known. Rate and acceleration are treated
        as independent, because one may end or reverse at any time.
        """
        then, own = self.parts_since(age_s), self.parts_since(0.0) if self.is_in_sigma else ()
        return None if then is None or own is None else sum(x * x for x in then) - sum(x * x for x in own)

    def parts_since(self, age_s: float) -> tuple[float, float, float, float] | None:
        """Return the distances by vibration, rate, acceleration and onset; None: not known."""
        if self.probable_rate is None or self.acceleration is None:
            return None
        since_middle_s = self.at_s + age_s
        return (
            self.vibration,
            self.probable_rate * age_s,
            0.5 * self.acceleration * (since_middle_s**2 - self.spread_s2),
            self.onset * max(since_middle_s - self.onset_s, 0.0),
        )


@dataclass(frozen=True, slots=True)
class SpotShape:
    """Shape of a spot, E = peak · exp(−q^order), q = ½ (a du² + 2 b du dv + c dv²); a, b, c in 1/px²."""

    a: float
    b: float
    c: float
    order: float


@dataclass(frozen=True, slots=True, eq=False)
class Unexplained:
    """The light of a spot that one spot does not explain.

    ``scores`` (2, patterns) are projections of the residuals onto patterns, and the patterns' amplitudes. The
    sum of their products is a chi-square, up to ``usual`` in good spots; ``bias_px`` is the possible
    displacement, one sigma, per root of the rest.
    """

    scores: FloatArray
    usual: float
    bias_px: float

    @property
    def displacement_px(self) -> float:
        """Possible displacement of the spot, one sigma."""
        return self.bias_px * math.sqrt(max(float(self.scores[0] @ self.scores[1]) - self.usual, 0.0))


@dataclass(frozen=True, slots=True)
class Spot:
    """A laser spot in one frame: centroid, its noise, 1/e² diameter, peak over background in counts.

    ``excess_px`` is the standard deviation, in u and in v, added to that of a good spot by light that does
    not fit one spot and by a picture that moved; averaging does not reduce it. ``shape`` is None if no
    profile was fitted. ``light_per_ms`` is the light of the whole spot for 1 ms of exposure and 0 dB of gain,
    counts · px² / ms; None: not known. ``unexplained`` is the part of ``excess_px`` by the residuals of the
    fit; None: good spots have as much.
    """

    u_px: float
    v_px: float
    sigma_px: float
    diameter_px: float
    peak: float
    excess_px: float = 0.0
    shape: SpotShape | None = None
    light_per_ms: float | None = None
    unexplained: Unexplained | None = field(default=None, compare=False, repr=False)

    def __str__(self) -> str:
        """Return a description for the technician who aims the beam."""
        return (
            f"spot at u {self.u_px:.1f} v {self.v_px:.1f} px, diameter {self.diameter_px:.0f} px, "
            f"peak {self.peak:.0f} counts"
        )


@dataclass(frozen=True, slots=True)
class NoSpot:
    """Reason why a frame gives no spot.

    ``spot`` is the spot of a distorted frame that may be measured together with others
    (``measuring.scintillation``).
    """

    reason: Reason
    detail: str = ""
    cause: FaultCause | None = None
    spot: Spot | None = field(default=None, compare=False, repr=False)

    def __str__(self) -> str:
        """Return a description for the technician who searches for the fault."""
        return f"{self.reason}, {self.detail}" if self.detail else str(self.reason)

    def fault(self, target: str) -> Fault:
        """Return the reason as a fault of the target, or of the whole unit if it concerns all of it."""
        return Fault(
            self.reason, target if self.reason.scope is Scope.TARGET else None, self.detail, self.cause
        )


@dataclass(frozen=True, slots=True, eq=False)
class FrameSet:
    """Spots of one instant: a spot, or the reason why there is none, per target.

    ``t_ns`` is the mean of the frames' times. ``behind_ns`` gives a target's delay after it; a missing target
    has none. ``opaque`` names the target that was switched to be measured; empty: all are measured.
    """

    sequence: int
    t_ns: int
    spots: Mapping[str, Spot | NoSpot]
    behind_ns: Mapping[str, int] = field(default_factory=dict)
    opaque: str = ""

    def faults(self) -> tuple[Fault, ...]:
        """Return the reasons why this frame set cannot be used; empty if every target has its spot."""
        return tuple(spot.fault(target) for target, spot in self.spots.items() if isinstance(spot, NoSpot))


@dataclass(frozen=True, slots=True, eq=False)
class MeanSpots:
    """The mean spots of a window of exposures.

    ``px`` (targets, 2) contains u, v in the order of ``targets``; ``covariance_px2`` (2 · targets, 2 ·
    targets) is that of the means, u and v of one target after the other: vibration moves all spots together.
    ``shapes`` contains the mean shape of each target's spots, None if one was not fitted; ``shape_parts``
    those of the first, middle and last third of the exposures. ``excess_px`` is the part of each sigma that
    averaging does not reduce; the covariance includes it. ``log_lights`` (frames, targets, 2) contains the
    logarithm of each spot's light per ms and its standard deviation, NaN if not known. ``changed_light`` is
    the relative change of each target's light against the first's (``LightBalance``). ``t_ns`` is the mean
    time of the ``frames`` averaged exposures; ``lost`` were not usable. ``motion`` is None if there were too
    few to determine it. ``is_even``: a vibration at a multiple of the frame rate would not show in the
    covariance (``measuring.sampling``). ``apart_s`` is the mean time between the exposures of two targets.
    """

    targets: tuple[str, ...]
    px: FloatArray
    covariance_px2: FloatArray
    t_ns: int
    frames: int
    lost: int
    shapes: tuple[SpotShape | None, ...] = ()
    shape_parts: tuple[tuple[SpotShape | None, ...], ...] = ()
    excess_px: tuple[float, ...] = ()
    log_lights: FloatArray | None = None
    changed_light: tuple[float, ...] = ()
    motion: SpotMotion | None = None
    is_even: bool = True
    apart_s: float = 0.0

    def at_newest(self) -> MeanSpots | None:
        """Return the spots at the newest exposure by the steady motion of all; None: motion not known.

        A straight line through the window: its mean and its slope are uncorrelated.
        """
        if self.motion is None:
            return None
        at_s = self.motion.newest_s
        return replace(
            self,
            px=self.px + at_s * self.motion.rate_px_per_s.reshape(-1, 2),
            covariance_px2=self.covariance_px2 + at_s**2 * self.motion.rate_covariance,
            t_ns=self.t_ns + round(at_s * 1e9),
            motion=replace(self.motion, at_s=at_s),
        )


GLASS_INDEX = 1.52
"""Refractive index of window glass, float or crown, in red light."""


@dataclass(frozen=True, slots=True)
class Glass:
    """Plane-parallel glass behind a target's printed surface: its thickness and its refractive index."""

    thickness_mm: float
    index: float = GLASS_INDEX

    def __str__(self) -> str:
        return f"{self.thickness_mm:g} mm of glass (index {self.index:g})"


@dataclass(frozen=True, slots=True, eq=False)
class TargetPoint:
    """Intersection of the beam with one target, mm in the unit frame.

    ``jacobian_mm_per_px`` is d(x, y)/d(u, v) there; ``covariance_mm2`` (2 × 2) is the uncertainty from print,
    speckle and map, without the scatter of the spot.
    """

    x_mm: float
    y_mm: float
    jacobian_mm_per_px: FloatArray
    covariance_mm2: FloatArray


@dataclass(frozen=True, slots=True)
class CrossCheckedSpot:
    """Mean spot on a target that was mapped, px, and the beam's place by the target's second map, mm."""

    u_px: float
    v_px: float
    x_mm: float
    y_mm: float


@dataclass(frozen=True, slots=True)
class CrossCheckedBeam:
    """The beam through its places by the second maps (thesis Fig. A.1), for diagnosis alone.

    The angles are in the controller's coordinates, as the published ones are.
    """

    yaw_deg: float
    pitch_deg: float
    spots: Mapping[str, CrossCheckedSpot]
