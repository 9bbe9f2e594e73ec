"""Fine localisation: a super-Gaussian fitted through the flat field, weighted by the inverse variance."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from altd.records import FloatArray
from altd.statistics.robust import mad_sigma
from altd.vision.blocks import Blocks, blocks_of
from altd.vision.centre import Centre, Noise
from altd.vision.flat import BLOCK_PX, Flat
from altd.vision.misfit import Residuals
from altd.vision.patch import Patch

_MAX_ITERATIONS = 16
_CONVERGED_SIGMAS = 3e-4
_CONVERGED_SHAPE = 0.02
_CONVERGED_CONTRAST2 = 1.0
_LATE_ITERATION = 11
_LATE_CONVERGED_SIGMAS = 3e-3
_MAX_STEP = 0.5
_MIN_BLOCK_DIAMETER_PX = 24.0
"""Spots below this 1/e² diameter are fitted pixel by pixel: a block would be too coarse."""

_ORDER_FREE_ITERATION = 1
_MIN_ORDER, _MAX_ORDER = 0.6, 8.0
_ORDER_PRIOR_SIGMA = 0.5
_ORDER_HELD_SIGMA = 1e-6
_INITIAL_CONTRAST = 0.04
_MIN_CONTRAST, _MAX_CONTRAST = 0.003, 1.0
_MIN_PEAK_SHARE_FOR_CONTRAST = 0.1
_MIN_SPECK_SIGMAS = 4.5
"""Of 200 blocks of ordinary surface texture one in 700 spots has one so far off."""
_MIN_SPECK_PEAK_SHARE = 0.05
_MAX_SPECK_SHARE = 0.12
"""More is no dust: the spot has another profile, and the misfit shall show it."""
_MAX_OFFSET_DIAMETERS = 0.25
_MAX_OFFSET_DIAMETERS_CUT = 1.0
"""For a spot cut by the image's edge, whose visible part lies off its centre."""

_SLOPE_SHARE_PER_PX = 2e-5
"""Prior standard deviation of the local background slope, as a share of the background. A wider prior costs
precision: on speckle a slope is correlated with a shift of the centre (1.5e-4: a tenth more scatter)."""
_MIN_SLOPE_COUNTS_PER_PX = 2e-5

_PEAK, _U, _V, _A, _B, _C, _OFFSET, _RISE_X, _RISE_Y, _ORDER, _RESIDUAL = range(11)
_State = Sequence[float]
"""The first ten of these, in units of the initial estimate's sigma: plain numbers, faster in Python."""


@dataclass(frozen=True, slots=True, eq=False)
class Profile:
    """A spot E = peak · exp(−q^order), q = ½ (a du² + 2 b du dv + c dv²); order 1 is a Gaussian.

    ``form`` holds a, b, c in 1/px², ``background_offset`` the counts by which the estimated background was
    wrong, ``residuals`` what the spot does not explain.
    """

    centre: Centre
    peak: float
    form: tuple[float, float, float]
    order: float
    background_offset: float
    residuals: Residuals

    def irradiance(self, u_px: FloatArray, v_px: FloatArray) -> FloatArray:
        """E in counts at columns ``u_px`` (w,) and rows ``v_px`` (h,), as (h, w)."""
        a, b, c = self.form
        du, dv = u_px - self.centre.u_px, (v_px - self.centre.v_px)[:, None]
        q = np.maximum(0.5 * (a * du * du + 2 * b * du * dv + c * dv * dv), 0.0)
        counts: FloatArray = self.peak * np.exp(-(q**self.order))
        return counts


@dataclass(frozen=True, slots=True, eq=False)
class _Solution:
    """The converged state, and the matrices of the last iteration.

    ``centre_variance`` is what read and shot noise do to the centre, the mean square of both axes; ``rows``
    are the derivatives and the residual.
    """

    state: _State
    centre_variance: float
    rows: FloatArray
    noise_variance: FloatArray
    texture_variance: FloatArray
    contrast2: float
    spot: FloatArray


