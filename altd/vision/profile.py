"""Fine localisation: a super-Gaussian fitted through the flat, with the weights that its noise deserves."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from altd.records import FloatArray
from altd.vision.centre import Centre, Noise
from altd.vision.flat import BLOCK_PX, BlockSums, Flat, Image, block_sum, block_sums
from altd.vision.patch import Patch

_ITERATIONS = 16
_CONVERGED_SIGMAS = 3e-4
_CONVERGED_SHAPE = 0.02
_LATE = 11
_CONVERGED_LATE_SIGMAS = 3e-3
_LONGEST_STEP = 0.5
_FINE_BELOW_PX = 24.0
"""Spots below this 1/e² diameter are fitted pixel by pixel: a block would be too coarse."""

_ORDER_FREE_FROM = 2
_ORDERS = 0.6, 8.0
_ORDER_PRIOR_SIGMA = 0.5
_GRAIN_AT_FIRST = 0.2
_GRAINS = 0.003, 1.0
_GRAIN_SEEN_FROM = 0.1
_FARTHEST_DIAMETERS = 0.25

_SLOPE_SHARE_PER_PX = 1.5e-4
"""By how much of itself the background may rise or fall over a pixel beside what the whole frame shows of it:
fall-off and stray light are no parabola."""
_LEAST_SLOPE_COUNTS_PER_PX = 1e-4

_PEAK, _U, _V, _A, _B, _C, _REST, _RISE_X, _RISE_Y, _ORDER = range(10)


@dataclass(frozen=True, slots=True)
class Profile:
    """A spot E = peak · exp(−q^order), q = ½ (a du² + 2 b du dv + c dv²); order 1 is a Gaussian.

    ``form`` holds a, b, c in 1/px², ``rest`` the counts by which the background was off.
    """

    centre: Centre
    peak: float
    form: tuple[float, float, float]
    order: float
    rest: float

    def irradiance(self, u_px: FloatArray, v_px: FloatArray) -> FloatArray:
        """E in counts at columns ``u_px`` (w,) and rows ``v_px`` (h,), as (h, w)."""
        a, b, c = self.form
        du, dv = u_px - self.centre.u_px, (v_px - self.centre.v_px)[:, None]
        q = np.maximum(0.5 * (a * du * du + 2 * b * du * dv + c * dv * dv), 0.0)
        counts: FloatArray = self.peak * np.exp(-(q**self.order))
        return counts


@dataclass(frozen=True, slots=True, eq=False)
class _Data:
    """Blocks as vectors: Σ F·I, the sums of F and F², where they measure, and the variances of Σ F·I.

    Places are from the seed in units of its sigma, ``bends`` the moments xx, xy, yy about them; None where
    they are alike in all blocks and only widen the spot.
    """

    light: FloatArray
    x: FloatArray
    y: FloatArray
    bends: tuple[FloatArray, FloatArray, FloatArray] | None
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
    Weighted least squares over blocks of ΣF·I for peak, centre, form, order, and what is left of the
    background: a constant, and a slope that is small against it. The variance of a block is read noise, shot
    noise and grain: the relative scatter of the light (speckle, rest of the print), which the fit estimates
    from its own residuals, so that a clean spot as well as a coarse one gets the weights that it deserves. On
    blocks of one dot pitch the centre is as good as on pixels.
    """
    seed = _seed(patch, diameter_px)
    from_u, from_v, sigma_px = seed
    data = _data(patch, flat, clipped, noise, seed, BLOCK_PX if diameter_px >= _FINE_BELOW_PX else 1)
    rise = max(_SLOPE_SHARE_PER_PX * patch.background_counts, _LEAST_SLOPE_COUNTS_PER_PX) * sigma_px
    solution = _solve(data, patch.peak, rise)
    if solution is None:
        return None
    state, centre_variance = solution
    peak, u, v, a, b, c, rest, _, _, order = state.tolist()
    if math.hypot(u, v) * sigma_px > _FARTHEST_DIAMETERS * diameter_px:
        return None
    return Profile(
        Centre(from_u + u * sigma_px, from_v + v * sigma_px, sigma_px * math.sqrt(centre_variance)),
        peak,
        (a / sigma_px**2, b / sigma_px**2, c / sigma_px**2),
        order,
        rest,
    )


