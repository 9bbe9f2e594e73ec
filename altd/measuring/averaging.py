"""Robust mean over a window of frame sets, and the reasons why there is none."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Sequence
from functools import lru_cache
from typing import Protocol

import numpy as np

from altd.measuring.sampling import ScatterMemory
from altd.measuring.scintillation import averaged_residuals
from altd.reasons import Reason
from altd.records import Fault, FloatArray, FrameSet, MeanSpots, Spot, SpotShape
from altd.records.spots import SpotMotion
from altd.statistics import MAD_TO_SIGMA, median


def _motion(
    deviations_px: FloatArray,
    since_middle_s: FloatArray,
    exposure_covariance_px2: FloatArray,
    noise_px: FloatArray,
    newest: tuple[FloatArray, float] | None,
) -> SpotMotion | None:
    """Return the motion over n frame sets without outliers; None: too few.

    ``deviations_px`` (n, coordinates) are from their mean, at ``since_middle_s`` (n,) from the mean time;
    ``exposure_covariance_px2`` is the covariance of one frame set about steady motion, ``noise_px`` the
    spots' own noise. ``newest`` holds deviation and time of the newest frame set if it is an outlier: a beam
    that starts to move first appears as one, and does not move the mean.
    """
    if len(deviations_px) < _MIN_FRAME_SETS_FOR_MOTION:
        return None
    square_s2 = float(since_middle_s @ since_middle_s)
    rate = since_middle_s @ deviations_px / square_s2
    last_s = float(since_middle_s[-1])
    onset = np.zeros_like(rate)
    if newest is not None:
        newest_px, newest_s = newest
        onset = (newest_px - rate * newest_s) / (newest_s - last_s)
    return SpotMotion(
        rate_px_per_s=rate,
        rate_covariance=exposure_covariance_px2 / square_s2,
        vibration_px2=exposure_covariance_px2 - np.diag(np.square(noise_px)),
        onset_px_per_s=onset,
        onset_s=last_s,
        spread_s2=square_s2 / len(since_middle_s),
        span_s=last_s - float(since_middle_s[0]),
        newest_s=last_s if newest is None else newest[1],
    )


BoolArray = np.ndarray[tuple[int], np.dtype[np.bool_]]

_OUTLIER_SIGMAS = 6.0
_OUTLIER_USUAL = 4.0
"""A vibration reaches 2.8 standard deviations from a median at its crest."""
_MIN_FRAME_SETS_FOR_OUTLIERS = 4
"""Under vibration two of three frame sets are often close together; the third is then no outlier."""
_MAX_OUTLIER_FRACTION = 0.3
_MIN_GAP_SIGMAS = 10.0
_MIN_CLUSTER_FRAME_SETS = 2
"""Minimum size of a cluster: a single frame set is an outlier, or two are the scatter of a short window."""
_MAX_UNUSABLE_AT_END = 3
"""Number of unusable frame sets at the end of a window that mean a lost spot, regardless of earlier ones."""
_MIN_FRAME_SETS_FOR_MOTION = 4
_WARMING_UP = Fault(Reason.WARMING_UP, detail="half a window of exposures is needed first")
_PRIOR_WEIGHT = 2.0
"""Weight of the spots' own noise estimate against the observed scatter."""


class Window(Protocol):
    """Window over the last frame sets, with their mean."""

    def add(self, frame_set: FrameSet) -> MeanSpots | tuple[Fault, ...] | None:
        """Add a frame set; return the mean, the faults that prevent it, or None when no mean is due."""

    def skip(self, sequence: int) -> None:
        """Record the number of a frame set that is not measured, so that its absence causes no fault."""

    def forget(self) -> None:
        """Drop the frame sets before a gap; the count to the next mean continues."""

    def begin(self, window: int | None = None) -> None:
        """Drop all frame sets and restart the count to the next mean; ``window`` sets a new length."""


