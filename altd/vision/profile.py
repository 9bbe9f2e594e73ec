"""Fine localisation: a super-Gaussian fitted through the flat, with the weights that its noise deserves."""

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

_ITERATIONS = 16
_CONVERGED_SIGMAS = 3e-4
_CONVERGED_SHAPE = 0.02
_CONVERGED_GRAIN2 = 1.0
_LATE = 11
_CONVERGED_LATE_SIGMAS = 3e-3
_LONGEST_STEP = 0.5
_FINE_BELOW_PX = 24.0
"""Spots below this 1/e² diameter are fitted pixel by pixel: a block would be too coarse."""

_ORDER_FREE_FROM = 1
_ORDERS = 0.6, 8.0
_ORDER_PRIOR_SIGMA = 0.5
_ORDER_HELD_SIGMA = 1e-6
_GRAIN_AT_FIRST = 0.04
_GRAINS = 0.003, 1.0
_GRAIN_SEEN_FROM = 0.1
_SPECK_SIGMAS = 4.5
"""Of 200 blocks of good grain one in 700 spots has one so far off."""
_SPECK_SEEN_FROM = 0.05
_MAX_SPECK_SHARE = 0.12
"""More is no dust: the spot is not what it is taken for, and the misfit shall show it."""
_FARTHEST_DIAMETERS = 0.25
_FARTHEST_DIAMETERS_CUT = 1.0
"""The middle of what the image shows of a spot says less of its centre."""

_SLOPE_SHARE_PER_PX = 2e-5
"""By how much of itself the background may rise or fall over a pixel beside what the whole frame shows of it.
More freedom would cost: on speckle a slope looks much like a shift of the centre (1.5e-4: a tenth more
scatter)."""
_LEAST_SLOPE_COUNTS_PER_PX = 2e-5

_PEAK, _U, _V, _A, _B, _C, _REST, _RISE_X, _RISE_Y, _ORDER, _RESIDUAL = range(11)
_State = Sequence[float]
"""The first ten of these, in units of the seed's sigma: plain numbers, which Python handles faster."""


@dataclass(frozen=True, slots=True, eq=False)
class Profile:
    """A spot E = peak · exp(−q^order), q = ½ (a du² + 2 b du dv + c dv²); order 1 is a Gaussian.

    ``form`` holds a, b, c in 1/px², ``rest`` the counts by which the background was off, ``residuals`` what
    the spot does not explain.
    """

    centre: Centre
    peak: float
    form: tuple[float, float, float]
    order: float
    rest: float
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
    """Where the iteration came to rest, and what it knew there.

    ``centre_variance`` is what read and shot noise do to the centre, the mean square of both axes; ``rows``
    are the derivatives and the residual.
    """

    state: _State
    centre_variance: float
    rows: FloatArray
    noise_variance: FloatArray
    grain_variance: FloatArray
    grain2: float
    spot: FloatArray


def fit_profile(
    patch: Patch,
    flat: Flat | None,
    diameter_px: float,
    noise: Noise,
    clipped: npt.NDArray[np.bool_] | None = None,
) -> Profile | None:
    """Fit the spot of a patch; None when no profile fits it.

    ``diameter_px`` is about the spot's; pixels that are ``clipped``, as a mask of the patch, do not count.
    Weighted least squares over blocks of ΣF·I for peak, centre, form, order, and what is left of the
    background: a constant, and a slope that is small against it. The variance of a block is read noise, shot
    noise and grain: the relative scatter of the light (speckle, rest of the print), which the fit estimates
    from its own residuals, so that a clean spot as well as a coarse one gets the weights that it deserves. On
    blocks of one dot pitch the centre is as good as on pixels. A few blocks that lie far off are left out: a
    speck of dust makes such.
    """
    seed = patch.outline
    sigma_px = diameter_px / 4
    data = blocks_of(patch, flat, clipped, noise, sigma_px, BLOCK_PX if diameter_px >= _FINE_BELOW_PX else 1)
    rise = max(_SLOPE_SHARE_PER_PX * patch.background_counts, _LEAST_SLOPE_COUNTS_PER_PX) * sigma_px
    # an even ellipse's second moments: those of the spot but for a factor
    scale = 1 / math.sqrt(max(seed.uu * seed.vv - seed.uv**2, 1e-12))
    form = scale * seed.vv, -scale * seed.uv, scale * seed.uu
    solution = _solve(data, (patch.peak, 0.0, 0.0, *form, 0.0, 0.0, 0.0, 1.0), rise)
    if solution is None:
        return None
    clean = _without_specks(solution)
    if clean is not None:
        data = data.only(clean)
        again = _solve(data, solution.state, rise, order_free_from=0)
        if again is None:
            return None
        solution = again
    peak, u, v, a, b, c, rest, _, _, order = solution.state
    farthest = _FARTHEST_DIAMETERS_CUT if patch.cut else _FARTHEST_DIAMETERS
    if math.hypot(u, v) * sigma_px > farthest * diameter_px:
        return None
    return Profile(
        Centre(
            patch.left + seed.u + u * sigma_px,
            patch.top + seed.v + v * sigma_px,
            sigma_px * math.sqrt(solution.centre_variance),
        ),
        peak,
        (a / sigma_px**2, b / sigma_px**2, c / sigma_px**2),
        order,
        rest,
        _residuals(data, solution, sigma_px, rise),
    )


