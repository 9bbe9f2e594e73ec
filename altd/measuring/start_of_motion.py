"""Lag between two targets' spots, from the first frame sets of a motion that starts at rest.

A machine that starts to move first moves in one way: the displacements of both spots from rest are one
function of time g, f(t) = a g(t) and r(t) = b g(t), for any pivot. If the pictures of the second spot are L
frame sets late, r(t) = b g(t − L). For each L the displacements f(t), r(t + L), in units of their noise, form
a matrix (m, 4) of rank one. The smaller three eigenvalues of its Gram matrix add up to the minimum χ², with 3
(m − 1) degrees of freedom (Golub and Van Loan, Matrix Computations, 6.3: total least squares).

A separate yaw motion can look like a late picture, if it leaves the first spot at rest and starts whole frame
sets later with the same course. Therefore a lag is a finding for sigma, not a reason to reject.
"""

from __future__ import annotations

from collections import deque

import numpy as np
import numpy.typing as npt

from altd.records import FloatArray
from altd.statistics import MAD_TO_SIGMA, median

MAX_LAG_FRAMES = 3
_TESTED_LAG_FRAMES = 4
"""Maximum tested lag: a best lag this large is at the edge of the test and shows another motion."""
_MIN_REST_FRAME_SETS = 16
_MAX_REST_FRAME_SETS = 40
_LEAD_FRAME_SETS = 8
"""Number of last frame sets at rest that may hold a slow start: they count as motion, not as its zero."""
_MIN_MOVING_FRAME_SETS = 6
_MIN_FOR_VIBRATION = 8
_EACH_FRAME_SET_UP_TO = 40
_LATER_INTERVAL_FRAME_SETS = 10
_MAX_MOVING_FRAME_SETS = 180
"""Maximum length of an undecided motion; by then vibration has shown the lag of a machine that vibrates."""
_DEPARTURE_SIGMAS = 6.0
_MIN_CHI2_DIFFERENCE = 40.0
"""Six standard deviations between the lag that fits and the others."""
_MIN_CHI2_NEIGHBOUR = 9.0
"""Minimum difference to other lags: a lag between whole frame sets is a motion and not a late picture."""
_MAX_MISFIT = 2.0
"""Maximum χ² per degree of freedom: above it the motion is not one function of time."""


class StartOfMotion:
    """Watches the spots of two targets until they leave their rest, then until their lag is decided."""

    def __init__(self) -> None:
        self._rest: deque[FloatArray] = deque(maxlen=_MAX_REST_FRAME_SETS)
        self._rest_sum = np.zeros(4)
        self._moving: list[FloatArray] = []
        self._times_ns: list[int] = []
        """Times of the frame sets in motion."""

    @property
    def is_open(self) -> bool:
        """Whether the spots move from a known rest and their lag is not decided."""
        return bool(self._moving)

    def restart(self) -> None:
        """Forget rest and motion."""
        self._rest.clear()
        self._rest_sum = np.zeros(4)
        self._moving.clear()
        self._times_ns.clear()

    def add(self, places_px: FloatArray, noise_px: FloatArray, t_ns: int) -> int | None:
        """Add u, v of both spots (4,), their noise and the time of the frame set.

        Returns the second spot's lag in frame sets once this frame set decides it, 0: none; otherwise None.
        """
        if self._moving:
            self._moving.append(places_px)
            self._times_ns.append(t_ns)
            moving = len(self._moving)
            is_due = moving <= _EACH_FRAME_SET_UP_TO or moving % _LATER_INTERVAL_FRAME_SETS == 0
            lag = self._lag(noise_px) if is_due else None
            if lag is not None or moving >= _MAX_MOVING_FRAME_SETS:
                self.restart()
            return lag
        if self._rest:
            zero = self._rest_sum / len(self._rest)
            if (np.abs(places_px - zero) > _DEPARTURE_SIGMAS * noise_px).any():
                if len(self._rest) >= _MIN_REST_FRAME_SETS:
                    self._moving.append(places_px)
                    self._times_ns.append(t_ns)
                    return None
                self.restart()
        if len(self._rest) == _MAX_REST_FRAME_SETS:
            self._rest_sum -= self._rest[0]
        self._rest.append(places_px)
        self._rest_sum += places_px
        return None

    def _lag(self, noise_px: FloatArray) -> int | None:
        if len(self._moving) < _MIN_MOVING_FRAME_SETS:
            return None
        rest = np.array(self._rest)
        zero = rest[:-_LEAD_FRAME_SETS].mean(axis=0)
        if len(self._moving) >= _MIN_FOR_VIBRATION:
            rough = np.abs(_third_differences(np.array(self._moving), np.array(self._times_ns)))
            noise_px = np.maximum(noise_px, MAD_TO_SIGMA * median(rough, axis=0))
        rows = (np.concatenate([rest[-_LEAD_FRAME_SETS:], self._moving]) - zero) / noise_px
        excess, misfit = _chi2_by_half_lags(rows[:, :2], rows[:, 2:])
        whole = excess[::2].copy()
        best = int(whole.argmin())
        lag = best - _TESTED_LAG_FRAMES
        at_best, whole[best] = whole[best], np.inf
        if misfit[2 * best] > _MAX_MISFIT or abs(lag) > MAX_LAG_FRAMES:
            return None
        if lag == 0:
            return 0 if whole.min() - at_best > _MIN_CHI2_DIFFERENCE else None
        others = np.delete(excess, 2 * best)
        is_late = whole[_TESTED_LAG_FRAMES] - at_best > _MIN_CHI2_DIFFERENCE
        return lag if is_late and others.min() - at_best > _MIN_CHI2_NEIGHBOUR else None


def _third_differences(places_px: FloatArray, times_ns: npt.NDArray[np.int64]) -> FloatArray:
    """Return the divided differences (n − 3, 4) in units of a place's noise: all of a smooth motion."""
    places = np.lib.stride_tricks.sliding_window_view(places_px, 4, axis=0)
    t_s = np.lib.stride_tricks.sliding_window_view((times_ns - times_ns[0]) * 1e-9, 4)
    apart_s = t_s[:, :, None] - t_s[:, None, :] + np.eye(4)
    weights = 1.0 / apart_s.prod(axis=2)
    weights /= np.linalg.norm(weights, axis=1, keepdims=True)
    differences: FloatArray = np.einsum("ncj,nj->nc", places, weights)
    return differences


def _chi2_by_half_lags(first: FloatArray, other: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return χ² less its degrees of freedom, and per degree, for lags of −4, −3.5 … 4 frame sets (17,)."""
    between = (first[1:] + first[:-1]) / 2
    excess, misfit = [], []
    for half_lags in range(-2 * _TESTED_LAG_FRAMES, 2 * _TESTED_LAG_FRAMES + 1):
        lag, is_half = divmod(half_lags, 2)
        a, b = (between, other[1:]) if is_half else (first, other)
        count = len(a) - abs(lag)
        pairs = np.hstack([a[max(-lag, 0) :][:count], b[max(lag, 0) :][:count]])
        chi2 = float(np.linalg.eigvalsh(pairs.T @ pairs)[:3].sum())
        degrees_of_freedom = 3 * (count - 1)
        excess.append(chi2 - degrees_of_freedom)
        misfit.append(chi2 / degrees_of_freedom)
    return np.array(excess), np.array(misfit)