def fit_profile(
    patch: Patch,
    flat: Flat | None,
    diameter_px: float,
    noise: Noise,
    clipped: npt.NDArray[np.bool_] | None = None,
) -> Profile | None:
    """Fit the spot of a patch; None when no profile fits it.

    ``diameter_px`` is an estimate of the spot's; pixels that are ``clipped``, as a mask of the patch, are
    left out. Weighted least squares over blocks of ΣF·I for peak, centre, form, order, and the error of the
    background: a constant, and a slope that is small against it. The variance of a block is read noise, shot
    noise and surface texture: the relative scatter of the light (speckle, residual print), which the fit
    estimates from its own residuals. On blocks of one dot pitch the centre is as precise as on pixels. A few
    outlier blocks are left out: a speck of dust makes such.
    """
    outline = patch.outline
    sigma_px = diameter_px / 4
    data = blocks_of(
        patch, flat, clipped, noise, sigma_px, BLOCK_PX if diameter_px >= _MIN_BLOCK_DIAMETER_PX else 1
    )
    rise = max(_SLOPE_SHARE_PER_PX * patch.background_counts, _MIN_SLOPE_COUNTS_PER_PX) * sigma_px
    # second moments of a uniform ellipse: those of the spot but for a factor
    scale = 1 / math.sqrt(max(outline.uu * outline.vv - outline.uv**2, 1e-12))
    form = scale * outline.vv, -scale * outline.uv, scale * outline.uu
    solution = _solve(data, (patch.peak, 0.0, 0.0, *form, 0.0, 0.0, 0.0, 1.0), rise)
    if solution is None:
        return None
    clean = _clean_blocks(solution)
    if clean is not None:
        data = data.only(clean)
        refined = _solve(data, solution.state, rise, order_free_iteration=0)
        if refined is None:
            return None
        solution = refined
    peak, u, v, a, b, c, offset, _, _, order = solution.state
    max_offset_diameters = _MAX_OFFSET_DIAMETERS_CUT if patch.is_cut else _MAX_OFFSET_DIAMETERS
    if math.hypot(u, v) * sigma_px > max_offset_diameters * diameter_px:
        return None
    return Profile(
        Centre(
            patch.left + outline.u + u * sigma_px,
            patch.top + outline.v + v * sigma_px,
            sigma_px * math.sqrt(solution.centre_variance),
        ),
        peak,
        (a / sigma_px**2, b / sigma_px**2, c / sigma_px**2),
        order,
        offset,
        _residuals(data, solution, sigma_px, rise),
    )


def _residuals(data: Blocks, solution: _Solution, sigma_px: float, rise: float) -> Residuals:
    """The residuals of the fit, with the derivatives by the centre in px."""
    peak, u, v, a, b, c, *_ = solution.state
    derivatives, light = solution.rows[:_RESIDUAL], solution.rows[_RESIDUAL]
    derivatives[_U : _V + 1] /= sigma_px
    prior, known = np.zeros(_RESIDUAL), np.array(solution.state)
    prior[_RISE_X : _ORDER + 1] = rise**-2, rise**-2, _ORDER_PRIOR_SIGMA**-2
    known[_RISE_X : _ORDER + 1] = 0.0, 0.0, 1.0
    # a root of the form turns the ellipse into a circle and, being symmetric, keeps the directions nearly
    root = math.sqrt(a * c - b * b)
    x, y = data.monomials[1] - u, data.monomials[2] - v
    places = (a + root) * x + b * y + 1j * (b * x + (c + root) * y)
    return Residuals(
        light=light,
        derivatives=derivatives,
        prior=prior,
        prior_gradient=prior * (known - solution.state),
        noise_variance=solution.noise_variance,
        texture_variance=solution.texture_variance,
        texture_contrast=math.sqrt(solution.contrast2),
        irradiance=solution.spot / peak,
        spot_light=solution.spot * data.f2,
        flat_light=peak * data.f1,
        direction=places / np.maximum(np.abs(places), 1e-12),
    )


def _clean_blocks(solution: _Solution) -> npt.NDArray[np.bool_] | None:
    """The mask (n,) of blocks without dust, where dust hides a few; None where it hides none or too many."""
    residual = solution.rows[_RESIDUAL]
    sigmas = np.abs(residual) / np.sqrt(
        solution.noise_variance + solution.contrast2 * solution.texture_variance
    )
    lit: npt.NDArray[np.bool_] = solution.spot > _MIN_SPECK_PEAK_SHARE * solution.state[_PEAK]
    lit_sigma = mad_sigma(sigmas[lit]) if lit.any() else 0.0
    specks = lit & (sigmas > _MIN_SPECK_SIGMAS * lit_sigma)
    if not 0 < np.count_nonzero(specks) <= _MAX_SPECK_SHARE * np.count_nonzero(lit):
        return None
    clean: npt.NDArray[np.bool_] = ~specks
    return clean


