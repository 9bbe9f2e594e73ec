"""Misfit of one spot to the light: the fit's residuals, projected onto smooth patterns.

Surface texture and noise differ from block to block; a reflection, a shadow, grease or a torn frame leave
residuals that are correlated over many blocks. The patterns are rings of the spot
times harmonics of the direction. With the known noise the sum of the squared projections is distributed as
chi-square.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from altd.records import FloatArray
from altd.records.spots import Unexplained
from altd.vision import kernel
from altd.vision.blocks import F1, F2, MONOMIALS, Blocks
from altd.vision.fit import ORDER, ORDER_PRIOR_SIGMA, RESIDUAL, RISE_X, SPOT, TEXTURE, FitState, U, V

_RING_LEVELS = 1.0, 0.7, 0.35, 0.12, 0.02, 0.0
"""Shares of the spot's peak between which the rings are; the last ring holds the surroundings."""
_HARMONICS = slice(1, 3), slice(3, 7), slice(0, 7), slice(0, 7), slice(0, 7)
"""Harmonics of the direction, ring by ring, as rows of 1, cos φ, sin φ, cos 2φ … sin 3φ. Peak, centre and
form absorb those that the inner two rings omit."""
_MAX_PATTERNS = sum(rows.stop - rows.start for rows in _HARMONICS)
_MIN_BLOCKS = 6
"""Minimum number of blocks of a ring with patterns."""
_RIDGE_SHARE = 0.02
"""Share of a pattern's information below which the fit itself has absorbed it."""
_RINGS = kernel.Rings(
    _RING_LEVELS,
    _RIDGE_SHARE,
    tuple(rows.start for rows in _HARMONICS),
    tuple(rows.stop for rows in _HARMONICS),
    _MIN_BLOCKS,
)
_MIN_TEXTURE_CONTRAST = 0.02
"""Minimum contrast: no surface and no laser is known better than a hundredth of the light over 2 × 2 px."""
_MAX_CONTRAST_RATIO = 1.3
"""Maximum ratio by which texture contrast differs over a target; higher contrast is not texture."""

_EXPLAINED_SIGMAS = 1.5
"""Number of sigmas above its mean up to which a chi-square adds nothing to a spot's sigma."""
_BIAS_PER_EXCESS = 1.2
"""Possible effect of unexplained light on a centre, one sigma, in its sigmas per root of the chi-square. Dust
displaces a spot by half of that, grease by as much, weak reflections by two to four times: those near five
times stretch the spot too, which the comparison of the targets adds."""


@dataclass(frozen=True, slots=True, eq=False)
class FitResiduals:
    """Residuals of a spot fitted to its blocks.

    The blocks' positions are in units of ``sigma_px``; ``rise`` is the prior standard deviation of the
    background's slopes, counts per ``sigma_px``.
    """

    blocks: Blocks
    solution: FitState
    rise: float
    sigma_px: float

    @property
    def texture_contrast(self) -> float:
        """Relative standard deviation of the surface texture, estimated by the fit."""
        return math.sqrt(self.solution.contrast2)

    @property
    def nbytes(self) -> int:
        """Memory of the arrays, bytes."""
        return self.blocks.rows.nbytes + self.solution.rows.nbytes


@dataclass(frozen=True, slots=True, eq=False)
class Misfit:
    """Statistic ``chi2`` with its degrees of freedom, and the uncertainty of the fit.

    ``centre_covariance_px2`` (2, 2) is that of the centre for noise and texture together, ``pattern_px`` the
    standard deviation for texture alone (root mean square of both axes). ``scores`` (2, patterns) are the
    projections onto the patterns and the patterns' amplitudes; the sum of their products is ``chi2``.
    """

    chi2: float
    degrees_of_freedom: float
    centre_covariance_px2: FloatArray
    pattern_px: float
    scores: FloatArray

    @property
    def centre_px(self) -> float:
        """Standard deviation of the centre, root mean square of both axes."""
        return math.sqrt(float(self.centre_covariance_px2[0, 0] + self.centre_covariance_px2[1, 1]) / 2)

    @property
    def worst_px(self) -> float:
        """Standard uncertainty along the worse direction; large for a spot that the image's edge cuts."""
        return math.sqrt(float(np.linalg.eigvalsh(self.centre_covariance_px2)[-1]))