def _seed(patch: Patch, diameter_px: float) -> tuple[float, float, float]:
    """Centre of the mask and a standard deviation, px."""
    columns, rows = patch.mask.sum(axis=0), patch.mask.sum(axis=1)
    total = float(columns.sum())
    u = float(columns @ np.arange(len(columns))) / total
    v = float(rows @ np.arange(len(rows))) / total
    return patch.left + u, patch.top + v, diameter_px / 4


def _data(
    patch: Patch,
    flat: Flat | None,
    clipped: npt.NDArray[np.bool_] | None,
    noise: Noise,
    seed: tuple[float, float, float],
    size: int,
) -> _Data:
    light, sums = _sums(patch, flat, clipped, size)
    from_u, from_v, sigma_px = seed
    bends = None
    if flat is not None or clipped is not None:
        xx, xy, yy = (_vector(moment) / sigma_px**2 for moment in (sums.uu_px2, sums.uv_px2, sums.vv_px2))
        bends = xx, xy, yy
    f2 = _vector(sums.f2)
    return _Data(
        light=_vector(light),
        x=(_vector(sums.u_px) - from_u) / sigma_px,
        y=(_vector(sums.v_px) - from_v) / sigma_px,
        bends=bends,
        f1=_vector(sums.f1),
        f2=f2,
        read_variance=noise.read_counts**2 * np.maximum(f2, 1e-9),
        shot_variance=_vector(sums.f3) / noise.electrons_per_count,
        grain_variance=_vector(sums.f4),
    )


def _vector(image: Image) -> FloatArray:
    return np.ravel(image).astype(np.float64)


def _sums(
    patch: Patch, flat: Flat | None, clipped: npt.NDArray[np.bool_] | None, size: int
) -> tuple[Image, BlockSums]:
    """Σ F·I over the patch's blocks and the sums of F; from those that the flat keeps where they serve."""
    height, width = patch.excess.shape
    if flat is None:
        response = np.ones((height, width), np.float32)
    else:
        response = flat.response[patch.top : patch.top + height, patch.left : patch.left + width]
    if clipped is not None:
        response = np.where(clipped, np.float32(0), response)
    light = block_sum(patch.excess * response, size)
    if flat is None or clipped is not None or size != BLOCK_PX:
        return light, block_sums(response, patch.left, patch.top, size)
    top, left = patch.top // size, patch.left // size
    rows, columns = height // size, width // size
    return light, flat.blocks.cut(slice(top, top + rows), slice(left, left + columns))


def _solve(data: _Data, peak: float, rise: float) -> tuple[FloatArray, float] | None:
    """Gauss-Newton; the state and what read and shot noise do to the centre, the mean square of both axes.

    ``rise`` is the standard deviation of the background's slopes, counts per sigma of the seed.
    """
    state = np.array([peak, 0.0, 0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0])
    known = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    precision = np.array([0.0] * 7 + [rise**-2, rise**-2, _ORDER_PRIOR_SIGMA**-2])
    grain2 = _GRAIN_AT_FIRST**2
    jacobian = np.empty((len(state), len(data.light)))
    jacobian[_REST] = data.f1
    jacobian[_RISE_X] = data.f1 * data.x
    jacobian[_RISE_Y] = data.f1 * data.y
    for iteration in range(_ITERATIONS):
        spot, residual = _linearise(data, state, jacobian)
        free = len(state) if iteration >= _ORDER_FREE_FROM else _ORDER
        noise_variance = data.read_variance + spot * data.shot_variance
        grain_variance = spot * spot * data.grain_variance
        if iteration >= _ORDER_FREE_FROM:
            bright = spot > _GRAIN_SEEN_FROM * state[_PEAK]
            unexplained = float((residual * residual - noise_variance)[bright].sum())
            per_grain2 = float(grain_variance[bright].sum())
            if per_grain2 <= 0:
                return None  # no pixel that counts lies where the spot is
            grain2 = min(max(unexplained / per_grain2, _GRAINS[0] ** 2), _GRAINS[1] ** 2)
        weighted = jacobian[:free] / (noise_variance + grain2 * grain_variance)
        normal = weighted @ jacobian[:free].T
        pull = weighted @ residual
        normal.flat[:: free + 1] += precision[:free]
        pull += precision[:free] * (known - state)[:free]
        try:
            step: FloatArray = np.asarray(np.linalg.solve(normal, pull), dtype=np.float64)
        except np.linalg.LinAlgError:
            return None
        moved = _moved(state, step)
        if moved is None:
            return None
        change, state = np.abs(moved - state), moved
        if free > _ORDER and _is_settled(change, iteration >= _LATE):
            levers = np.linalg.inv(normal)[[_U, _V]] @ weighted
            return state, float(np.square(levers).mean(axis=0) @ noise_variance)
    return None


