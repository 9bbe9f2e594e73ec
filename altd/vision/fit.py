"""Weighted least squares of a super-Gaussian and a sloping background through blocks: Gauss-Newton.

``solve`` runs compiled code if it was built (``kernel.c``), otherwise numpy; both give the same result.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from altd.records import FloatArray
from altd.vision import kernel
from altd.vision.blocks import (
    F1,
    F2,
    HALF_MOMENTS,
    LIGHT,
    MONOMIALS,
    READ_NOISE,
    SHOT_NOISE,
    SPOT_TEXTURE,
    Blocks,
)

_MAX_ITERATIONS = 16
_CONVERGED_SIGMAS = 3e-4
_CONVERGED_SHAPE = 0.02
_CONVERGED_CONTRAST2 = 1.0
_LATE_ITERATION = 11
_LATE_CONVERGED_SIGMAS = 3e-3
_MAX_STEP = 0.5

ORDER_FREE_ITERATION = 1
_MIN_ORDER, _MAX_ORDER = 0.6, 8.0
ORDER_PRIOR_SIGMA = 0.5
_ORDER_HELD_SIGMA = 1e-6
_INITIAL_CONTRAST = 0.04
_MIN_CONTRAST, _MAX_CONTRAST = 0.003, 1.0
_MIN_PEAK_SHARE_FOR_CONTRAST = 0.1

PEAK, U, V, A, B, C, OFFSET, RISE_X, RISE_Y, ORDER = range(10)
RESIDUAL, NOISE, TEXTURE, SPOT, ROWS = range(10, 15)
State = Sequence[float]
"""Parameters PEAK to ORDER in units of the initial estimate's sigma; plain numbers are faster in Python."""

_LIMITS = kernel.FitLimits(
    _INITIAL_CONTRAST**2,
    _MIN_CONTRAST**2,
    _MAX_CONTRAST**2,
    _MIN_PEAK_SHARE_FOR_CONTRAST,
    _CONVERGED_CONTRAST2,
    _CONVERGED_SIGMAS,
    _CONVERGED_SHAPE,
    _LATE_CONVERGED_SIGMAS,
    _MAX_STEP,
    _MIN_ORDER,
    _MAX_ORDER,
    ORDER_PRIOR_SIGMA,
    _ORDER_HELD_SIGMA,
    _MAX_ITERATIONS,
    _LATE_ITERATION,
)


@dataclass(frozen=True, slots=True, eq=False)
class FitState:
    """Converged state, and the matrices of the last iteration.

    ``rows`` (14, n) are the derivatives of the light by the parameters, its RESIDUAL, its variances by read
    and shot NOISE and by a TEXTURE of contrast 1, and the irradiance of the SPOT in counts.
    ``centre_variance`` is the variance of the centre by read and shot noise, the mean of both axes;
    ``contrast2`` is the squared texture contrast.
    """

    state: State
    rows: FloatArray
    centre_variance: float
    contrast2: float

    @property
    def derivatives(self) -> FloatArray:
        """Derivatives of the light by the parameters, (RESIDUAL, n)."""
        return self.rows[:RESIDUAL]

    @property
    def peak_shares(self) -> FloatArray:
        """Irradiance as a share of the peak, (n,)."""
        shares: FloatArray = self.rows[SPOT] / self.state[PEAK]
        return shares

    def variance(self, contrast2: float) -> FloatArray:
        """Return the variance of the light for that squared texture contrast, (n,)."""
        variance: FloatArray = self.rows[NOISE] + contrast2 * self.rows[TEXTURE]
        return variance


def solve(
    data: Blocks, state: State, rise: float, order_free_iteration: int = ORDER_FREE_ITERATION
) -> FitState | None:
    """Fit from an initial estimate; None if the fit does not converge.

    ``rise`` is the prior standard deviation of the background's slopes, counts per sigma of the initial
    estimate. The order is held until ``order_free_iteration``.
    """
    if not kernel.is_compiled():
        return solve_by_numpy(data, state, rise, order_free_iteration)
    found = kernel.fit(_LIMITS, data, state, rise, order_free_iteration)
    return None if found is None else FitState(*found)