class FrameSetWindow:
    """Window over the last frame sets, with a mean after every ``every`` of them; 1 gives a sliding mean.

    Frame sets lost in all cameras at once appear only as gaps in the numbers. They occupy places in the
    window too, so a mean never reaches farther back because of them.
    """

    def __init__(
        self, targets: tuple[str, ...], window: int, every: int, memory: ScatterMemory | None = None
    ) -> None:
        """``memory``: what scatters no more than before is no outlier; None: nothing is known."""
        self._memory = memory
        self._targets = targets
        self._window = window
        self._every = every
        self._frame_sets: deque[FrameSet] = deque(maxlen=window)
        self._skipped: deque[int] = deque(maxlen=window)
        """Numbers of the frame sets that are not measured."""
        self._since_mean = 0

    def skip(self, sequence: int) -> None:
        """Record the number of a frame set that is not measured, so that its absence causes no fault."""
        self._skipped.append(sequence)

    def add(self, frame_set: FrameSet) -> MeanSpots | tuple[Fault, ...] | None:
        """Add a frame set; return the mean, the faults that prevent it, or None when no mean is due."""
        while self._frame_sets and frame_set.sequence - self._frame_sets[0].sequence >= self._window:
            self._frame_sets.popleft()
        while self._skipped and frame_set.sequence - self._skipped[0] >= self._window:
            self._skipped.popleft()
        self._frame_sets.append(frame_set)
        self._since_mean += 1
        if self._since_mean < self._every:
            return None
        self._since_mean = 0
        usual_px = None if self._memory is None else self._memory.scatter_px
        frame_sets, passed_over = tuple(self._frame_sets), len(self._skipped)
        mean = mean_spots(frame_sets, self._targets, self._window, passed_over, usual_px)
        more = averaged_residuals(frame_sets, mean)
        return mean if more is None else mean_spots(more, self._targets, self._window, passed_over, usual_px)

    def forget(self) -> None:
        """Drop the frame sets before a gap; the count to the next mean continues."""
        self._frame_sets.clear()
        self._skipped.clear()

    def begin(self, window: int | None = None) -> None:
        """Drop all frame sets and restart the count to the next mean; ``window`` sets a new length."""
        self._window = window or self._window
        self._frame_sets = deque(maxlen=self._window)
        self._skipped = deque(maxlen=self._window)
        self._since_mean = 0


def mean_spots(
    frame_sets: Sequence[FrameSet],
    targets: tuple[str, ...],
    window: int,
    passed_over: int = 0,
    usual_px: FloatArray | None = None,
) -> MeanSpots | tuple[Fault, ...]:
    """Return the mean of the usable frame sets of a window without outliers, or the faults that prevent it.

    A frame set is usable when every target has its spot. At least half a window must be usable, and at least
    one of the last three. If only the ``passed_over`` frame sets are missing for the half, the fault is
    ``warming_up``. A frame set more than six MAD-based standard deviations, and four ``usual_px`` (2 ·
    targets,), off the median in any coordinate is an outlier. With more than 30 % outliers, or two clusters
    of frame sets, the beam moved: ``unsteady``. If one camera exposes later than another, the mean spots
    still refer to one instant: steady motion between the two is subtracted, and the uncertainty of the time
    between them by jitter of their stamps is in the covariance. The excess of a spot's sigma by
    light that one spot does not explain is not averaged down, since it is the same in all frame sets. With
    three frame sets or fewer the motion is unknown.
    """
    rows = [_rows_of(frame_set, targets) for frame_set in frame_sets]
    is_lost = len(rows) >= _MAX_UNUSABLE_AT_END and all(row is None for row in rows[-_MAX_UNUSABLE_AT_END:])
    usable = [row for row in rows if row is not None]
    least = math.ceil(window / 2)
    if is_lost or len(usable) + passed_over < least:
        return _reasons_of_unusable(frame_sets)
    if len(usable) < least:
        return (_WARMING_UP,)
    spots = np.array(usable)
    px = spots[:, :, :2].reshape(len(usable), 2 * len(targets))
    typical_noise = np.repeat(median(spots[:, :, _SIGMA], axis=0), 2)
    is_inlier = _is_inlier(px, typical_noise, usual_px)
    count = int(np.count_nonzero(is_inlier))
    too_many = len(usable) - count > _MAX_OUTLIER_FRACTION * len(usable)
    if too_many or _has_two_clusters(px[is_inlier], typical_noise):
        return (Fault(Reason.UNSTEADY, detail="the beam moved while it was averaged"),)
    times_ns = [frame_set.t_ns for frame_set, row in zip(frame_sets, rows, strict=True) if row is not None]
    middle_ns = _middle_ns([t_ns for t_ns, near in zip(times_ns, is_inlier, strict=True) if near])
    since_middle_ns = np.array([t_ns - middle_ns for t_ns in times_ns], dtype=np.float64)
    inliers = spots[is_inlier]
    mean = inliers.mean(axis=0)
    deviations_px = px - mean[:, :2].ravel()
    newest = None if is_inlier[-1] else (deviations_px[-1], float(since_middle_ns[-1] * 1e-9))
    near_px, near_ns = deviations_px[is_inlier], since_middle_ns[is_inlier]
    speed = _speed_px_per_ns(near_px, near_ns)
    covariance_px2 = _covariance_of_mean(near_px, speed, near_ns, typical_noise)
    of_delays_px2 = _covariance_of_delays(inliers[:, :, _BEHIND_NS], speed)
    behind_ns = mean[:, _BEHIND_NS].tolist()
    return MeanSpots(
        targets=targets,
        px=mean[:, :2] - speed.reshape(-1, 2) * mean[:, _BEHIND_NS, None],
        covariance_px2=covariance_px2 + np.diag(np.repeat(mean[:, _EXCESS2], 2)) + of_delays_px2,
        t_ns=middle_ns,
        frames=count,
        lost=len(frame_sets) - len(usable),
        shapes=_mean_shapes(inliers),
        shape_parts=tuple(_mean_shapes(part) for part in np.array_split(inliers, min(_SHAPE_PARTS, count))),
        excess_px=tuple(math.sqrt(square) for square in mean[:, _EXCESS2].tolist()),
        log_lights=inliers[:, :, _LIGHT],
        motion=_motion(near_px, near_ns * 1e-9, covariance_px2 * count, typical_noise, newest),
        apart_s=(max(behind_ns) - min(behind_ns)) * 1e-9,
    )


