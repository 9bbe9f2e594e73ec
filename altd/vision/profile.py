"""Fine localisation: a super-Gaussian fitted through the flat, with the weights that its noise deserves."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from altd.records import FloatArray
from altd.vision.centre import Centre, Noise
from altd.vision.flat import BLOCK_PX, BlockSums, Flat, Image, block_sum, block_sums
from altd.vision.patch import Patch

_ITERATIONS = 16
_CONVERGED_SIGMAS = 3e-4
_CONVERGED_SHAPE = 0.02
_LONGEST_STEP = 0.5
_FINE_BELOW_PX = 24.0
"""Spots below this 1/e² diameter are fitted pixel by pixel: a block would be too coarse."""

_ORDER_FREE_FROM = 2
_ORDERS = 0.6, 6.0
_ORDER_PRIOR_SIGMA = 0.5
_GRAIN_AT_FIRST = 0.2
_GRAINS = 0.003, 1.0
_GRAIN_SEEN_FROM = 0.1
_FARTHEST_DIAMETERS = 0.25

_PEAK, _U, _V, _A, _B, _C, _REST, _ORDER = range(8)


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

    ``x`` and ``y`` are px as they come, then from the seed in units of its sigma.
    """

    light: FloatArray
    x: FloatArray
    y: FloatArray
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
    from_u, from_v, sigma_px = _seed(patch, diameter_px)
    data = _data(patch, flat, clipped, noise, BLOCK_PX if diameter_px >= _FINE_BELOW_PX else 1)
    data = replace(data, x=(data.x - from_u) / sigma_px, y=(data.y - from_v) / sigma_px)
    solution = _solve(data, patch.peak)
    if solution is None:
        return None
    state, centre_variance = solution
    peak, u, v, a, b, c, rest, order = state.tolist()
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
    patch: Patch, flat: Flat | None, clipped: npt.NDArray[np.bool_] | None, noise: Noise, size: int
) -> _Data:
    light, sums = _sums(patch, flat, clipped, size)
    f1, f2, f3, f4, u, v = (
        np.ravel(array).astype(np.float64)
        for array in (sums.f1, sums.f2, sums.f3, sums.f4, sums.u_px, sums.v_px)
    )
    return _Data(
        light=np.ravel(light).astype(np.float64),
        x=u,
        y=v,
        f1=f1,
        f2=f2,
        read_variance=noise.read_counts**2 * np.maximum(f2, 1e-9),
        shot_variance=f3 / noise.electrons_per_count,
        grain_variance=f4,
    )


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


def _solve(data: _Data, peak: float) -> tuple[FloatArray, float] | None:
    """Gauss-Newton; the state and what read and shot noise do to the centre, the mean square of both axes."""
    state = np.array([peak, 0.0, 0.0, 1.0, 0.0, 1.0, 0.0, 1.0])
    grain2 = _GRAIN_AT_FIRST**2
    jacobian = np.empty((8, len(data.light)))
    for iteration in range(_ITERATIONS):
        spot, residual = _linearise(data, state, jacobian)
        free = 8 if iteration >= _ORDER_FREE_FROM else 7
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
        if free == 8:
            normal[_ORDER, _ORDER] += _ORDER_PRIOR_SIGMA**-2
            pull[_ORDER] += (1.0 - state[_ORDER]) / _ORDER_PRIOR_SIGMA**2
        try:
            step: FloatArray = np.asarray(np.linalg.solve(normal, pull), dtype=np.float64)
        except np.linalg.LinAlgError:
            return None
        moved = _moved(state, step)
        if moved is None:
            return None
        state = moved
        if (
            free == 8
            and math.hypot(step[_U], step[_V]) < _CONVERGED_SIGMAS
            and max(abs(step[_A]), abs(step[_C]), abs(step[_ORDER])) < _CONVERGED_SHAPE
        ):
            levers = np.linalg.inv(normal)[[_U, _V]] @ weighted
            return state, float(np.square(levers).mean(axis=0) @ noise_variance)
    return None


def _linearise(data: _Data, state: FloatArray, jacobian: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Irradiance at the blocks and what is left over; fills in the derivatives of the blocks' light."""
    peak, u, v, a, b, c, rest, order = state.tolist()
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
    fall = spot * data.f2 * raised
    fall *= order
    slope = fall / q
    np.multiply(shape, data.f2, out=jacobian[_PEAK])
    np.multiply(slope, along, out=jacobian[_U])
    np.multiply(slope, across, out=jacobian[_V])
    slope *= -0.5
    slope_x, slope_y = slope * dx, slope * dy
    np.multiply(slope_x, dx, out=jacobian[_A])
    np.multiply(slope_x, 2 * dy, out=jacobian[_B])
    np.multiply(slope_y, dy, out=jacobian[_C])
    jacobian[_REST] = data.f1
    fall *= logarithm
    np.multiply(fall, -1 / order, out=jacobian[_ORDER])
    residual = data.light - peak * jacobian[_PEAK] - rest * data.f1
    return spot, residual


def _moved(state: FloatArray, step: FloatArray) -> FloatArray | None:
    """A step, shortened until the form stays an ellipse and nothing leaps; None when it cannot be."""
    longest = float(np.abs(step[[_U, _V, _A, _C]] / np.array([1.0, 1.0, state[_A], state[_C]])).max())
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
