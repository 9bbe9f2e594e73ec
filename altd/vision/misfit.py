"""How well light is explained by one spot: what the fit leaves over, in patterns that noise does not make.

Grain and noise differ from block to block; a reflection, a shadow, grease or a torn picture leave residuals
that hang together over many blocks. The residuals are projected onto smooth patterns: rings of the spot times
harmonics of the direction. With the noise that is known the sum of the squared projections is distributed as
chi-square.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np

from altd.records import FloatArray

_LEVELS = 1.0, 0.7, 0.35, 0.12, 0.02, 0.0
"""The rings lie between these shares of the spot's peak; the last one holds the surroundings."""
_HARMONICS = slice(1, 3), slice(3, 7), slice(0, 7), slice(0, 7), slice(0, 7)
"""Of the direction, ring by ring, as rows of 1, cos φ, sin φ, cos 2φ … sin 3φ. Peak, centre and form take up
those that the inner two rings leave out."""
_MAX_PATTERNS = sum(rows.stop - rows.start for rows in _HARMONICS)
_MIN_BLOCKS = 6
"""A ring of fewer blocks has no pattern of its own."""
_RIDGE = 0.02
"""Share of a pattern's information below which the fit itself has used it up."""
_MIN_GRAIN = 0.02
"""No surface and no laser is known better: a hundredth of the light over 2 × 2 px."""
_MAX_GRAIN_RATIO = 1.3
"""Places of a target differ by so much in grain; what lies above is not taken for grain."""


@dataclass(frozen=True, slots=True, eq=False)
class Residuals:
    """What a fitted spot leaves over in n blocks.

    ``light`` (n,) counts; ``derivatives`` (p, n) of the light by the parameters, u and v of the centre in px
    in rows 1 and 2; ``prior`` (p,) what is known of the parameters beforehand, 1/variance, and ``pull`` (p,)
    that times how far they are from it; ``noise_variance`` (n,) of read and shot noise, ``grain_variance``
    (n,) of a grain of 1; ``grain`` the one that the fit found; ``irradiance`` (n,) as a share of the peak;
    ``spot_light`` (n,) counts; ``flat_light`` (n,) what even light of the spot's peak would bring;
    ``direction`` (n,) the unit vectors from the centre, u + i v, in the frame in which the spot is round.
    """

    light: FloatArray
    derivatives: FloatArray
    prior: FloatArray
    pull: FloatArray
    noise_variance: FloatArray
    grain_variance: FloatArray
    grain: float
    irradiance: FloatArray
    spot_light: FloatArray
    flat_light: FloatArray
    direction: np.ndarray[tuple[int], np.dtype[np.complex128]]

    @property
    def nbytes(self) -> int:
        """What it takes in memory."""
        values = (getattr(self, field.name) for field in fields(self))
        return sum(value.nbytes for value in values if isinstance(value, np.ndarray))


@dataclass(frozen=True, slots=True, eq=False)
class Misfit:
    """The statistic ``chi2`` with its degrees of freedom, and what the fit is worth.

    ``centre_covariance_px2`` (2, 2) is that of the centre for noise and grain together, ``pattern_px`` the
    standard deviation for grain alone (root mean square of both axes).
    """

    chi2: float
    freedom: float
    centre_covariance_px2: FloatArray
    pattern_px: float

    @property
    def centre_px(self) -> float:
        """The standard deviation of the centre, root mean square of both axes."""
        return math.sqrt(float(self.centre_covariance_px2[0, 0] + self.centre_covariance_px2[1, 1]) / 2)

    @property
    def worst_px(self) -> float:
        """That along the worse direction, in which a spot cut by the image's edge is known far less."""
        return math.sqrt(float(np.linalg.eigvalsh(self.centre_covariance_px2)[-1]))


def misfit_of(residuals: Residuals, usual_grain: float | None = None) -> Misfit | None:
    """The misfit of a spot; None where its blocks are too few to tell.

    ``usual_grain`` is that of the target, where the calibration knows it: light that is coarser counts as
    unexplained. Without it the spot's own grain is taken.
    """
    grain = residuals.grain
    if usual_grain is not None:
        usual = max(usual_grain, _MIN_GRAIN)
        grain = min(max(grain, usual), _MAX_GRAIN_RATIO * usual)
    grain_variance = grain**2 * residuals.grain_variance
    weights = 1 / (residuals.noise_variance + grain_variance)
    patterns = _patterns(residuals)
    if not len(patterns):
        return None
    weighted = residuals.derivatives * weights
    equations = weighted @ residuals.derivatives.T
    equations.flat[:: len(equations) + 1] += residuals.prior
    try:
        covariance = np.asarray(np.linalg.inv(equations), dtype=np.float64)
    except np.linalg.LinAlgError:
        return None
    in_patterns = patterns * weights
    shared = in_patterns @ residuals.derivatives.T
    information = in_patterns @ patterns.T
    diagonal = information.diagonal()
    used = diagonal > 0
    if not used.any():
        return None
    step = covariance @ (weighted @ residuals.light + residuals.pull)
    score = in_patterns @ residuals.light - shared @ step
    left = information - shared @ covariance @ shared.T
    if not used.all():
        diagonal, score, left = diagonal[used], score[used], left[np.ix_(used, used)]
    scale = 1 / np.sqrt(diagonal)
    score = score * scale
    left = left * scale[:, None] * scale
    ridged = left + _RIDGE * np.eye(len(left))
    solved = np.linalg.solve(ridged, np.column_stack([score, left]))
    centre = covariance[1:3] @ weighted
    pattern = float((np.square(centre) @ grain_variance).sum()) / 2
    return Misfit(
        chi2=float(score @ solved[:, 0]),
        freedom=float(np.trace(solved[:, 1:])),
        centre_covariance_px2=covariance[1:3, 1:3],
        pattern_px=math.sqrt(pattern),
    )


def excess_sigmas(chi2: float, freedom: float) -> float:
    """How many sigmas a chi-square lies above its mean, by Wilson and Hilferty's transform."""
    share = 2 / (9 * freedom)
    return (math.pow(max(chi2, 0.0) / freedom, 1 / 3) - 1 + share) / math.sqrt(share)


def _patterns(residuals: Residuals) -> FloatArray:
    """Rows (patterns, n): light that would follow each ring and harmonic."""
    direction, count = residuals.direction, residuals.light.size
    waves = np.empty((7, count))
    waves[0] = 1.0
    for harmonic, power in enumerate((direction, direction**2, direction**3)):
        waves[1 + 2 * harmonic], waves[2 + 2 * harmonic] = power.real, power.imag
    patterns = np.empty((_MAX_PATTERNS, count))
    filled = 0
    for upper, lower, harmonics in zip(_LEVELS, _LEVELS[1:], _HARMONICS, strict=False):
        inside = (residuals.irradiance <= upper) & (residuals.irradiance > lower)
        if lower == 0.0:
            inside |= residuals.irradiance <= 0
        if np.count_nonzero(inside) < _MIN_BLOCKS:
            continue
        light = np.where(inside, residuals.spot_light if lower > 0 else residuals.flat_light, 0.0)
        rows = slice(filled, filled + harmonics.stop - harmonics.start)
        np.multiply(waves[harmonics], light, out=patterns[rows])
        filled = rows.stop
    return patterns[:filled]