_SIGMA, _EXCESS2, _BEHIND_NS, _LIGHT, _SHAPE = 2, 3, 4, slice(5, 7), slice(7, 11)
_LIGHT_SIGMA_DIAMETERS = 8.0
"""Relative noise of a Gaussian's volume per noise of its centre in 1/e² diameters: twice that of its peak
(Hagen and Dereniak, Applied Optics 47, 6842, 2008), because the width is as uncertain."""
_NO_SHAPE = (math.nan,) * 4
_SHAPE_PARTS = 3
"""Number of parts of a window whose shapes are compared: a disturbance of a third is not averaged down."""


@lru_cache(maxsize=256)
def _rows_of(frame_set: FrameSet, targets: tuple[str, ...]) -> FloatArray | None:
    """Return the numbers of the targets' spots, (targets, numbers); None if the frame set is not usable.

    They are kept, since a sliding window needs them as often as it has frame sets.
    """
    if frame_set.faults():
        return None
    return np.array([_numbers_of(frame_set, target) for target in targets])


def _numbers_of(frame_set: FrameSet, target: str) -> tuple[float, ...]:
    """Return u, v, sigma, excess², delay, log light and its sigma, and shape of a target's spot."""
    spot = frame_set.spots[target]
    assert isinstance(spot, Spot)  # noqa: S101  a usable frame set has only spots
    shape = spot.shape
    return (
        *(spot.u_px, spot.v_px, spot.sigma_px, spot.excess_px**2, frame_set.behind_ns.get(target, 0)),
        math.log(spot.light_per_ms) if spot.light_per_ms else math.nan,
        _LIGHT_SIGMA_DIAMETERS * spot.sigma_px / spot.diameter_px,
        *(_NO_SHAPE if shape is None else (shape.a, shape.b, shape.c, shape.order)),
    )


def _mean_shapes(spots: FloatArray) -> tuple[SpotShape | None, ...]:
    """Return the mean shape of each target's spots (frame sets, targets, numbers); None if none is known."""
    shapes = spots[:, :, _SHAPE]
    means = shapes.mean(axis=0)
    for target in np.flatnonzero(np.isnan(means[:, 0])):
        known = shapes[~np.isnan(shapes[:, target, 0]), target]
        means[target] = known.mean(axis=0) if len(known) else math.nan
    return tuple(None if math.isnan(a) else SpotShape(a, b, c, order) for a, b, c, order in means.tolist())


def _middle_ns(times_ns: Sequence[int]) -> int:
    return times_ns[0] + round(sum(t_ns - times_ns[0] for t_ns in times_ns) / len(times_ns))


