"""Fine localisation: a super-Gaussian fitted through the flat, with the weights that its noise deserves."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from altd.records import FloatArray
from altd.vision.centre import Centre, Noise
from altd.vision.flat import BLOCK_PX, BlockSums, Flat, block_sum, block_sums
from altd.vision.patch import Patch

_ITERATIONS = 16
_CONVERGED_SIGMAS = 3e-4
_CONVERGED_SHAPE = 0.02
_CONVERGED_GRAIN2 = 1.0
_LONGEST_STEP = 0.5
_FINE_BELOW_PX = 24.0
"""Spots below this 1/e² diameter are fitted pixel by pixel: a block would be too coarse."""

_ORDER_FREE_FROM = 1
_ORDERS = 0.6, 6.0
_ORDER_PRIOR_SIGMA = 0.5
_ORDER_HELD_SIGMA = 1e-6
_GRAIN_AT_FIRST = 0.02
_GRAINS = 0.003, 1.0
_GRAIN_SEEN_FROM = 0.1
_FARTHEST_DIAMETERS = 0.25

_PEAK, _U, _V, _A, _B, _C, _REST, _ORDER, _RESIDUAL = range(9)
_State = tuple[float, float, float, float, float, float, float, float]
"""The first eight of these, in units of the seed's sigma: plain numbers, which Python handles faster."""


@dataclass(frozen=True, slots=True)
class Profile:
    """A spot E = peak · exp(−q^order), q = ½ (a du² + 2 b du dv + c dv²); order 1 is a Gaussian.

    ``form`` holds a, b, c in 1/px², ``rest`` the counts by which the background was off. ``pattern_px`` is
    what the grain does to the centre, rms of both axes; ``grain`` is the relative scatter of single pixels
    that the fit has seen.
    """

    centre: Centre
    peak: float
    form: tuple[float, float, float]
    order: float
    rest: float
    grain: float
    pattern_px: float

    def irradiance(self, u_px: FloatArray, v_px: FloatArray) -> FloatArray:
        """E in counts at columns ``u_px`` (w,) and rows ``v_px`` (h,), as (h, w)."""
        a, b, c = self.form
        du, dv = u_px - self.centre.u_px, (v_px - self.centre.v_px)[:, None]
        q = np.maximum(0.5 * (a * du * du + 2 * b * du * dv + c * dv * dv), 0.0)
        counts: FloatArray = self.peak * np.exp(-(q**self.order))
        return counts


@dataclass(frozen=True, slots=True, eq=False)
class _Data:
    """Blocks as vectors: Σ F·I, the sums of F, and where they measure in units of the seed's sigma."""

    light: FloatArray
    monomials: FloatArray
    """1, x, y, x², xy, y² as rows."""
    f1: FloatArray
    f2: FloatArray
    read_variance: FloatArray
    shot_variance: FloatArray
    """Per count of irradiance."""
    grain_variance: FloatArray
    """Per squared count of irradiance and squared grain."""


def fit_profile(
    patch: Patch,
    flat: Flat | None,
    diameter_px: float,
    noise: Noise,
    clipped: npt.NDArray[np.bool_] | None = None,
) -> Profile | None:
    """Fit the spot of a patch; None when no profile fits it.

    ``diameter_px`` is about the spot's; pixels that are ``clipped``, as a mask of the patch, do not count.
    Weighted least squares over blocks of ΣF·I for peak, centre, form, a rest of background, and order. The
    variance of a block is read noise, shot noise and grain: the relative scatter of the light (speckle, rest
    of the print), which the fit estimates from its own residuals, so that a clean spot as well as a coarse
    one gets the weights that it deserves. On blocks of one dot pitch the centre is as good as on pixels.
    """
    seed = patch.outline
    sigma_px = diameter_px / 4
    size = BLOCK_PX if diameter_px >= _FINE_BELOW_PX else 1
    data = _data(patch, flat, clipped, noise, size, sigma_px)
    # an even ellipse's second moments: those of the spot but for a factor
    scale = 1 / math.sqrt(max(seed.uu * seed.vv - seed.uv**2, 1e-12))
    form = scale * seed.vv, -scale * seed.uv, scale * seed.uu
    solution = _solve(data, (patch.peak, 0.0, 0.0, *form, 0.0, 1.0))
    if solution is None:
        return None
    state, grain2, covariance_noise, covariance_grain = solution
    peak, u, v, a, b, c, rest, order = state
    if math.hypot(u, v) * sigma_px > _FARTHEST_DIAMETERS * diameter_px:
        return None
    return Profile(
        Centre(
            patch.left + seed.u + u * sigma_px,
            patch.top + seed.v + v * sigma_px,
            sigma_px * math.sqrt(covariance_noise),
        ),
        peak,
        (a / sigma_px**2, b / sigma_px**2, c / sigma_px**2),
        order,
        rest,
        math.sqrt(grain2),
        sigma_px * math.sqrt(covariance_grain),
    )