def _residuals(data: Blocks, solution: _Solution, sigma_px: float, rise: float) -> Residuals:
    """What the fit leaves over, its centre in px."""
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
        pull=prior * (known - solution.state),
        noise_variance=solution.noise_variance,
        grain_variance=solution.grain_variance,
        grain=math.sqrt(solution.grain2),
        irradiance=solution.spot / peak,
        spot_light=solution.spot * data.f2,
        flat_light=peak * data.f1,
        direction=places / np.maximum(np.abs(places), 1e-12),
    )


def _without_specks(solution: _Solution) -> npt.NDArray[np.bool_] | None:
    """(n,) which blocks no dust hides, where a few are hidden; None where none is or nobody could tell."""
    residual = solution.rows[_RESIDUAL]
    sigmas = np.abs(residual) / np.sqrt(solution.noise_variance + solution.grain2 * solution.grain_variance)
    lit: npt.NDArray[np.bool_] = solution.spot > _SPECK_SEEN_FROM * solution.state[_PEAK]
    usual = mad_sigma(sigmas[lit]) if lit.any() else 0.0
    specks = lit & (sigmas > _SPECK_SIGMAS * usual)
    if not 0 < np.count_nonzero(specks) <= _MAX_SPECK_SHARE * np.count_nonzero(lit):
        return None
    clean: npt.NDArray[np.bool_] = ~specks
    return clean


def _solve(
    data: Blocks, state: _State, rise: float, order_free_from: int = _ORDER_FREE_FROM
) -> _Solution | None:
    """Gauss-Newton; None when it does not converge.

    ``rise`` is the standard deviation of the background's slopes, counts per sigma of the seed. Some three
    hundred blocks are so few that numpy's calls cost more than its sums: what belongs together is one array,
    and one product gives the normal equations with their right-hand side.
    """
    grain2 = grain2_before = _GRAIN_AT_FIRST**2
    rows = np.empty((_RESIDUAL + 1, data.light.size))
    rows[_REST : _RISE_Y + 1] = data.f1 * data.monomials[:3]
    bright = np.empty(data.light.size)
    for iteration in range(_ITERATIONS):
        spot = _linearise(data, state, rows)
        free = iteration >= order_free_from
        noise_variance = data.read_variance + spot * data.shot_variance
        grain_variance = spot * spot
        grain_variance *= data.grain_variance
        if free:
            residual = rows[_RESIDUAL]
            np.greater(spot, _GRAIN_SEEN_FROM * state[_PEAK], out=bright)  # 0 or 1
            unexplained = float((residual * bright) @ residual - noise_variance @ bright)
            per_grain2 = float(grain_variance @ bright)
            if per_grain2 <= 0:
                return None  # no pixel that counts lies where the spot is
            grain2_before = grain2
            grain2 = min(max(unexplained / per_grain2, _GRAINS[0] ** 2), _GRAINS[1] ** 2)
        weighted = rows[:_RESIDUAL] / (noise_variance + grain2 * grain_variance)
        equations = weighted @ rows.T
        order_sigma = _ORDER_PRIOR_SIGMA if free else _ORDER_HELD_SIGMA
        for index, known, sigma in ((_RISE_X, 0.0, rise), (_RISE_Y, 0.0, rise), (_ORDER, 1.0, order_sigma)):
            equations[index, index] += sigma**-2
            equations[index, _RESIDUAL] += (known - state[index]) * sigma**-2
        try:
            covariance = np.linalg.inv(equations[:, :_RESIDUAL])
        except np.linalg.LinAlgError:
            return None
        moved = _moved(state, (covariance @ equations[:, _RESIDUAL]).tolist())
        if moved is None:
            return None
        change = [abs(after - before) for after, before in zip(moved, state, strict=True)]
        state = moved
        even = abs(grain2 - grain2_before) < _CONVERGED_GRAIN2 * grain2
        if free and _is_settled(change, even, iteration >= _LATE):
            levers = covariance[_U : _V + 1] @ weighted
            centre_variance = float((np.square(levers) @ noise_variance).sum()) / 2
            return _Solution(state, centre_variance, rows, noise_variance, grain_variance, grain2, spot)
    return None