def _solve(
    data: Blocks, state: _State, rise: float, order_free_iteration: int = _ORDER_FREE_ITERATION
) -> _Solution | None:
    """Gauss-Newton; None when it does not converge.

    ``rise`` is the prior standard deviation of the background's slopes, counts per sigma of the initial
    estimate. With some three hundred blocks numpy's call overhead dominates: what belongs together is one
    array, and one product gives the normal equations with their right-hand side.
    """
    contrast2 = contrast2_before = _INITIAL_CONTRAST**2
    rows = np.empty((_RESIDUAL + 1, data.light.size))
    rows[_OFFSET : _RISE_Y + 1] = data.f1 * data.monomials[:3]
    bright = np.empty(data.light.size)
    for iteration in range(_MAX_ITERATIONS):
        spot = _linearise(data, state, rows)
        is_order_free = iteration >= order_free_iteration
        noise_variance = data.read_variance + spot * data.shot_variance
        texture_variance = spot * spot
        texture_variance *= data.texture_variance
        if is_order_free:
            residual = rows[_RESIDUAL]
            np.greater(spot, _MIN_PEAK_SHARE_FOR_CONTRAST * state[_PEAK], out=bright)  # 0 or 1
            unexplained = float((residual * bright) @ residual - noise_variance @ bright)
            per_contrast2 = float(texture_variance @ bright)
            if per_contrast2 <= 0:
                return None  # no usable pixel lies within the spot
            contrast2_before = contrast2
            contrast2 = min(max(unexplained / per_contrast2, _MIN_CONTRAST**2), _MAX_CONTRAST**2)
        weighted = rows[:_RESIDUAL] / (noise_variance + contrast2 * texture_variance)
        equations = weighted @ rows.T
        order_sigma = _ORDER_PRIOR_SIGMA if is_order_free else _ORDER_HELD_SIGMA
        for index, known, sigma in ((_RISE_X, 0.0, rise), (_RISE_Y, 0.0, rise), (_ORDER, 1.0, order_sigma)):
            equations[index, index] += sigma**-2
            equations[index, _RESIDUAL] += (known - state[index]) * sigma**-2
        try:
            covariance = np.linalg.inv(equations[:, :_RESIDUAL])
        except np.linalg.LinAlgError:
            return None
        stepped = _damped_step(state, (covariance @ equations[:, _RESIDUAL]).tolist())
        if stepped is None:
            return None
        change = [abs(after - before) for after, before in zip(stepped, state, strict=True)]
        state = stepped
        contrast_is_steady = abs(contrast2 - contrast2_before) < _CONVERGED_CONTRAST2 * contrast2
        if is_order_free and _is_converged(change, contrast_is_steady, iteration >= _LATE_ITERATION):
            sensitivities = covariance[_U : _V + 1] @ weighted
            centre_variance = float((np.square(sensitivities) @ noise_variance).sum()) / 2
            return _Solution(state, centre_variance, rows, noise_variance, texture_variance, contrast2, spot)
    return None


def _is_converged(change: Sequence[float], contrast_is_steady: bool, is_late: bool) -> bool:
    """Whether the last step changed centre and shape by less than the tolerances.

    ``contrast_is_steady``: so did the texture contrast, which decides on the weights. A small spot with a
    hard edge may oscillate between shapes for ever: in late iterations a converged centre is enough.
    """
    if is_late:
        return max(change[_U], change[_V]) < _LATE_CONVERGED_SIGMAS
    if not contrast_is_steady or max(change[_U], change[_V]) > _CONVERGED_SIGMAS:
        return False
    return max(change[_A], change[_C], change[_ORDER]) < _CONVERGED_SHAPE


def _linearise(data: Blocks, state: _State, rows: FloatArray) -> FloatArray:
    """Irradiance at the blocks; fills ``rows`` with the derivatives and residuals of the blocks' light."""
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
    polynomials = quadratics @ data.monomials
    q, background = polynomials[0], polynomials[-1]
    np.maximum(q, 1e-9, out=q)
    logarithm = np.log(q)
    raised = np.exp(order * logarithm)
    shape: FloatArray = np.exp(-raised)
    steepness = raised / q
    steepness *= order
    f2 = (
        data.f2
        if data.half_moments is None
        else data.f2 * _block_mean_ratio(data.half_moments, steepness, polynomials[1:3], (a, b, c))
    )
    np.multiply(shape, f2, out=rows[_PEAK])
    spot_light = rows[_PEAK] * peak
    np.subtract(data.light, spot_light, out=rows[_RESIDUAL])
    background *= data.f1
    rows[_RESIDUAL] -= background
    raised *= logarithm
    np.multiply(spot_light, raised, out=rows[_ORDER])
    np.negative(rows[_ORDER], out=rows[_ORDER])
    spot_light *= steepness
    np.multiply(polynomials[1:-1], spot_light, out=rows[_U : _C + 1])
    shape *= peak
    return shape


def _block_mean_ratio(
    half_moments: FloatArray, steepness: FloatArray, along: FloatArray, form: tuple[float, float, float]
) -> FloatArray:
    """Mean of the spot over each block relative to its value at the block's centroid.

    1 + ½ (m_xx E_xx + 2 m_xy E_xy + m_yy E_yy) / E, with the derivatives of a Gaussian that is as steep
    there; ``along`` (2, n) is the gradient of q. Where the rows of dots run along those of pixels, the
    moments beat, and without this so does the centre: by 0.02 px.
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


def _damped_step(state: _State, step: Sequence[float]) -> _State | None:
    """The state after a step, damped until the form is an ellipse and no parameter leaps; None if none is."""
    largest = max(
        abs(step[_U]), abs(step[_V]), *(abs(step[index] / state[index]) for index in (_A, _C, _ORDER))
    )
    if not math.isfinite(largest):
        return None
    scale = min(1.0, _MAX_STEP / max(largest, 1e-12))
    while scale > 1e-3:
        stepped = [s + scale * d for s, d in zip(state, step, strict=True)]
        a, b, c = stepped[_A : _C + 1]
        if stepped[_PEAK] > 0 and a > 0 and c > 0 and a * c > b * b:
            stepped[_ORDER] = min(max(stepped[_ORDER], _MIN_ORDER), _MAX_ORDER)
            return stepped
        scale /= 2
    return None
