"""The robust mean over a window of exposures, and when there is none."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Sequence

import numpy as np

from altd.reasons import Reason
from altd.records import Exposure, Fault, FloatArray, MeanSpots, Spot, SpotShape
from altd.statistics.robust import MAD_TO_SIGMA, median

_OUTLIER_SIGMAS = 6.0
_MIN_FOR_OUTLIERS = 4
"""Of three exposures under vibration two often lie close together, and the third is no outlier."""
_MAX_OUTLIER_FRACTION = 0.3
_GAP_SIGMAS = 10.0
_MIN_IN_A_CLUSTER = 2
"""A single exposure is no place: it is an outlier, or with its neighbour the scatter of a short window."""
_MAX_UNUSABLE_AT_END = 3
"""So many unusable exposures at the end of a window: the spot is lost, whatever came before."""
_MIN_FOR_MOTION = 4
_PRIOR_WEIGHT = 2.0
"""Weight of the spots' own noise estimate against the observed scatter."""


class ExposureWindow:
    """The last exposures, and their mean after every so many: 1 is the sliding mean.

    Exposures that were lost in all cameras at once show only in the numbers, and fill places of the window
    too: a mean never reaches farther back because of them.
    """

    def __init__(self, targets: tuple[str, ...], window: int, every: int) -> None:
        self._targets = targets
        self._window = window
        self._every = every
        self._exposures: deque[Exposure] = deque(maxlen=window)
        self._since_mean = 0

    def add(self, exposure: Exposure) -> MeanSpots | tuple[Fault, ...] | None:
        """Take an exposure; returns the mean, or why there is none, or None when it is not time yet."""
        while self._exposures and exposure.sequence - self._exposures[0].sequence >= self._window:
            self._exposures.popleft()
        self._exposures.append(exposure)
        self._since_mean += 1
        if self._since_mean < self._every:
            return None
        self._since_mean = 0
        return mean_spots(tuple(self._exposures), self._targets, self._window)

    def forget(self) -> None:
        """Drop the exposures that came before a gap; the count to the next mean goes on."""
        self._exposures.clear()

    def begin(self, window: int | None = None) -> None:
        """Drop all exposures and count to the next mean anew, from now on over ``window`` exposures."""
        self._window = window or self._window
        self._exposures = deque(maxlen=self._window)
        self._since_mean = 0


def mean_spots(
    exposures: Sequence[Exposure], targets: tuple[str, ...], window: int
) -> MeanSpots | tuple[Fault, ...]:
    """Mean of the usable exposures of a window, without outliers.

    An exposure is usable when every target has its spot. At least half a window must be usable, and the
    last three must not all be bad. An exposure that lies six robust sigmas off the median in any
    coordinate counts for none; when that is true of more than 30 %, or when the exposures fall into two
    places, the beam moved: ``unsteady``. Where one camera exposes behind another, the mean spots are those of
    one instant all the same: steady motion between the two is taken off. What light that one spot does not
    explain adds to a spot's sigma stays in the mean: it is the same in all exposures.
    """
    usable = [exposure for exposure in exposures if not exposure.faults()]
    is_lost = len(exposures) >= _MAX_UNUSABLE_AT_END and all(
        e.faults() for e in exposures[-_MAX_UNUSABLE_AT_END:]
    )
    if is_lost or len(usable) < math.ceil(window / 2):
        return _reasons_of_unusable(exposures)
    spots = [[_spot(exposure, target) for target in targets] for exposure in usable]
    px = np.array([[c for spot in row for c in (spot.u_px, spot.v_px)] for row in spots])
    typical_noise = np.repeat(median(np.array([[spot.sigma_px for spot in row] for row in spots]), axis=0), 2)
    is_inlier = _is_inlier(px, typical_noise)
    too_many = np.count_nonzero(~is_inlier) > _MAX_OUTLIER_FRACTION * len(usable)
    if too_many or _has_two_clusters(px[is_inlier], typical_noise):
        return (Fault(Reason.UNSTEADY, detail="the beam moved while it was averaged"),)
    inliers = [exposure for exposure, near in zip(usable, is_inlier, strict=True) if near]
    middle_ns = _middle_ns([exposure.t_ns for exposure in inliers])
    since_middle_ns = np.array([exposure.t_ns - middle_ns for exposure in inliers], dtype=np.float64)
    mean = px[is_inlier].mean(axis=0)
    speed = _speed_px_per_ns(px[is_inlier] - mean, since_middle_ns)
    covariance_px2 = _covariance_of_mean(px[is_inlier] - mean, speed, since_middle_ns, typical_noise)
    by_target = [[_spot(exposure, target) for exposure in inliers] for target in targets]
    excess_px2 = [sum(spot.excess_px**2 for spot in of_target) / len(inliers) for of_target in by_target]
    return MeanSpots(
        targets=targets,
        px=(mean - speed * np.repeat(_behind_ns(inliers, targets), 2)).reshape(len(targets), 2),
        covariance_px2=covariance_px2 + np.diag(np.repeat(excess_px2, 2)),
        t_ns=middle_ns,
        frames=int(np.count_nonzero(is_inlier)),
        lost=len(exposures) - len(usable),
        shapes=tuple(_mean_shape(of_target) for of_target in by_target),
        excess_px=tuple(math.sqrt(square) for square in excess_px2),
    )


