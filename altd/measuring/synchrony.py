"""Check whether the targets' spots move at the same instants, or one camera is whole frames late.

A picture that waited in a buffer and was stamped on leaving it has a wrong time that no stamp reveals. But
the machine moves all targets at once: new motion of one spot, from one frame set to the next, must appear in
the others in the same frame set.

This is the cross-correlation of prewhitened series (Box and Jenkins, Time Series Analysis, 12.2): an
autoregression fitted to the steps of the first spot leaves their unpredictable part; the same filter is
applied to the steps of the other spot. Then m · ‖C_L‖², C_L the 2 × 2 correlation at lag L over m frame sets,
follows a χ² with four degrees of freedom if the two are independent at that lag, whatever spectrum either
has. A vibration at one frequency is predictable, so its phase has no effect.

Between uneven exposures the filter predicts velocities. It leaves more of a vibration, but there a phase
between the spots is not a lag of whole frame sets.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace

import numpy as np

from altd.measuring.start_of_motion import StartOfMotion
from altd.records import FloatArray, FrameSet, MeanSpots, Spot, counted
from altd.statistics import MAD_TO_SIGMA, median

_WINDOW_FRAME_SETS = 200
"""Number of frame sets compared: 10 s at 20 per second."""
_MIN_FRAME_SETS = 100
_INTERVAL_FRAME_SETS = 20
"""Number of frame sets from one comparison to the next."""
_AUTOREGRESSION_ORDER = 8
"""Order of the autoregression, enough for four lines of vibration."""
_MAX_LAG_FRAMES = 4
_MIN_CHI = 9.0
"""Minimum root of χ²: with four degrees of freedom a larger one has a probability of 1e-16."""
_MIN_CHI_DIFFERENCE = 6.0
_CLIP_SIGMAS = 4.0
_MAX_INTERVAL_PERIODS = 1.75
"""Maximum interval between two frame sets, per mean interval: uneven triggers reach 1.5, a lost one 2."""
_MAX_SKEW_PERIODS = 0.1
"""Maximum skew: between frames further apart vibration changes the motion, so that no lag compares them."""
_COMMON_LAG_FRAME_SETS2 = 1 / 12
"""Variance of a lag of all cameras: pictures torn alike show the frame before in a part of the spot."""
_PATTERN_DIAMETERS = 1e-3
"""Noise of a moving spot by print and surface, per its diameter: 0.01 mm for 12 mm."""


class SynchronyCheck:
    """Compares the motion of each spot with that of the first target's.

    Steady vibration reveals a lag after seconds, the start of a motion from rest at once (``StartOfMotion``).
    A lag found at the start is included in sigma, because a separate yaw may look like it. So is one frame
    set while the spots move from rest and the cameras never were in step, and always a lag of all cameras
    within one frame set (``with_lag_in_sigma``).

    Not detected: a lag in a machine at rest, or one that moves smoothly or in pure lines of vibration,
    because a lag may then as well be a separate yaw (at v mm/s the wrong displacement of the late target is v
    times the delay); a delay of less than a frame, or of more than four; free-running cameras more than a
    tenth of a period apart.
    """

    def __init__(self, targets: tuple[str, ...]) -> None:
        self._targets = targets
        self._rows: deque[tuple[int, FloatArray, FloatArray]] = deque(maxlen=_WINDOW_FRAME_SETS)
        self._since_comparison = 0
        self._late: dict[str, int] = {}
        self._starts = {target: StartOfMotion() for target in targets[1:]}
        self._late_at_start: dict[str, int] = {}
        """Lag by target; 0: in step, absent: not determined yet."""

    def restart(self) -> None:
        """Forget all findings: the cameras were restarted."""
        self._rows.clear()
        self._late.clear()
        self._late_at_start.clear()
        self._restart_starts()

    def _restart_starts(self) -> None:
        for start in self._starts.values():
            start.restart()

    def with_lag_in_sigma(self, mean: MeanSpots) -> MeanSpots:
        """Return the mean spots with the movement within found and possible lags added to their covariance.

        While the spots start from rest and never were in step, a lag of one frame set is possible in any of
        the targets; its square counts in equal shares. A lag common to all targets always is possible, since
        nothing shows it: up to a frame set, evenly distributed (GUM 4.3.7). Windows of three frame sets or
        fewer, whose motion is unknown, are not changed.
        """
        if mean.motion is None or len(self._rows) < 2:
            return mean
        frame_sets2 = np.zeros(len(self._targets))
        for index, target in enumerate(self._targets[1:], start=1):
            lag = self._late_at_start.get(target)
            if lag:
                frame_sets2[index if lag > 0 else 0] += lag**2
            elif lag is None and self._starts[target].is_open:
                frame_sets2[[0, index]] += 0.5
        step_px = mean.motion.rate_px_per_s * self._period_ns() * 1e-9
        step_px2 = np.outer(step_px, step_px)
        lag_px2 = _COMMON_LAG_FRAME_SETS2 * step_px2
        if frame_sets2.any():
            lag_px2 += np.kron(np.diag(frame_sets2), np.ones((2, 2))) * step_px2
        return replace(mean, covariance_px2=mean.covariance_px2 + lag_px2)

    def inspect(self, frame_set: FrameSet) -> str:
        """Add a frame set; return as text which target's pictures do not belong to its time, empty if none.

        A finding holds until the motion shows the contrary: a machine that stops proves nothing.
        """
        spots = [frame_set.spots.get(target) for target in self._targets]
        positions_px = [(spot.u_px, spot.v_px) for spot in spots if isinstance(spot, Spot)]
        if len(positions_px) < len(self._targets):
            self._rows.clear()
            self._restart_starts()
            return self._complaint()
        behind_ns = np.array([frame_set.behind_ns.get(target, 0) for target in self._targets], dtype=float)
        self._rows.append((frame_set.t_ns, np.array(positions_px), behind_ns))
        self._inspect_starts([spot for spot in spots if isinstance(spot, Spot)])
        self._since_comparison += 1
        if self._since_comparison >= _INTERVAL_FRAME_SETS and len(self._rows) >= _MIN_FRAME_SETS:
            self._since_comparison = 0
            self._compare()
        return self._complaint()

    def _inspect_starts(self, spots: list[Spot]) -> None:
        """Process the newest row; a gap before it restarts the detection."""
        if len(self._rows) < 3:
            return
        (before_ns, _, _), (t_ns, places_px, behind_ns) = self._rows[-2], self._rows[-1]
        period_ns = self._period_ns()
        if t_ns - before_ns > _MAX_INTERVAL_PERIODS * period_ns:
            self._restart_starts()
            return
        noise_px = [math.hypot(spot.sigma_px, _PATTERN_DIAMETERS * spot.diameter_px) for spot in spots]
        for index, (target, start) in enumerate(self._starts.items(), start=1):
            if abs(behind_ns[index] - behind_ns[0]) > _MAX_SKEW_PERIODS * period_ns:
                start.restart()
                continue
            pair = [0, index]
            noise = np.repeat([noise_px[place] for place in pair], 2)
            lag = start.add(places_px[pair].ravel(), noise, t_ns)
            if lag is not None:
                self._late_at_start[target] = lag

    def _period_ns(self) -> float:
        """Mean interval between the rows, of which there are two at least."""
        return (self._rows[-1][0] - self._rows[0][0]) / (len(self._rows) - 1)

    def _complaint(self) -> str:
        return "; ".join(
            f"the {target} spot moves {counted(abs(lag), 'exposure')} {'after' if lag > 0 else 'before'} the "
            f"{self._targets[0]} spot, although they are stamped alike"
            for target, lag in self._late.items()
        )

    def _compare(self) -> None:
        times_ns, positions_px, behind_ns = (np.array(column) for column in zip(*self._rows, strict=True))
        intervals_ns = np.diff(times_ns)
        period_ns = float(np.median(intervals_ns))
        gaps = np.flatnonzero(intervals_ns > _MAX_INTERVAL_PERIODS * period_ns)
        if gaps.size:
            begin = int(gaps[-1]) + 1
            times_ns, positions_px, behind_ns = times_ns[begin:], positions_px[begin:], behind_ns[begin:]
        if len(times_ns) < _MIN_FRAME_SETS:
            return
        periods = np.diff(times_ns)[:, None] / period_ns
        velocities = np.diff(positions_px, axis=0) / periods[:, :, None]
        whiten = _autoregression(velocities[:, 0], periods)
        first = _normalised(_filtered(velocities[:, 0], periods, whiten))
        for index, target in enumerate(self._targets[1:], start=1):
            other = _normalised(_filtered(velocities[:, index], periods, whiten))
            skew_ns = float((behind_ns[:, index] - behind_ns[:, 0]).mean())
            if first is None or other is None or abs(skew_ns) > _MAX_SKEW_PERIODS * period_ns:
                continue
            chi = {lag: _chi(first, other, lag) for lag in range(-_MAX_LAG_FRAMES, _MAX_LAG_FRAMES + 1)}
            chi_at_zero = chi.pop(0)
            lag = max(chi, key=chi.__getitem__)
            if chi[lag] > max(_MIN_CHI, chi_at_zero + _MIN_CHI_DIFFERENCE):
                self._late[target] = lag
            elif chi_at_zero > max(_MIN_CHI, chi[lag] + _MIN_CHI_DIFFERENCE):
                self._late.pop(target, None)
                self._late_at_start[target] = 0


def _autoregression(velocities: FloatArray, periods: FloatArray) -> FloatArray:
    """Return the filter (order + 1,) that leaves the part of steps not predicted by velocities (n, 2) before.

    ``periods`` (n, 1) are the intervals of the steps in mean intervals.
    """
    size = len(velocities) - _AUTOREGRESSION_ORDER
    past = [
        (velocities[_AUTOREGRESSION_ORDER - lag :][:size] * periods[_AUTOREGRESSION_ORDER:]).ravel()
        for lag in range(_AUTOREGRESSION_ORDER + 1)
    ]
    weights = np.linalg.lstsq(np.column_stack(past[1:]), past[0], rcond=1e-10)[0]
    coefficients: FloatArray = np.concatenate([[1.0], -weights])
    return coefficients


def _filtered(velocities: FloatArray, periods: FloatArray, coefficients: FloatArray) -> FloatArray:
    left = np.column_stack([np.convolve(axis, coefficients, "valid") for axis in velocities.T])
    filtered: FloatArray = left * periods[_AUTOREGRESSION_ORDER:]
    return filtered


def _normalised(series: FloatArray) -> FloatArray | None:
    """Return a series (m, 2), clipped, with zero mean and unit covariance; None if it does not move."""
    centred = series - median(series, axis=0)
    limit = _CLIP_SIGMAS * MAD_TO_SIGMA * median(np.abs(centred), axis=0)
    clipped = np.clip(centred, -limit, limit)
    clipped -= clipped.mean(axis=0)
    try:
        root = np.linalg.cholesky(clipped.T @ clipped / len(clipped))
    except np.linalg.LinAlgError:
        return None
    normalised: FloatArray = np.linalg.solve(root, clipped.T).T
    return normalised


def _chi(first: FloatArray, other: FloatArray, lag: int) -> float:
    """Return √m ‖C‖ for the other series ``lag`` frame sets late."""
    size = len(first) - abs(lag)
    a, b = first[max(-lag, 0) :][:size], other[max(lag, 0) :][:size]
    return math.sqrt(float(np.square(a.T @ b).sum()) / size)