def misfit_of(residuals: FitResiduals, usual_contrast: float | None = None) -> Misfit | None:
    """Return the misfit of a spot; None if it has too few blocks.

    ``usual_contrast`` is the target's texture contrast if the calibration contains it: light that is coarser
    counts as unexplained. Without it the spot's own contrast is used.
    """
    texture_contrast = residuals.texture_contrast
    if usual_contrast is not None:
        floor_contrast = max(usual_contrast, _MIN_TEXTURE_CONTRAST)
        texture_contrast = min(max(texture_contrast, floor_contrast), _MAX_CONTRAST_RATIO * floor_contrast)
    if not kernel.is_compiled():
        return misfit_by_numpy(residuals, texture_contrast)
    found = kernel.misfit(
        _RINGS, residuals.blocks, residuals.solution, residuals.rise, ORDER_PRIOR_SIGMA, texture_contrast
    )
    if found is None:
        return None
    uv = found.centre_uv
    covariance = np.array(((found.centre_uu, uv), (uv, found.centre_vv))) * residuals.sigma_px**2
    pattern_px = residuals.sigma_px * math.sqrt(found.pattern_variance)
    scores = np.frombuffer(found.scores).reshape(2, -1)
    return Misfit(found.chi2, found.degrees_of_freedom, covariance, pattern_px, scores)


def misfit_by_numpy(residuals: FitResiduals, texture_contrast: float) -> Misfit | None:
    """Compute ``misfit_of`` without compiled code, for a texture contrast."""
    solution = residuals.solution
    derivatives, light = solution.derivatives, solution.rows[RESIDUAL]
    weights = 1 / solution.variance(texture_contrast**2)
    patterns = _patterns(residuals)
    if not len(patterns):
        return None
    prior, known = np.zeros(RESIDUAL), np.array(solution.state)
    prior[RISE_X : ORDER + 1] = residuals.rise**-2, residuals.rise**-2, ORDER_PRIOR_SIGMA**-2
    known[RISE_X : ORDER + 1] = 0.0, 0.0, 1.0
    weighted = derivatives * weights
    equations = weighted @ derivatives.T
    equations.flat[:: len(equations) + 1] += prior
    try:
        covariance = np.asarray(np.linalg.inv(equations), dtype=np.float64)
    except np.linalg.LinAlgError:
        return None
    weighted_patterns = patterns * weights
    shared = weighted_patterns @ derivatives.T
    information = weighted_patterns @ patterns.T
    diagonal = information.diagonal()
    used = diagonal > 0
    if not used.any():
        return None
    step = covariance @ (weighted @ light + prior * (known - solution.state))
    score = weighted_patterns @ light - shared @ step
    remaining = information - shared @ covariance @ shared.T
    if not used.all():
        diagonal, score, remaining = diagonal[used], score[used], remaining[np.ix_(used, used)]
    scale = 1 / np.sqrt(diagonal)
    score = score * scale
    remaining = remaining * scale[:, None] * scale
    ridged = remaining + _RIDGE_SHARE * np.eye(len(remaining))
    solved = np.linalg.solve(ridged, np.column_stack([score, remaining]))
    centre = covariance[U : V + 1] @ weighted
    pattern_variance = float((np.square(texture_contrast * centre) @ solution.rows[TEXTURE]).sum()) / 2
    return Misfit(
        chi2=float(score @ solved[:, 0]),
        degrees_of_freedom=float(np.trace(solved[:, 1:])),
        centre_covariance_px2=covariance[U : V + 1, U : V + 1] * residuals.sigma_px**2,
        pattern_px=residuals.sigma_px * math.sqrt(pattern_variance),
        scores=np.stack([score, solved[:, 0]]),
    )