def _is_settled(change: FloatArray, late: bool) -> bool:
    """Whether the last step moved centre and shape by next to nothing; an order at its limit is at rest.

    A small spot with a hard edge may swing between shapes for ever: late on, a centre at rest is enough.
    """
    if late:
        return bool(max(change[_U], change[_V]) < _CONVERGED_LATE_SIGMAS)
    if max(change[_U], change[_V]) > _CONVERGED_SIGMAS:
        return False
    return bool(max(change[_A], change[_C], change[_ORDER]) < _CONVERGED_SHAPE)


def _linearise(data: _Data, state: FloatArray, jacobian: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Irradiance at the blocks and what is left over; fills in the derivatives of the blocks' light."""
    peak, u, v, a, b, c, rest, rise_x, rise_y, order = state.tolist()
    dx, dy = data.x - u, data.y - v
    along, across = a * dx + b * dy, b * dx + c * dy
    q = along * dx
    q += across * dy
    q *= 0.5
    np.maximum(q, 1e-9, out=q)
    logarithm = np.log(q)
    raised = q if order == 1.0 else np.exp(order * logarithm)
    shape = np.exp(-raised)
    spot = peak * shape
    steep = order * raised
    steep /= q
    f2 = data.f2
    if data.bends is not None:
        f2 = f2 * _bent(data.bends, steep, along, across, (a, b, c))
    slope = spot * f2
    slope *= steep
    np.multiply(shape, f2, out=jacobian[_PEAK])
    np.multiply(slope, along, out=jacobian[_U])
    np.multiply(slope, across, out=jacobian[_V])
    np.multiply(slope, q, out=jacobian[_ORDER])
    jacobian[_ORDER] *= logarithm
    jacobian[_ORDER] *= -1 / order
    slope *= -0.5
    slope_x, slope_y = slope * dx, slope * dy
    np.multiply(slope_x, dx, out=jacobian[_A])
    np.multiply(slope_x, 2 * dy, out=jacobian[_B])
    np.multiply(slope_y, dy, out=jacobian[_C])
    background = rest + rise_x * data.x + rise_y * data.y
    background *= data.f1
    residual = data.light - peak * jacobian[_PEAK]
    residual -= background
    return spot, residual


def _bent(
    bends: tuple[FloatArray, FloatArray, FloatArray],
    steep: FloatArray,
    along: FloatArray,
    across: FloatArray,
    form: tuple[float, float, float],
) -> FloatArray:
    """Mean of the spot over each block against its value where the block measures.

    1 + ½ (m_xx E_xx + 2 m_xy E_xy + m_yy E_yy) / E, with the derivatives that a Gaussian as steep as the spot
    is there has. Where the rows of dots run along those of pixels, the moments beat, and without this so does
    the centre: by 0.02 px.
    """
    xx, xy, yy = bends
    a, b, c = form
    along, across = steep * along, steep * across
    bent = xx * along * along
    bent += 2 * xy * along * across
    bent += yy * across * across
    bent -= steep * (a * xx + 2 * b * xy + c * yy)
    bent *= 0.5
    bent += 1.0
    return bent


def _moved(state: FloatArray, step: FloatArray) -> FloatArray | None:
    """A step, shortened until the form stays an ellipse and nothing leaps; None when it cannot be."""
    longest = max(abs(step[_U]), abs(step[_V]), abs(step[_A] / state[_A]), abs(step[_C] / state[_C]))
    if len(step) > _ORDER:
        longest = max(longest, abs(step[_ORDER] / state[_ORDER]))
    if not math.isfinite(longest):
        return None
    scale = min(1.0, _LONGEST_STEP / max(longest, 1e-12))
    while scale > 1e-3:
        moved = state.copy()
        moved[: len(step)] += scale * step
        a, b, c = moved[_A], moved[_B], moved[_C]
        if moved[_PEAK] > 0 and a > 0 and c > 0 and a * c > b * b:
            moved[_ORDER] = min(max(moved[_ORDER], _ORDERS[0]), _ORDERS[1])
            return moved
        scale /= 2
    return None