def solve_by_numpy(data: Blocks, state: State, rise: float, order_free_iteration: int) -> FitState | None:
    """Fit like ``solve`` without compiled code.

    With some three hundred blocks numpy's call overhead dominates: related data is one array, and one product
    gives the normal equations with their right-hand side.
    """
    contrast2 = contrast2_before = _INITIAL_CONTRAST**2
    blocks = data.rows
    rows = np.empty((ROWS, blocks.shape[1]))
    rows[OFFSET : RISE_Y + 1] = blocks[F1] * blocks[MONOMIALS][:3]
    bright = np.empty(blocks.shape[1])
    residual, noise_variance, texture_variance, spot = rows[RESIDUAL:]
    for iteration in range(_MAX_ITERATIONS):
        _linearise(data, state, rows)
        np.multiply(spot, blocks[SHOT_NOISE], out=noise_variance)
        noise_variance += blocks[READ_NOISE]
        np.multiply(spot, spot, out=texture_variance)
        texture_variance *= blocks[SPOT_TEXTURE]
        is_order_free = iteration >= order_free_iteration
        if is_order_free:
            np.greater(spot, _MIN_PEAK_SHARE_FOR_CONTRAST * state[PEAK], out=bright)  # 0 or 1
            unexplained = float((residual * bright) @ residual - noise_variance @ bright)
            per_contrast2 = float(texture_variance @ bright)
            if per_contrast2 <= 0:
                return None  # no usable pixel is within the spot
            contrast2_before = contrast2
            contrast2 = min(max(unexplained / per_contrast2, _MIN_CONTRAST**2), _MAX_CONTRAST**2)
        weighted = rows[:RESIDUAL] / (noise_variance + contrast2 * texture_variance)
        equations = weighted @ rows[: RESIDUAL + 1].T
        order_sigma = ORDER_PRIOR_SIGMA if is_order_free else _ORDER_HELD_SIGMA
        for index, known, sigma in ((RISE_X, 0.0, rise), (RISE_Y, 0.0, rise), (ORDER, 1.0, order_sigma)):
            equations[index, index] += sigma**-2
            equations[index, RESIDUAL] += (known - state[index]) * sigma**-2
        try:
            covariance = np.linalg.inv(equations[:, :RESIDUAL])
        except np.linalg.LinAlgError:
            return None
        stepped = _damped_step(state, (covariance @ equations[:, RESIDUAL]).tolist())
        if stepped is None:
            return None
        change = [abs(after - before) for after, before in zip(stepped, state, strict=True)]
        state = stepped
        contrast_is_steady = abs(contrast2 - contrast2_before) < _CONVERGED_CONTRAST2 * contrast2
        if is_order_free and _is_converged(change, contrast_is_steady, iteration >= _LATE_ITERATION):
            sensitivities = covariance[U : V + 1] @ weighted
            centre_variance = float((np.square(sensitivities) @ noise_variance).sum()) / 2
            return FitState(state, rows, centre_variance, contrast2)
    return None


def _is_converged(change: Sequence[float], contrast_is_steady: bool, is_late: bool) -> bool:
    """Return whether the last step changed centre and shape by less than the tolerances.

    ``contrast_is_steady``: so did the texture contrast, which determines the weights. A small spot with a
    hard edge may oscillate between shapes indefinitely: in late iterations a converged centre is enough.
    """
    if is_late:
        return max(change[U], change[V]) < _LATE_CONVERGED_SIGMAS
    if not contrast_is_steady or max(change[U], change[V]) > _CONVERGED_SIGMAS:
        return False
    return max(change[A], change[C], change[ORDER]) < _CONVERGED_SHAPE


