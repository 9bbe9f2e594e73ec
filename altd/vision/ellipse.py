"""Second localiser: an ellipse through the contour of the smoothed spot (thesis 2.1.2, Eq. 2.2-2.6).

It shares only the patch with the profile: it uses the position of one contour instead of the values of all
pixels. If a spot is not as the profile assumes (a comet, a reflection beside it, a finger print on the
window), the two centres differ. It is an independent check and not part of the measuring chain.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from altd.records import FloatArray
from altd.vision.flat import Flat
from altd.vision.frame_analysis import Patch
from altd.vision.image import Centre, Image, Mask, Noise, gaussian_blur
from altd.vision.settings import SpotSettings


@dataclass(frozen=True, slots=True, eq=False)
class Conic:
    """Centre (x, y) of an ellipse, in the unit of its points, and its sensitivity to each point.

    ``sensitivities`` (2, n): increase of x and y when a point moves outwards, along the ellipse's normal, by
    one; to first order in the points' distances from the ellipse.
    """

    x: float
    y: float
    sensitivities: FloatArray


def fit_conic(x: FloatArray, y: FloatArray) -> Conic | None:
    """Fit an ellipse to points (n,) that are mean-free and of a size about 1; None if there is none.

    Least squares of the algebraic distances e = D z (Eq. 2.3-2.6). The constant and the linear terms are
    eliminated by orthogonal residualisation of D2 against (D1, D0); under the constraint C1, b² − 4ac = −1,
    z2 is then an eigenvector of a 3 × 3 matrix, the one that is an ellipse. (D2's columns are x², xy, y², in
    the order of Eq. 2.2; Eq. 2.4 and 2.6 use two different orders.) C1 makes the ellipse of noisy points too
    small, which does not affect its centre if they surround it. On a spot whose contours are similar
    ellipses, the algebraic distance of a point is proportional to the error of its irradiance, so that the
    distances deserve equal weights.
    """
    squares = np.stack([x * x, x * y, y * y], axis=1)
    rest = np.stack([x, y, np.ones_like(x)], axis=1)
    try:
        coefficients = _coefficients(squares, rest)
        return None if coefficients is None else _centre(coefficients, np.column_stack([squares, rest]))
    except np.linalg.LinAlgError:
        return None


def _coefficients(squares: FloatArray, rest: FloatArray) -> FloatArray | None:
    """Return the conic's a … f, a positive, from the columns (n, 3) of D2 and of (D1, D0)."""
    eliminated = np.linalg.solve(rest.T @ rest, rest.T @ squares)
    residual = squares - rest @ eliminated
    scatter = residual.T @ residual
    # C1 is z2ᵀ C z2 = 1 with C = [[0, 0, 2], [0, -1, 0], [2, 0, 0]]
    _, vectors = np.linalg.eig(np.stack([scatter[2] / 2, -scatter[1], scatter[0] / 2]))
    vectors = np.real(vectors)
    discriminants = 4 * vectors[0] * vectors[2] - vectors[1] ** 2
    if discriminants.max() <= 0:
        return None
    quadratic = vectors[:, int(discriminants.argmax())]
    if quadratic[0] < 0:
        quadratic = -quadratic
    return np.concatenate([quadratic, -eliminated @ quadratic])


def _centre(coefficients: FloatArray, design: FloatArray) -> Conic:
    """Return the conic's point of zero gradient, and its derivatives by the points of a design (n, 6)."""
    a, b, c, d, e, _ = coefficients
    x, y = design[:, 3], design[:, 4]
    hessian = np.array([[2 * a, b], [b, 2 * c]])
    u, v = -np.linalg.solve(hessian, (d, e))
    of_coefficients = -np.linalg.solve(hessian, [[2 * u, v, 0, 1, 0, 0], [0, u, 2 * v, 0, 1, 0]])
    # the scale of the coefficients does not affect the centre and is held fixed
    scale_only = np.outer(coefficients, coefficients) / (coefficients @ coefficients)
    keep = np.eye(6) - scale_only
    inverse = np.linalg.inv(keep @ design.T @ design @ keep + len(x) * scale_only)
    slope = np.hypot(2 * a * x + b * y + d, b * x + 2 * c * y + e)
    sensitivities: FloatArray = -(of_coefficients @ inverse @ design.T) * slope
    return Conic(float(u), float(v), sensitivities)


CONTOUR_LEVEL = 0.5
"""Level of the contour as a share of the smoothed spot's peak. The contour of a Gaussian carries most
information on its centre at 47 % of the peak (r² = 1.5 sigma²) under read noise, and at 22 % under shot
noise. Half the peak is near the first, costs a sixth of sigma for the second, and is far from clipped pixels
as well as from residual background."""

_MIN_POINTS = 16
_MIN_RESPONSE2 = 0.01
"""Limit of the smoothed F² below which the light is unknown; F has the mean 1."""


@dataclass(frozen=True, slots=True, eq=False)
class _Contour:
    """The n crossings of the level between two neighbouring pixels of an irradiance image.

    ``inside`` and ``outside`` are the flat indices of the two, ``fraction`` (0 … 1) is the position of the
    level from the one inside to the one outside; ``x`` and ``y`` are px from the image's first pixel.
    """

    inside: np.ndarray[tuple[int], np.dtype[np.intp]]
    outside: np.ndarray[tuple[int], np.dtype[np.intp]]
    fraction: FloatArray
    x: FloatArray
    y: FloatArray

    def interpolated(self, image: Image) -> FloatArray:
        """Return an image (rows, columns) at the crossings, (n,), interpolated linearly like the contour."""
        values = image.ravel()
        between: FloatArray = (1 - self.fraction) * values[self.inside] + self.fraction * values[self.outside]
        return between

    def adjoint(self, values: FloatArray, shape: tuple[int, int]) -> Image:
        """Apply the transpose of ``interpolated``: spread values (n,) onto the pixels they were read from."""
        image = np.bincount(self.inside, values * (1 - self.fraction), shape[0] * shape[1])
        image += np.bincount(self.outside, values * self.fraction, shape[0] * shape[1])
        return image.reshape(shape).astype(np.float32)