def _data(
    patch: Patch,
    flat: Flat | None,
    clipped: npt.NDArray[np.bool_] | None,
    noise: Noise,
    size: int,
    sigma_px: float,
) -> _Data:
    height, width = patch.excess.shape
    light, left, top = patch.excess, 0, 0
    if flat is None and clipped is None:
        sums = _plain_sums(height, width, size)
    else:
        window = slice(patch.top, patch.top + height), slice(patch.left, patch.left + width)
        response = np.ones((height, width), np.float32) if flat is None else flat.response[window]
        if clipped is not None:
            response = np.where(clipped, np.float32(0), response)
        light = light * response
        if flat is None or clipped is not None or size != BLOCK_PX:
            sums = block_sums(response, 0, 0, size)
        else:
            left, top = patch.left, patch.top
            rows, columns = (
                slice(top // size, (top + height) // size),
                slice(left // size, (left + width) // size),
            )
            sums = flat.blocks.cut(rows, columns)
    f1, f2, f3, f4, u, v = sums.planes.reshape(6, -1)
    monomials = np.empty((6, f1.size))
    monomials[0] = 1
    _, x, y, xx, xy, yy = monomials
    np.multiply(u - (left + patch.outline.u), 1 / sigma_px, out=x)
    np.multiply(v - (top + patch.outline.v), 1 / sigma_px, out=y)
    np.multiply(x, x, out=xx)
    np.multiply(x, y, out=xy)
    np.multiply(y, y, out=yy)
    return _Data(
        light=np.ravel(block_sum(light, size)),
        monomials=monomials,
        f1=f1,
        f2=f2,
        read_variance=noise.read_counts**2 * np.maximum(f2, 1e-9),
        shot_variance=f3 / noise.electrons_per_count,
        grain_variance=f4,
    )


@lru_cache(maxsize=64)
def _plain_sums(height: int, width: int, size: int) -> BlockSums:
    """Those of a plain target, which depend on a patch's size alone."""
    return block_sums(np.ones((height, width), np.float32), 0, 0, size)


def _solve(data: _Data, state: _State) -> tuple[_State, float, float, float] | None:
    """Gauss-Newton; the state, the grain squared, and what noise and grain do to the centre, mean squares.

    Some three hundred blocks are so few that numpy's calls cost more than its sums: what belongs together
    is one array, and one product gives the normal equations with their right-hand side.
    """
    grain2 = grain2_before = _GRAIN_AT_FIRST**2
    rows = np.empty((9, data.light.size))
    rows[_REST] = data.f1
    bright = np.empty(data.light.size)
    for iteration in range(_ITERATIONS):
        spot = _linearise(data, state, rows)
        settled = iteration >= _ORDER_FREE_FROM
        noise_variance = data.read_variance + spot * data.shot_variance
        grain_variance = spot * spot
        grain_variance *= data.grain_variance
        if settled:
            residual = rows[_RESIDUAL]
            np.greater(spot, _GRAIN_SEEN_FROM * state[_PEAK], out=bright)  # 0 or 1
            unexplained = float((residual * bright) @ residual - noise_variance @ bright)
            per_grain2 = float(grain_variance @ bright)
            grain2_before = grain2
            grain2 = min(max(unexplained / per_grain2, _GRAINS[0] ** 2), _GRAINS[1] ** 2)
        weighted = rows[:_RESIDUAL] / (noise_variance + grain2 * grain_variance)
        equations = weighted @ rows.T
        prior = (_ORDER_PRIOR_SIGMA if settled else _ORDER_HELD_SIGMA) ** -2
        equations[_ORDER, _ORDER] += prior
        equations[_ORDER, _RESIDUAL] += prior * (1.0 - state[_ORDER])
        try:
            covariance = np.linalg.inv(equations[:, :_RESIDUAL])
        except np.linalg.LinAlgError:
            return None
        step = (covariance @ equations[:, _RESIDUAL]).tolist()
        moved = _moved(state, step)
        if moved is None:
            return None
        state = moved
        if (
            settled
            and abs(grain2 - grain2_before) < _CONVERGED_GRAIN2 * grain2
            and math.hypot(step[_U], step[_V]) < _CONVERGED_SIGMAS
            and max(abs(step[_A]), abs(step[_C]), abs(step[_ORDER])) < _CONVERGED_SHAPE
        ):
            levers = covariance[_U : _V + 1] @ weighted
            squares = np.square(levers).sum(axis=0) / 2
            return state, grain2, float(squares @ noise_variance), grain2 * float(squares @ grain_variance)
    return None


def _linearise(data: _Data, state: _State, rows: FloatArray) -> FloatArray:
    """Irradiance at the blocks; fills in the derivatives of the blocks' light and what is left over of it."""
    peak, u, v, a, b, c, rest, order = state
    pull_u, pull_v = a * u + b * v, b * u + c * v
    quadratics = np.array(
        (
            ((u * pull_u + v * pull_v) / 2, -pull_u, -pull_v, a / 2, b, c / 2),  # q
            (-pull_u, a, b, 0.0, 0.0, 0.0),  # −∂q/∂u
            (-pull_v, b, c, 0.0, 0.0, 0.0),  # −∂q/∂v
            (-u * u / 2, u, 0.0, -0.5, 0.0, 0.0),  # −∂q/∂a
            (-u * v, v, u, 0.0, -1.0, 0.0),  # −∂q/∂b
            (-v * v / 2, 0.0, v, 0.0, 0.0, -0.5),  # −∂q/∂c
        )
    )
    polynomials = quadratics @ data.monomials
    q = polynomials[0]
    np.maximum(q, 1e-9, out=q)
    logarithm = np.log(q)
    raised = np.exp(order * logarithm)
    shape: FloatArray = np.exp(-raised)
    np.multiply(shape, data.f2, out=rows[_PEAK])
    fall = rows[_PEAK] * raised
    fall *= peak
    np.multiply(fall, logarithm, out=rows[_ORDER])
    np.negative(rows[_ORDER], out=rows[_ORDER])
    fall /= q
    fall *= order
    np.multiply(polynomials[1:], fall, out=rows[_U : _C + 1])
    np.subtract(data.light, peak * rows[_PEAK], out=rows[_RESIDUAL])
    rows[_RESIDUAL] -= rest * data.f1
    shape *= peak
    return shape


def _moved(state: _State, step: Sequence[float]) -> _State | None:
    """A step, shortened until the form stays an ellipse and nothing leaps; None when it cannot be."""
    longest = max(abs(step[_U]), abs(step[_V]), abs(step[_A] / state[_A]), abs(step[_C] / state[_C]))
    if not math.isfinite(longest):
        return None
    scale = min(1.0, _LONGEST_STEP / max(longest, 1e-12))
    while scale > 1e-3:
        peak, u, v, a, b, c, rest, order = (s + scale * d for s, d in zip(state, step, strict=True))
        if peak > 0 and a > 0 and c > 0 and a * c > b * b:
            return peak, u, v, a, b, c, rest, min(max(order, _ORDERS[0]), _ORDERS[1])
        scale /= 2
    return None