def unexplained_of(misfit: Misfit, usual_ratio: float) -> Unexplained | None:
    """Return the light that one spot does not explain; None if it is no more than in good spots.

    ``usual_ratio`` is the ratio of usual spots' chi-square to that of noise.
    """
    usual = misfit.degrees_of_freedom + _EXPLAINED_SIGMAS * math.sqrt(2 * misfit.degrees_of_freedom)
    if misfit.chi2 <= usual * usual_ratio:
        return None
    return Unexplained(misfit.scores / math.sqrt(usual_ratio), usual, _BIAS_PER_EXCESS * misfit.centre_px)


def hidden_px(misfit: Misfit, usual_ratio: float, hidden: float) -> float:
    """Return the possible displacement of a spot by the asymmetry of its beam, one sigma.

    ``usual_ratio`` is the ratio of usual spots' chi-square to that of noise, ``hidden`` from ``Flat.hidden``.
    """
    unexplained = max(usual_ratio - 1, 0.0) * misfit.degrees_of_freedom
    return _BIAS_PER_EXCESS * hidden * misfit.centre_px * math.sqrt(unexplained)


def excess_sigmas(chi2: float, degrees_of_freedom: float) -> float:
    """Return by how many sigmas a chi-square exceeds its mean, by Wilson and Hilferty's transform."""
    share = 2 / (9 * degrees_of_freedom)
    return (math.pow(max(chi2, 0.0) / degrees_of_freedom, 1 / 3) - 1 + share) / math.sqrt(share)


def _patterns(residuals: FitResiduals) -> FloatArray:
    """Return rows (patterns, n): the spot's light in each ring times each harmonic of the direction.

    The direction from the centre is taken in the frame in which the spot is round.
    """
    blocks, solution = residuals.blocks.rows, residuals.solution
    spot, irradiance = solution.rows[SPOT], solution.peak_shares
    peak, u, v, a, b, c, *_ = solution.state
    # a root of the form turns the ellipse into a circle and, being symmetric, keeps the directions nearly
    root = math.sqrt(a * c - b * b)
    _, x, y, *_ = blocks[MONOMIALS]
    x, y = x - u, y - v
    places = (a + root) * x + b * y + 1j * (b * x + (c + root) * y)
    direction = places / np.maximum(np.abs(places), 1e-12)
    harmonic_rows = np.empty((7, spot.size))
    harmonic_rows[0] = 1.0
    for harmonic, power in enumerate((direction, direction**2, direction**3)):
        harmonic_rows[1 + 2 * harmonic], harmonic_rows[2 + 2 * harmonic] = power.real, power.imag
    patterns = np.empty((_MAX_PATTERNS, spot.size))
    filled = 0
    for upper, lower, harmonics in zip(_RING_LEVELS, _RING_LEVELS[1:], _HARMONICS, strict=False):
        inside = (irradiance <= upper) & (irradiance > lower)
        if lower == 0.0:
            inside |= irradiance <= 0
        if np.count_nonzero(inside) < _MIN_BLOCKS:
            continue
        # the last ring: counts of even light of the spot's peak
        light = np.where(inside, spot * blocks[F2] if lower > 0 else peak * blocks[F1], 0.0)
        rows = slice(filled, filled + harmonics.stop - harmonics.start)
        np.multiply(harmonic_rows[harmonics], light, out=patterns[rows])
        filled = rows.stop
    return patterns[:filled]


_RADIAL_LEVELS = 0.02, 0.05, 0.12, 0.3, 0.5, 0.7, 0.9
"""Shares of the peak between which the rings are."""


def radial_chi2(residuals: FitResiduals, grain: float | None) -> float:
    """Return the part of the misfit that depends on the distance from the centre alone, as of a ring."""
    solution, blocks = residuals.solution, residuals.blocks.rows
    weights = 1 / solution.variance(grain**2 if grain else solution.contrast2)
    light = solution.rows[SPOT] * blocks[F2]
    ring = np.digitize(solution.peak_shares, _RADIAL_LEVELS)
    scores, information = (
        np.bincount(ring, weights * light * of, len(_RADIAL_LEVELS) + 1)
        for of in (solution.rows[RESIDUAL], light)
    )
    return float(np.sum(scores**2 / np.maximum(information, 1e-12)))
