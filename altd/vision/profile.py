"""Fine localisation: by the first moment, or by a super-Gaussian fitted through the flat field."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from altd.records import FloatArray, SpotShape
from altd.statistics import mad_sigma
from altd.vision.blocks import blocks_of
from altd.vision.fit import RESIDUAL, FitState, solve
from altd.vision.flat import BLOCK_PX, Flat
from altd.vision.frame_analysis import Patch
from altd.vision.image import Centre, Image, Noise
from altd.vision.misfit import FitResiduals
from altd.vision.settings import SpotSettings

_NOISE_BLOCK_PX = 4


def moment(patch: Patch, noise: Noise, settings: SpotSettings) -> Centre:
    """Return the centre by Eq. 2.7 of the thesis with (I − T)₊ for I; its sigma is by read and shot noise."""
    above_threshold = np.maximum(patch.smooth - np.float32(settings.threshold * patch.peak), np.float32(0))
    above_threshold[patch.mask == 0] = 0
    weight = np.zeros_like(above_threshold)
    is_above = above_threshold > 0  # cv2.pow is slowest for zeros
    weight[is_above] = np.asarray(cv2.pow(above_threshold[is_above], settings.power)).ravel()
    columns = cv2.reduce(weight, 0, cv2.REDUCE_SUM, dtype=cv2.CV_64F).ravel()
    rows = cv2.reduce(weight, 1, cv2.REDUCE_SUM, dtype=cv2.CV_64F).ravel()
    total = float(columns.sum())
    u = float(columns @ np.arange(len(columns))) / total
    v = float(rows @ np.arange(len(rows))) / total
    sigma_px = _sigma_px(patch, above_threshold, weight / np.float32(total), (u, v), noise, settings)
    return Centre(patch.left + u, patch.top + v, sigma_px)


def _sigma_px(
    patch: Patch,
    above_threshold: Image,
    weight: Image,
    centre: tuple[float, float],
    noise: Noise,
    settings: SpotSettings,
) -> float:
    """Propagate read noise r and shot noise I/K through smoothing, threshold and moment.

    du = Σ h dI with h = Gauss ⊛ [(u − ū) p (S − T)₊^(p−1) / Σ w]; var u = Σ h² (r² + I/K). The sum is over
    blocks of 4 px, on which h and I hardly change. Returns the root mean square of both axes.
    """
    # The derivative of the power diverges at the contour; it is limited within the smoothed noise of it.
    floor = noise.read_counts / max(1.0, 2 * math.sqrt(math.pi) * settings.smoothing_px)
    slope = np.where(
        above_threshold > floor,
        weight,
        weight.max() * np.float32((floor / above_threshold.max()) ** settings.power),
    )
    slope *= settings.power
    slope /= np.maximum(above_threshold, np.float32(floor))
    slope[above_threshold == 0] = 0
    height, width = slope.shape
    sensitivity_u = slope * (np.arange(width, dtype=np.float32) - np.float32(centre[0]))
    sensitivity_v = slope * (np.arange(height, dtype=np.float32) - np.float32(centre[1]))[:, None]
    size = max(width // _NOISE_BLOCK_PX, 1), max(height // _NOISE_BLOCK_PX, 1)
    stacked = cv2.merge([sensitivity_u, sensitivity_v, np.maximum(patch.smooth, 0)])
    blocks = cv2.resize(stacked, size, interpolation=cv2.INTER_AREA)
    sensitivities = blocks[:, :, :2]
    if settings.smoothing_px > 0:
        sensitivities = cv2.GaussianBlur(sensitivities, (0, 0), settings.smoothing_px / _NOISE_BLOCK_PX)
    variance = noise.read_counts**2 + blocks[:, :, 2] / np.float32(noise.electrons_per_count)
    pixels_per_block = width * height / (size[0] * size[1])
    per_axis = (np.square(sensitivities) * variance[:, :, None]).sum(axis=(0, 1)) * pixels_per_block
    return math.sqrt(float(per_axis.mean()))


_MIN_BLOCK_DIAMETER_PX = 24.0
"""Minimum 1/e² diameter for blocks; smaller spots are fitted pixel by pixel, as blocks are too coarse."""

_MIN_SPECK_SIGMAS = 4.5
"""Minimum residual of a speck; among 200 blocks of ordinary texture, one in 700 spots has one so far off."""
_MIN_SPECK_PEAK_SHARE = 0.05
_MAX_SPECK_SHARE = 0.12
"""Maximum share of specks; with more the spot has another profile, which the misfit must show."""
_MAX_OFFSET_DIAMETERS = 0.25
_MAX_OFFSET_DIAMETERS_CUT = 1.0
"""Limit for a spot cut by the image's edge, whose visible part is off its centre."""

_SLOPE_SHARE_PER_PX = 2e-5
"""Prior standard deviation of the local background slope, as a share of the background. A wider prior costs
precision: on speckle a slope is correlated with a shift of the centre (1.5e-4: a tenth more scatter)."""
_MIN_SLOPE_COUNTS_PER_PX = 2e-5
_RISE_PER_UNEVEN = 0.35
"""Slope over a quarter of the diameter, per rms of a background that varies over a diameter: √2 / 4."""