def _linearise(data: Blocks, state: State, rows: FloatArray) -> None:
    """Fill ``rows`` with the derivatives and residuals of the blocks' light, and the irradiance there."""
    peak, u, v, a, b, c, offset, rise_x, rise_y, order = state
    pull_u, pull_v = a * u + b * v, b * u + c * v
    quadratics = np.array(
        (
            ((u * pull_u + v * pull_v) / 2, -pull_u, -pull_v, a / 2, b, c / 2),  # q
            (-pull_u, a, b, 0.0, 0.0, 0.0),  # −∂q/∂u
            (-pull_v, b, c, 0.0, 0.0, 0.0),  # −∂q/∂v
            (-u * u / 2, u, 0.0, -0.5, 0.0, 0.0),  # −∂q/∂a
            (-u * v, v, u, 0.0, -1.0, 0.0),  # −∂q/∂b
            (-v * v / 2, 0.0, v, 0.0, 0.0, -0.5),  # −∂q/∂c
            (offset, rise_x, rise_y, 0.0, 0.0, 0.0),
        )
    )
    polynomials = quadratics @ data.rows[MONOMIALS]
    q, background = polynomials[0], polynomials[-1]
    np.maximum(q, 1e-9, out=q)
    logarithm = np.log(q)
    raised = np.exp(order * logarithm)
    shape = np.exp(-raised)
    steepness = raised / q
    steepness *= order
    f2 = data.rows[F2]
    if data.has_moments:
        f2 = f2 * _block_mean_ratio(data.rows[HALF_MOMENTS], steepness, polynomials[1:3], (a, b, c))
    np.multiply(shape, f2, out=rows[PEAK])
    spot_light = rows[PEAK] * peak
    np.subtract(data.rows[LIGHT], spot_light, out=rows[RESIDUAL])
    background *= data.rows[F1]
    rows[RESIDUAL] -= background
    raised *= logarithm
    np.multiply(spot_light, raised, out=rows[ORDER])
    np.negative(rows[ORDER], out=rows[ORDER])
    spot_light *= steepness
    np.multiply(polynomials[1:-1], spot_light, out=rows[U : C + 1])
    np.multiply(shape, peak, out=rows[SPOT])


def _block_mean_ratio(
    half_moments: FloatArray, steepness: FloatArray, along: FloatArray, form: tuple[float, float, float]
) -> FloatArray:
    """Return the mean of the spot over each block relative to its value at the block's centroid.

    1 + ½ (m_xx E_xx + 2 m_xy E_xy + m_yy E_yy) / E, with the derivatives of a Gaussian of the same steepness
    there; ``along`` (2, n) is the gradient of q. If the rows of dots run along those of pixels, the moments
    beat, and without this the centre does too: by 0.02 px.
    """
    xx, xy, yy = half_moments
    by_x, by_y = along * steepness
    ratio: FloatArray = np.asarray(form) @ half_moments
    ratio *= steepness
    np.subtract(1.0, ratio, out=ratio)
    ratio += (xx * by_x + xy * by_y) * by_x
    by_y *= by_y
    by_y *= yy
    ratio += by_y
    return ratio


def _damped_step(state: State, step: Sequence[float]) -> State | None:
    """Return the state after a step, damped to an ellipse without a leaping parameter; None if impossible."""
    largest = max(abs(step[U]), abs(step[V]), *(abs(step[index] / state[index]) for index in (A, C, ORDER)))
    if not math.isfinite(largest):
        return None
    scale = min(1.0, _MAX_STEP / max(largest, 1e-12))
    while scale > 1e-3:
        stepped = [s + scale * d for s, d in zip(state, step, strict=True)]
        a, b, c = stepped[A : C + 1]
        if stepped[PEAK] > 0 and a > 0 and c > 0 and a * c > b * b:
            stepped[ORDER] = min(max(stepped[ORDER], _MIN_ORDER), _MAX_ORDER)
            return stepped
        scale /= 2
    return None
