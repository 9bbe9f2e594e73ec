"""Whether the targets' spots move at the same instants, or one camera's pictures are whole frames late.

A picture that waited in a buffer and was stamped when it came out has a wrong time that no stamp tells. But
the machine moves all targets at once: what is new in the motion of one spot, from one exposure to the next,
must be new in the others in the same exposure.

That is the cross-correlation of prewhitened series (Box and Jenkins, Time Series Analysis, 12.2): an
autoregression fitted to the steps of the first spot leaves what was not to be foreseen in them; the same
filter goes over the steps of the other spot. Then m · ‖C_L‖², C_L the 2 × 2 correlation at lag L over m
exposures, follows a χ² with four degrees of freedom wherever the two have nothing to do with each other at
that lag, whatever spectrum either has. A vibration at one frequency is foreseen, so its phase says nothing.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from altd.records import Exposure, FloatArray, Spot
from altd.statistics.robust import MAD_TO_SIGMA, median

_WINDOW = 200
"""Exposures that are looked at: 10 s at 20 a second."""
_MIN_EXPOSURES = 100
_INTERVAL = 20
"""Exposures from one look to the next."""
_ORDER = 8
"""Of the autoregression: four lines of vibration."""
_MAX_LAG = 4
_MIN_CHI = 9.0
"""The root of χ²: with four degrees of freedom a larger one has a probability of 1e-16."""
_MIN_CHI_DIFFERENCE = 6.0
_CLIP_SIGMAS = 4.0
_UNEVEN = 0.25
_MAX_APART_PERIODS = 0.1
"""Between exposures further apart than this, vibration has moved on: no lag is that of the other's motion."""


class SynchronyCheck:
    """Compares the motion of each spot with that of the first target's.

    What cannot be seen: a machine at rest, or one that moves smoothly or in pure lines of vibration, for what
    lags there may as well be a yaw of its own (at v mm/s the wrong displacement of the late target is v times
    the delay); a delay of less than a frame, or of more than four; cameras that run freely, more than a tenth
    of a period apart.
    """

    def __init__(self, targets: tuple[str, ...]) -> None:
        self._targets = targets
        self._rows: deque[tuple[int, FloatArray, FloatArray]] = deque(maxlen=_WINDOW)
        self._since_look = 0
        self._late: dict[str, int] = {}

    def restart(self) -> None:
        """The cameras were started anew: what was found before does not count."""
        self._rows.clear()
        self._late.clear()

    def look(self, exposure: Exposure) -> str:
        """Take an exposure; in words which target's pictures do not belong to its time, empty: none known.

        What was found holds until the motion shows the contrary: a machine that stops proves nothing.
        """
        spots = [exposure.spots.get(target) for target in self._targets]
        places = [(spot.u_px, spot.v_px) for spot in spots if isinstance(spot, Spot)]
        if len(places) < len(self._targets):
            self._rows.clear()
            return self._in_words()
        behind_ns = np.array([exposure.behind_ns.get(target, 0) for target in self._targets], dtype=float)
        self._rows.append((exposure.t_ns, np.array(places), behind_ns))
        self._since_look += 1
        if self._since_look >= _INTERVAL and len(self._rows) >= _MIN_EXPOSURES:
            self._since_look = 0
            self._compare()
        return self._in_words()

    def _in_words(self) -> str:
        return "; ".join(
            f"the {target} spot moves {abs(lag)} exposures {'after' if lag > 0 else 'before'} the "
            f"{self._targets[0]} spot, although they are stamped alike"
            for target, lag in self._late.items()
        )

    def _compare(self) -> None:
        times_ns, places, behind_ns = (np.array(column) for column in zip(*self._rows, strict=True))
        intervals_ns = np.diff(times_ns)
        period_ns = float(np.median(intervals_ns))
        uneven = np.flatnonzero(np.abs(intervals_ns - period_ns) > _UNEVEN * period_ns)
        if uneven.size:
            begin = int(uneven[-1]) + 1
            times_ns, places, behind_ns = times_ns[begin:], places[begin:], behind_ns[begin:]
        if len(times_ns) < _MIN_EXPOSURES:
            return
        steps = np.diff(places, axis=0)
        whiten = _autoregression(steps[:, 0])
        first = _normalised(_filtered(steps[:, 0], whiten))
        for index, target in enumerate(self._targets[1:], start=1):
            other = _normalised(_filtered(steps[:, index], whiten))
            apart_ns = float((behind_ns[:, index] - behind_ns[:, 0]).mean())
            if first is None or other is None or abs(apart_ns) > _MAX_APART_PERIODS * period_ns:
                continue
            chi = {lag: _chi(first, other, lag) for lag in range(-_MAX_LAG, _MAX_LAG + 1)}
            in_step = chi.pop(0)
            lag = max(chi, key=chi.__getitem__)
            if chi[lag] > max(_MIN_CHI, in_step + _MIN_CHI_DIFFERENCE):
                self._late[target] = lag
            elif in_step > max(_MIN_CHI, chi[lag] + _MIN_CHI_DIFFERENCE):
                self._late.pop(target, None)


def _autoregression(steps: FloatArray) -> FloatArray:
    """The filter (order + 1,) that leaves of steps (n, 2) what those before do not foretell."""
    past = [steps[_ORDER - lag : len(steps) - lag] for lag in range(_ORDER + 1)]
    design = np.column_stack([values.ravel() for values in past[1:]])
    told = np.linalg.lstsq(design, past[0].ravel(), rcond=1e-10)[0]
    coefficients: FloatArray = np.concatenate([[1.0], -told])
    return coefficients


def _filtered(steps: FloatArray, coefficients: FloatArray) -> FloatArray:
    filtered: FloatArray = np.column_stack([np.convolve(axis, coefficients, "valid") for axis in steps.T])
    return filtered


def _normalised(series: FloatArray) -> FloatArray | None:
    """A series (m, 2), clipped, with zero mean and unit covariance; None: it does not move."""
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
    """√m ‖C‖ for the other series ``lag`` exposures late."""
    size = len(first) - abs(lag)
    a, b = first[max(-lag, 0) :][:size], other[max(lag, 0) :][:size]
    return math.sqrt(float(np.square(a.T @ b).sum()) / size)