@dataclass(frozen=True, slots=True, eq=False)
class Profile:
    """Spot E = peak · exp(−q^order), q = ½ (a du² + 2 b du dv + c dv²); order 1 is a Gaussian.

    ``form`` holds a, b, c in 1/px², ``background_offset`` is the error of the estimated background in counts,
    ``residuals`` the part that the spot does not explain.
    """

    centre: Centre
    peak: float
    form: tuple[float, float, float]
    order: float
    background_offset: float
    residuals: FitResiduals

    @property
    def shape(self) -> SpotShape:
        """The spot's own shape; its ``form`` is as wide as on its blocks.

        What widens a profile adds to its variance, which is Γ(2/order) / Γ(1/order) times the inverse of its
        form.
        """
        a, b, c = self.form
        added = self.residuals.blocks.widening_px2 * math.gamma(1 / self.order) / math.gamma(2 / self.order)
        # of a symmetric matrix: (M⁻¹ − w)⁻¹ = (M − w det M) / (1 − w trace M + w² det M)
        det = a * c - b * b
        rest = 1 - added * (a + c) + added**2 * det
        if rest <= 0:  # narrower than a block
            return SpotShape(a, b, c, self.order)
        return SpotShape((a - added * det) / rest, b / rest, (c - added * det) / rest, self.order)

    @property
    def diameter_px(self) -> float:
        """1/e² diameter of the circle with the spot's area at that height."""
        a, b, c = self.form
        return 2 * math.sqrt(2 * 2 ** (1 / self.order) / math.sqrt(a * c - b * b))

    @property
    def light(self) -> float:
        """Integral of the profile, peak · 2π Γ(1 + 1/order) / √(ac − b²), counts · px²."""
        a, b, c = self.form
        return self.peak * 2 * math.pi * math.gamma(1 + 1 / self.order) / math.sqrt(a * c - b * b)

    def irradiance(self, u_px: FloatArray, v_px: FloatArray) -> FloatArray:
        """Return E in counts at columns ``u_px`` (w,) and rows ``v_px`` (h,), as (h, w)."""
        a, b, c = self.form
        du, dv = u_px - self.centre.u_px, (v_px - self.centre.v_px)[:, None]
        q = np.maximum(0.5 * (a * du * du + 2 * b * du * dv + c * dv * dv), 0.0)
        counts: FloatArray = self.peak * np.exp(-(q**self.order))
        return counts


def fit_profile(
    patch: Patch,
    flat: Flat | None,
    diameter_px: float,
    noise: Noise,
    clipped: npt.NDArray[np.bool_] | None = None,
) -> Profile | None:
    """Fit the spot of a patch, weighted by the inverse variance; None if no profile fits it.

    ``diameter_px`` is an estimate of the spot's; pixels in the mask ``clipped`` of the patch are excluded.
    Weighted least squares over blocks of ΣF·I for peak, centre, form, order, and the error of the background:
    a constant, and a slope that is small against it. The variance of a block is read noise, shot noise and
    surface texture: the relative scatter of the light (speckle, residual print), which the fit estimates from
    its own residuals. On blocks of one dot pitch the centre is as precise as on pixels. A few outlier blocks
    are excluded, as made by a speck of dust.
    """
    outline = patch.outline
    sigma_px = diameter_px / 4
    data = blocks_of(
        patch, flat, clipped, noise, sigma_px, BLOCK_PX if diameter_px >= _MIN_BLOCK_DIAMETER_PX else 1
    )
    rise = max(_SLOPE_SHARE_PER_PX * patch.background_counts, _MIN_SLOPE_COUNTS_PER_PX) * sigma_px
    rise += _RISE_PER_UNEVEN * patch.uneven_counts
    # second moments of a uniform ellipse: those of the spot except for a factor
    scale = 1 / math.sqrt(max(outline.uu * outline.vv - outline.uv**2, 1e-12))
    form = scale * outline.vv, -scale * outline.uv, scale * outline.uu
    solution = solve(data, (patch.peak, 0.0, 0.0, *form, 0.0, 0.0, 0.0, 1.0), rise)
    if solution is None:
        return None
    clean = _clean_blocks(solution)
    if clean is not None:
        data = data.only(clean)
        refined = solve(data, solution.state, rise, order_free_iteration=0)
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
        FitResiduals(data, solution, rise, sigma_px),
    )


def _clean_blocks(solution: FitState) -> npt.NDArray[np.bool_] | None:
    """Return the mask (n,) of blocks without dust; None if dust hides no block or too many."""
    sigmas = np.abs(solution.rows[RESIDUAL]) / np.sqrt(solution.variance(solution.contrast2))
    lit: npt.NDArray[np.bool_] = solution.peak_shares > _MIN_SPECK_PEAK_SHARE
    lit_sigma = mad_sigma(sigmas[lit]) if lit.any() else 0.0
    specks = lit & (sigmas > _MIN_SPECK_SIGMAS * lit_sigma)
    if not 0 < np.count_nonzero(specks) <= _MAX_SPECK_SHARE * np.count_nonzero(lit):
        return None
    clean: npt.NDArray[np.bool_] = ~specks
    return clean