def _mean_shape(spots: Sequence[Spot]) -> SpotShape | None:
    shapes = [spot.shape for spot in spots if spot.shape is not None]
    if not shapes:
        return None
    of_all = np.array([(shape.a, shape.b, shape.c, shape.order) for shape in shapes])
    return SpotShape(*of_all.mean(axis=0).tolist())


def _middle_ns(times_ns: Sequence[int]) -> int:
    return times_ns[0] + round(sum(t_ns - times_ns[0] for t_ns in times_ns) / len(times_ns))


def _spot(exposure: Exposure, target: str) -> Spot:
    spot = exposure.spots[target]
    assert isinstance(spot, Spot)  # noqa: S101  a usable exposure has nothing else
    return spot


def _is_inlier(px: FloatArray, noise: FloatArray) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Which rows of (n, coordinates) lie near the median in every coordinate."""
    count = len(px)
    if count < _MIN_FOR_OUTLIERS:
        return np.ones(count, bool)
    distance = np.abs(px - median(px, axis=0))
    # n / (n − 0.8) takes out most of the MAD's bias in small samples
    scale = MAD_TO_SIGMA * median(distance, axis=0) * count / (count - 0.8)
    near: np.ndarray[tuple[int], np.dtype[np.bool_]] = np.all(
        distance <= _OUTLIER_SIGMAS * np.maximum(scale, noise), axis=1
    )
    return near


def _has_two_clusters(px: FloatArray, noise: FloatArray) -> bool:
    """Whether (n, coordinates) fall into two places, as when the beam jumped half way through a window.

    Then the median lies between them and nothing is an outlier. The largest gap between neighbouring values
    is far wider than what lies on either side of it; steady motion and vibration leave no such gap.
    """
    ordered = np.sort(px, axis=0)
    gaps = ordered[1:] - ordered[:-1]
    if not len(gaps):
        return False
    for column in np.flatnonzero(gaps.max(axis=0) > _GAP_SIGMAS * noise):
        split = int(gaps[:, column].argmax()) + 1
        if not _MIN_IN_A_CLUSTER <= split <= len(px) - _MIN_IN_A_CLUSTER:
            continue
        sides = ordered[:split, column], ordered[split:, column]
        within = math.sqrt(sum(float(np.square(side - side.mean()).sum()) for side in sides) / len(px))
        if gaps[split - 1, column] > _GAP_SIGMAS * (within + noise[column]):
            return True
    return False


def _behind_ns(exposures: Sequence[Exposure], targets: tuple[str, ...]) -> FloatArray:
    """How far behind its exposure's time each target was exposed, on the mean, (targets,)."""
    behind_ns = np.array([[e.behind_ns.get(t, 0) for t in targets] for e in exposures], dtype=np.float64)
    mean: FloatArray = behind_ns.mean(axis=0)
    return mean


def _speed_px_per_ns(deviations: FloatArray, since_middle_ns: FloatArray) -> FloatArray:
    """Steady motion in each coordinate of (n, coordinates); none in a window too short to tell."""
    if len(deviations) < _MIN_FOR_MOTION:
        return np.zeros(deviations.shape[1])
    speed: FloatArray = since_middle_ns @ deviations / (since_middle_ns @ since_middle_ns)
    return speed


def _covariance_of_mean(
    deviations: FloatArray, speed: FloatArray, since_middle_ns: FloatArray, noise: FloatArray
) -> FloatArray:
    """Observed scatter of n exposures over n, drawn towards the spots' own noise while n is small.

    Steady motion is taken out first: it moves no mean that is given for the middle of its exposures.
    """
    count = len(deviations)
    degrees_of_freedom = count - 1.0
    if count >= _MIN_FOR_MOTION:
        deviations = deviations - since_middle_ns[:, None] * speed
        degrees_of_freedom -= 1
    scatter = deviations.T @ deviations + _PRIOR_WEIGHT * np.diag(np.square(noise))
    covariance: FloatArray = scatter / (degrees_of_freedom + _PRIOR_WEIGHT) / count
    return covariance


def _reasons_of_unusable(exposures: Sequence[Exposure]) -> tuple[Fault, ...]:
    """The reasons of the unusable exposures, most frequent first, each with its latest detail."""
    latest = {str(fault): fault for exposure in exposures for fault in exposure.faults()}
    counts = Counter(str(fault) for exposure in exposures for fault in dict.fromkeys(exposure.faults()))
    if not counts:
        return (Fault(Reason.WARMING_UP, detail="half a window of exposures is needed first"),)
    return tuple(latest[code] for code, _ in counts.most_common())