def _is_inlier(px: FloatArray, noise: FloatArray, usual_px: FloatArray | None) -> BoolArray:
    """Return which rows of (n, coordinates) are near the median in every coordinate."""
    count = len(px)
    if count < _MIN_FRAME_SETS_FOR_OUTLIERS:
        return np.ones(count, bool)
    distance = np.abs(px - median(px, axis=0))
    # n / (n − 0.8) removes most of the MAD's bias in small samples
    scale = MAD_TO_SIGMA * median(distance, axis=0) * count / (count - 0.8)
    limit = _OUTLIER_SIGMAS * np.maximum(scale, noise)
    if usual_px is not None:
        limit = np.maximum(limit, _OUTLIER_USUAL * usual_px)
    near: BoolArray = np.all(distance <= limit, axis=1)
    return near


def _has_two_clusters(px: FloatArray, noise: FloatArray) -> bool:
    """Return whether (n, coordinates) form two clusters, as when the beam jumped halfway through a window.

    The median is then between them and nothing is an outlier. The largest gap between neighbouring values is
    far wider than the scatter on either side of it; steady motion and vibration leave no such gap.
    """
    ordered = np.sort(px, axis=0)
    gaps = ordered[1:] - ordered[:-1]
    if not len(gaps):
        return False
    largest = gaps.max(axis=0)
    # The least scatter of two sides whose ranges add up to the rest; a vibration has more.
    least = (ordered[-1] - ordered[0] - largest) / math.sqrt(4 * len(px))
    for column in np.flatnonzero(largest > _MIN_GAP_SIGMAS * (least + noise)):
        split = int(gaps[:, column].argmax()) + 1
        if not _MIN_CLUSTER_FRAME_SETS <= split <= len(px) - _MIN_CLUSTER_FRAME_SETS:
            continue
        sides = ordered[:split, column], ordered[split:, column]
        within = math.sqrt(sum(float(np.square(side - side.mean()).sum()) for side in sides) / len(px))
        if gaps[split - 1, column] > _MIN_GAP_SIGMAS * (within + noise[column]):
            return True
    return False


def _speed_px_per_ns(deviations: FloatArray, since_middle_ns: FloatArray) -> FloatArray:
    """Return the steady motion in each coordinate of (n, coordinates); 0 in a window that is too short."""
    if len(deviations) < _MIN_FRAME_SETS_FOR_MOTION:
        return np.zeros(deviations.shape[1])
    speed: FloatArray = since_middle_ns @ deviations / (since_middle_ns @ since_middle_ns)
    return speed


def _covariance_of_mean(
    deviations: FloatArray, speed: FloatArray, since_middle_ns: FloatArray, noise: FloatArray
) -> FloatArray:
    """Return the observed scatter of n frame sets over n, shrunk towards the spots' own noise for small n.

    Steady motion is removed first: it does not displace a mean that refers to the middle of its frame sets.
    """
    count = len(deviations)
    degrees_of_freedom = count - 1.0
    if count >= _MIN_FRAME_SETS_FOR_MOTION:
        deviations = deviations - since_middle_ns[:, None] * speed
        degrees_of_freedom -= 1
    scatter = deviations.T @ deviations + _PRIOR_WEIGHT * np.diag(np.square(noise))
    covariance: FloatArray = scatter / (degrees_of_freedom + _PRIOR_WEIGHT) / count
    return covariance


def _covariance_of_delays(behind_ns: FloatArray, speed: FloatArray) -> FloatArray | float:
    """Return the covariance of steady motion within the mean delays of (n, targets); 0: they do not vary.

    The spots do not show the jitter of the time stamps that say how far their exposures are apart.
    """
    count = len(behind_ns)
    deviations_ns = behind_ns - behind_ns.mean(axis=0)
    if count < _MIN_FRAME_SETS_FOR_MOTION or not deviations_ns.any():
        return 0.0
    delays_ns2 = deviations_ns.T @ deviations_ns / (count * (count - 1))
    return np.asarray(np.kron(delays_ns2, np.ones((2, 2))) * np.outer(speed, speed))


def _reasons_of_unusable(frame_sets: Sequence[FrameSet]) -> tuple[Fault, ...]:
    """Return the reasons of the unusable frame sets, most frequent first, each with its latest detail."""
    latest = {str(fault): fault for frame_set in frame_sets for fault in frame_set.faults()}
    counts = Counter(str(fault) for frame_set in frame_sets for fault in dict.fromkeys(frame_set.faults()))
    if not counts:
        return (_WARMING_UP,)
    return tuple(latest[code] for code, _ in counts.most_common())
