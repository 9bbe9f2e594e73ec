"""Motion in the windows of the last seconds, which limits the motion expected after the newest one."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from altd.records import FloatArray
from altd.records.joint import Joint
from altd.records.spots import Motion

MEMORY_S = 10.0
"""Time constant of the memory, s: longer than one step of a machine that moves stepwise, shorter than a
person waits for a value that has stopped moving to be accurate again."""
MIN_LAG_S = 1.0
"""Minimum time between compared rates, s: a value is shown so long before it is stale (``stale_after_s``)."""
_MAX_LAG_WINDOWS = 2.0
"""Maximum time, in windows, within which the rate may have changed if the previous window is older."""
_SIGNIFICANT = 2.0
"""A single change of the rate counts by the part above this many of its standard deviations."""


@dataclass(slots=True)
class _Mean:
    """Mean with weights that decrease with age."""

    sum: float = 0.0
    weight: float = 0.0

    def add(self, value: float, fading: float) -> None:
        self.sum = self.sum * fading + value
        self.weight = self.weight * fading + 1.0

    @property
    def value(self) -> float | None:
        return self.sum / self.weight if self.weight else None


@dataclass(frozen=True, slots=True)
class _Seen:
    """Motion of one window, with the times of its middle and of its newest frame set."""

    t_ns: int
    newest_ns: int
    span_s: float
    motions: Mapping[str, Motion]


class MotionMemory:
    """Adds information from earlier windows to a window's motion."""

    def __init__(self) -> None:
        self._seen: deque[_Seen] = deque()
        """Windows from the newest one that can be compared with the last one."""
        self._rate_squares: dict[str, _Mean] = {}
        self._acceleration_squares: dict[str, _Mean] = {}
        self._rate_products: FloatArray | float = 0.0
        self._change_products: FloatArray | float = 0.0
        """Sums of the products of rates, and of their changes, in the order of the motions."""

    def add(
        self, t_ns: int, newest_ns: int, span_s: float, motions: Mapping[str, Motion]
    ) -> dict[str, Motion]:
        """Return the motions of a window with the additions from the memory.

        ``t_ns`` is the middle of its frame sets, which outliers may set back, ``newest_ns`` the newest of
        them. If the latter does not increase, or follows a long silence, the memory is cleared.
        """
        if not motions:
            return {}
        since_s = (newest_ns - self._seen[-1].newest_ns) * 1e-9 if self._seen else math.inf
        if not 0.0 < since_s <= MEMORY_S:
            self._seen.clear()
            self._rate_squares.clear()
            self._acceleration_squares.clear()
            self._rate_products = self._change_products = 0.0
        now = _Seen(t_ns, newest_ns, span_s, motions)
        before = self._before(now)
        fading = math.exp(-since_s / MEMORY_S)
        self._seen.append(now)
        rates = np.array([motion.rate for motion in motions.values()])
        self._rate_products = fading * self._rate_products + np.outer(rates, rates)
        if before is not None and before.motions.keys() == motions.keys():
            rates -= [motion.rate for motion in before.motions.values()]
            self._change_products = fading * self._change_products + np.outer(rates, rates)
        return {key: self._one(key, motion, now, before, fading) for key, motion in motions.items()}

    def joined(self, joint: Joint | None) -> Joint | None:
        """Return the joint uncertainty of the last window with the products of its rates.

        They are those of the motions' estimates, whose errors count like motion; ``joint.keys`` are the
        motions' keys, in their order.
        """
        rates, changes = self._rate_products, self._change_products
        if joint is None or isinstance(rates, float) or isinstance(changes, float):
            return joint
        return replace(joint, rate=rates, acceleration=changes)

    def _before(self, now: _Seen) -> _Seen | None:
        """Return the newest window old enough to share no frame set with this one; drop the older ones."""
        before = None
        while self._seen and _lag_s(self._seen[0], now) >= max(
            MIN_LAG_S, 0.5 * (self._seen[0].span_s + now.span_s)
        ):
            before = self._seen.popleft()
        if before is not None:
            self._seen.appendleft(before)
        return before

    def _one(self, key: str, motion: Motion, now: _Seen, before: _Seen | None, fading: float) -> Motion:
        """Extend one motion; the means subtract the variances by which squares of estimates are too large."""
        rate_square = motion.rate**2 - motion.sigma_rate**2
        seen = self._rate_squares.setdefault(key, _Mean())
        seen.add(rate_square, fading)
        probable_rate = math.sqrt(_expected_square(motion, max(seen.value or 0.0, rate_square, 0.0)))
        changes = self._acceleration_squares.setdefault(key, _Mean())
        newest = 0.0
        if before is not None and key in before.motions:
            then = before.motions[key]
            within_s = min(_lag_s(before, now), max(MIN_LAG_S, _MAX_LAG_WINDOWS * now.span_s))
            square = ((motion.rate - then.rate) / within_s) ** 2
            variance = (motion.sigma_rate**2 + then.sigma_rate**2) / within_s**2
            changes.add(square - variance, fading)
            newest = square - _SIGNIFICANT**2 * variance
        if changes.value is None:
            return replace(motion, probable_rate=probable_rate)
        acceleration = math.sqrt(max(changes.value, newest, 0.0))
        return replace(motion, probable_rate=probable_rate, acceleration=acceleration)


def _expected_square(motion: Motion, variance: float) -> float:
    """Return the mean square of an estimated rate, if such rates have this variance about zero."""
    weight = variance / (variance + motion.sigma_rate**2) if variance else 0.0
    return (weight * motion.rate) ** 2 + weight * motion.sigma_rate**2


def _lag_s(before: _Seen, now: _Seen) -> float:
    return (now.t_ns - before.t_ns) * 1e-9