def _is_settled(change: Sequence[float], even: bool, late: bool) -> bool:
    """Whether the last step moved centre and shape by next to nothing; an order at its limit is at rest.

    ``even``: so is the grain, which decides on the weights. A small spot with a hard edge may swing between
    shapes for ever: late on, a centre at rest is enough.
    """
    if late:
        return max(change[_U], change[_V]) < _CONVERGED_LATE_SIGMAS
    if not even or max(change[_U], change[_V]) > _CONVERGED_SIGMAS:
        return False
    return max(change[_A], change[_C], change[_ORDER]) < _CONVERGED_SHAPE


def _linearise(data: Blocks, state: _State, rows: FloatArray) -> FloatArray:
    """Irradiance at the blocks; fills in the derivatives of the blocks' light and what is left over of it."""
    peak, u, v, a, b, c, rest, rise_x, rise_y, order = state
    pull_u, pull_v = a * u + b * v, b * u + c * v
    quadratics = np.array(
        (
            ((u * pull_u + v * pull_v) / 2, -pull_u, -pull_v, a / 2, b, c / 2),  # q
            (-pull_u, a, b, 0.0, 0.0, 0.0),  # −∂q/∂u
            (-pull_v, b, c, 0.0, 0.0, 0.0),  # −∂q/∂v
            (-u * u / 2, u, 0.0, -0.5, 0.0, 0.0),  # −∂q/∂a
            (-u * v, v, u, 0.0, -1.0, 0.0),  # −∂q/∂b
            (-v * v / 2, 0.0, v, 0.0, 0.0, -0.5),  # −∂q/∂c
            (rest, rise_x, rise_y, 0.0, 0.0, 0.0),
        )
    )
    polynomials = quadratics @ data.monomials
    q, background = polynomials[0], polynomials[-1]
    np.maximum(q, 1e-9, out=q)
    logarithm = np.log(q)
    raised = np.exp(order * logarithm)
    shape: FloatArray = np.exp(-raised)
    steep = raised / q
    steep *= order
    f2 = data.f2 if data.bends is None else data.f2 * _bent(data.bends, steep, polynomials[1:3], (a, b, c))
    np.multiply(shape, f2, out=rows[_PEAK])
    fall = rows[_PEAK] * peak
    np.subtract(data.light, fall, out=rows[_RESIDUAL])
    background *= data.f1
    rows[_RESIDUAL] -= background
    raised *= logarithm
    np.multiply(fall, raised, out=rows[_ORDER])
    np.negative(rows[_ORDER], out=rows[_ORDER])
    fall *= steep
    np.multiply(polynomials[1:-1], fall, out=rows[_U : _C + 1])
    shape *= peak
    return shape


def _bent(
    bends: FloatArray, steep: FloatArray, along: FloatArray, form: tuple[float, float, float]
) -> FloatArray:
    """Mean of the spot over each block against its value where the block measures.

    1 + ½ (m_xx E_xx + 2 m_xy E_xy + m_yy E_yy) / E, with the derivatives that a Gaussian as steep as the spot
    is there has; ``along`` (2, n) is the gradient of q. Where the rows of dots run along those of pixels, the
    moments beat, and without this so does the centre: by 0.02 px.
    """
    xx, xy, yy = bends
    by_x, by_y = along * steep
    bent: FloatArray = np.asarray(form) @ bends
    bent *= steep
    np.subtract(1.0, bent, out=bent)
    bent += (xx * by_x + xy * by_y) * by_x
    by_y *= by_y
    by_y *= yy
    bent += by_y
    return bent


def _moved(state: _State, step: Sequence[float]) -> _State | None:
    """A step, shortened until the form stays an ellipse and nothing leaps; None when it cannot be."""
    longest = max(
        abs(step[_U]), abs(step[_V]), *(abs(step[index] / state[index]) for index in (_A, _C, _ORDER))
    )
    if not math.isfinite(longest):
        return None
    scale = min(1.0, _LONGEST_STEP / max(longest, 1e-12))
    while scale > 1e-3:
        moved = [s + scale * d for s, d in zip(state, step, strict=True)]
        a, b, c = moved[_A : _C + 1]
        if moved[_PEAK] > 0 and a > 0 and c > 0 and a * c > b * b:
            moved[_ORDER] = min(max(moved[_ORDER], _ORDERS[0]), _ORDERS[1])
            return moved
        scale /= 2
    return None
