"""Joint uncertainty of several quantities: their errors and their motion are correlated."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from altd.records.frames import FloatArray
from altd.records.spots import Motion

Rows = list[list[float]]


@dataclass(frozen=True, eq=False)
class Joint:
    """Joint uncertainty of the quantities ``keys``, n of them, all (n, n) in their order.

    ``covariance`` is that of the values at their own time, each in its own unit: its diagonal is ``sigma``².
    ``scatter`` is the part of it that scatters, with ``sigma_random``² on its diagonal. ``factors`` (n,)
    convert these units to those that are published (``Quantities.joint``). ``vibration``, ``rate`` and
    ``acceleration`` are products of the quantities' motions, of which only the correlations count. None: not
    known.
    """

    keys: tuple[str, ...]
    covariance: FloatArray
    scatter: FloatArray
    factors: FloatArray
    vibration: FloatArray | None = None
    rate: FloatArray | None = None
    acceleration: FloatArray | None = None

    def published(self, covariance: FloatArray) -> FloatArray:
        """Return a covariance of ``keys`` in the published units."""
        return covariance * (self.factors[:, None] * self.factors)

    def at(self, motions: Mapping[str, Motion], age_s: float | None) -> FloatArray | None:
        """Return the covariance in the published units, ``age_s`` after the values' time; None: not known.

        Without ``age_s`` it is that of the values at their own time.
        """
        since = 0.0 if age_s is None else self.since(motions, max(age_s, 0.0))
        return None if since is None else self.published(self.covariance + since)

    def with_motion(self, motions: Mapping[str, Motion]) -> Joint | None:
        """Return the joint uncertainty of values whose sigma includes the motion at their own time."""
        since = self.since(motions, 0.0)
        return None if since is None else replace(self, covariance=self.covariance + since)

    def since(self, motions: Mapping[str, Motion], age_s: float) -> FloatArray | None:
        """Return the mean products of the true values' distances from the values, ``age_s`` later.

        Its diagonal is ``Motion.variance_since``. A rate, an acceleration and a vibration have the
        correlations of those that were seen; a start of motion is one motion of all. None: not known.
        """
        of_keys = [motions[key] for key in self.keys if key in motions]
        then = self._products([motion.parts_since(age_s) for motion in of_keys])
        if then is None or not of_keys[0].is_in_sigma:
            return then
        own = self._products([motion.parts_since(0.0) for motion in of_keys])
        return None if own is None else then - own

    def _products(self, parts: Sequence[tuple[float, ...] | None]) -> FloatArray | None:
        known = [each for each in parts if each is not None]
        if self._correlations is None or len(known) < len(self.keys):
            return None
        of_keys = np.array(known)
        total: FloatArray = np.einsum("kij,ik,jk->ij", self._correlations, of_keys, of_keys)
        return total

    @cached_property
    def _correlations(self) -> FloatArray | None:
        """Correlations (4, n, n) of vibration, rate, acceleration and onset: only a reader pays for them."""
        if self.vibration is None or self.rate is None or self.acceleration is None:
            return None
        vibration = correlation_of(self.vibration, is_estimate=True)
        of_rates = map(correlation_of, (self.rate, self.acceleration))
        return np.array([vibration, *of_rates, np.ones_like(self.covariance)])


@dataclass(frozen=True, slots=True, eq=False)
class Linear:
    """Uncertainty of a value that depends on the joint quantities: its derivatives (n,) by them.

    ``other_variance`` is that of everything else it depends on.
    """

    gradient: FloatArray
    other_variance: float

    def sigma(self, covariance: FloatArray | None) -> float | None:
        """Return the standard deviation, for a covariance whose first n rows are those; None: not known."""
        if covariance is None:
            return None
        size = len(self.gradient)
        variance = float(self.gradient @ covariance[:size, :size] @ self.gradient) + self.other_variance
        return math.sqrt(max(variance, 0.0)) if math.isfinite(variance) else None


def correlation_of(products: FloatArray, is_estimate: bool = False) -> Rows:
    """Return the correlations (n, n) of a matrix of products; quantities without any have none.

    Negative eigenvalues, which only an estimate may have, are removed: the result is that of the nearest
    matrix without (Higham, Linear Algebra Appl. 103, 1988, theorem 2.1). Products that are not finite give
    NaN.
    """
    rows: Rows = products.tolist()
    if not math.isfinite(sum(map(sum, rows))):
        return [[math.nan] * len(rows)] * len(rows)
    correlation = _scaled(rows)
    if not is_estimate or is_definite(correlation, [0.0] * len(rows)):
        return correlation
    weights, vectors = np.linalg.eigh(correlation)
    return _scaled(((vectors * np.maximum(weights, 0.0)) @ vectors.T).tolist())


def is_definite(rows: Rows, slack: Sequence[float]) -> bool:
    """Return whether a symmetric matrix (n, n) is positive definite with ``slack`` (n,) on its diagonal.

    All pivots of its elimination are positive then. For few quantities floats are faster than numpy.
    """
    left = [[*row] for row in rows]
    for at, row in enumerate(left):
        pivot = row[at] + slack[at]
        if not pivot > 0.0:
            return False
        for below in left[at + 1 :]:
            share = below[at] / pivot
            for column in range(at + 1, len(rows)):
                below[column] -= share * row[column]
    return True


def _scaled(rows: Rows) -> Rows:
    """Return a matrix of products divided by the roots of its diagonal; infinity for those not positive."""
    scale = [math.sqrt(row[at]) if row[at] > 0.0 else math.inf for at, row in enumerate(rows)]
    scaled = [
        [each / (one * other) for each, other in zip(row, scale, strict=True)]
        for row, one in zip(rows, scale, strict=True)
    ]
    for at, row in enumerate(scaled):
        row[at] = 1.0
    return scaled