def ellipse(patch: Patch, noise: Noise, settings: SpotSettings, flat: Flat | None = None) -> Centre | None:
    """Return the centre of the ellipse through the contour at CONTOUR_LEVEL; None without such a contour.

    With a ``flat`` F the contour is that of the normalised image G ⊛ (F·I) / G ⊛ F², G the smoothing. Read
    and shot noise are propagated through smoothing, contour and fit to first order; the noise of the peak, on
    which the level depends, moves the contour outwards, not sideways.
    """
    response, response2, irradiance = _irradiance(patch, settings, flat)
    peak = float(irradiance[patch.mask > 0].max())
    contour = _contour(irradiance, CONTOUR_LEVEL * peak, patch.mask) if peak > 0 else None
    if contour is None:
        return None
    # the normalised image measures at G ⊛ F²·u over G ⊛ F²: off the middle of G, where F is brighter
    off_y, off_x = (settings.smoothing_px**2 * slope for slope in _gradient(np.log(response2)))
    x, y = contour.x + contour.interpolated(off_x), contour.y + contour.interpolated(off_y)
    middle_x, middle_y = float(x.mean()), float(y.mean())
    scale = math.sqrt(float(np.mean((x - middle_x) ** 2 + (y - middle_y) ** 2)))
    fitted = fit_conic((x - middle_x) / scale, (y - middle_y) / scale)
    if fitted is None:
        return None
    by_y, by_x = _gradient(irradiance)
    # a rise of the irradiance displaces the contour outwards by one over the slope
    sensitivities = fitted.sensitivities / np.maximum(
        np.hypot(contour.interpolated(by_x), contour.interpolated(by_y)), 1e-6 * peak
    )
    variance = noise.read_counts**2 + np.maximum(irradiance, 0) * response / noise.electrons_per_count
    squares = 0.0
    for sensitivity in sensitivities:
        by_pixel = response * gaussian_blur(
            contour.adjoint(sensitivity, irradiance.shape) / response2, settings.smoothing_px
        )
        squares += float((np.square(by_pixel, dtype=np.float64) * variance).sum())
    return Centre(
        patch.left + middle_x + scale * fitted.x,
        patch.top + middle_y + scale * fitted.y,
        math.sqrt(squares / 2),
    )


def _irradiance(patch: Patch, settings: SpotSettings, flat: Flat | None) -> tuple[Image, Image, Image]:
    """Return F, the smoothed F² and the smoothed irradiance in a patch; the last is 0 where F is too dark."""
    if flat is None:
        ones = np.ones_like(patch.smooth)
        return ones, ones, patch.smooth
    height, width = patch.smooth.shape
    response = flat.response[patch.top : patch.top + height, patch.left : patch.left + width]
    response2 = gaussian_blur(response * response, settings.smoothing_px)
    dark = response2 < _MIN_RESPONSE2
    response2[dark] = _MIN_RESPONSE2
    irradiance = gaussian_blur(patch.excess * response, settings.smoothing_px) / response2
    irradiance[dark] = 0
    return response, response2, irradiance


def _gradient(image: Image) -> tuple[Image, Image]:
    """Return the derivatives along v and u, per px."""
    by_v, by_u = np.gradient(image)
    return np.asarray(by_v, dtype=np.float32), np.asarray(by_u, dtype=np.float32)


def _contour(irradiance: Image, level: float, mask: Mask) -> _Contour | None:
    """Return the outer contour of the largest piece above a level, interpolated along rows and columns."""
    above = ((irradiance > level) & (mask > 0)).astype(np.uint8)
    outlines, _ = cv2.findContours(above, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    largest = max(outlines, key=cv2.contourArea)
    piece = cv2.drawContours(np.zeros_like(above), [largest], -1, 1, cv2.FILLED) > 0
    if piece[0].any() or piece[-1].any() or piece[:, 0].any() or piece[:, -1].any():
        return None
    pixel = np.arange(irradiance.size).reshape(irradiance.shape)
    pairs = []
    for here, there in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1, :], np.s_[1:, :])):
        leaving, entering = piece[here] & ~piece[there], ~piece[here] & piece[there]
        pairs.append((pixel[here][leaving], pixel[there][leaving]))
        pairs.append((pixel[there][entering], pixel[here][entering]))
    inside, outside = (np.concatenate(ends) for ends in zip(*pairs, strict=True))
    values = irradiance.ravel().astype(np.float64)
    # an outer neighbour is not above the level unless the spot's mask ends there
    usable = (values[outside] <= level) & (values[inside] > level)
    inside, outside = inside[usable], outside[usable]
    if len(inside) < _MIN_POINTS:
        return None
    fraction = (values[inside] - level) / (values[inside] - values[outside])
    width = irradiance.shape[1]
    return _Contour(
        inside,
        outside,
        fraction,
        x=(1 - fraction) * (inside % width) + fraction * (outside % width),
        y=(1 - fraction) * (inside // width) + fraction * (outside // width),
    )
