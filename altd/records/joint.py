"""Joint uncertainty of several quantities: their errors and their motion are correlated."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from altd.records.frames import FloatArray
from altd.records.spots import Motion


@dataclass(frozen=True, slots=True, eq=False)
class Joint:
    """Joint uncertainty of the quantities ``keys``, n of them, all (n, n) in their order.

    ``covariance`` is that of the values at their own time, each in its own unit: its diagonal is ``sigma``².
    ``scatter`` is the part of it that scatters, with ``sigma_random``² on its diagonal. ``factors`` (n,)
    convert these units to those that are published (``Quantities.joint``). ``vibration``, ``rate`` and
    ``acceleration`` are correlations of the three parts of the quantities' motion.
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
        return covariance * np.outer(self.factors, self.factors)

    def at(self, motions: Mapping[str, Motion], age_s: float | None) -> FloatArray | None:
        """Return the covariance in the published units, ``age_s`` after the values' time; None: not known.

        Without ``age_s`` it is that of the values at their own time.
        """
        since = np.zeros_like(self.covariance)
        if age_s is not None:
            found = self.since(motions, max(age_s, 0.0))
            if found is None:
                return None
            since = found
        return self.published(self.covariance + since)

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
        correlations = (self.vibration, self.rate, self.acceleration, np.ones_like(self.covariance))
        of_parts = np.array([each for each in parts if each is not None]).T
        if of_parts.shape != (len(correlations), len(self.keys)):
            return None
        total: FloatArray = np.zeros_like(self.covariance)
        for correlation, part in zip(correlations, of_parts, strict=True):
            if correlation is None:
                return None
            total += correlation * np.outer(part, part)
        return total


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


def correlation_of(products: FloatArray) -> FloatArray:
    """Return the correlations (n, n) of a matrix of mean products; quantities without any have none.

    An estimate with negative eigenvalues is replaced by the nearest one without (Higham, Linear Algebra
    Appl. 103, 1988, theorem 2.1). Products that are not finite give NaN.
    """
    if not np.isfinite(products).all():
        return np.full_like(products, np.nan)
    scale = np.sqrt(np.maximum(np.diag(products), 0.0))
    usable = np.where(scale > 0.0, scale, np.inf)
    weights, vectors = np.linalg.eigh(products / np.outer(usable, usable))
    nearest = (vectors * np.maximum(weights, 0.0)) @ vectors.T
    scale = np.sqrt(np.diag(nearest))
    usable = np.where(scale > 0.0, scale, np.inf)
    correlation: FloatArray = nearest / np.outer(usable, usable)
    np.fill_diagonal(correlation, 1.0)
    return correlation
