"""Frame LEDs in a pair of frames, LEDs on and off; the laser spot may be present in both."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import cast

import cv2
import numpy as np

from altd.reasons import Reason
from altd.records import FaultCause, FloatArray, Frame, NoSpot, PixelArray, Spot
from altd.vision.frame_analysis import FrameAnalysis
from altd.vision.image import Image
from altd.vision.localise import spot_in
from altd.vision.search import Region, Search
from altd.vision.settings import SpotSettings

_MAX_ITERATIONS = 40
_CONVERGED_PX = 1e-4
_DIFFERENCE_STEP = 1e-3
_INITIAL_EDGE_PX, _MIN_EDGE_PX = 2.0, 1.0
_MAX_RELATIVE_RMS = 0.1
_INITIAL_DAMPING = 1e-3


@dataclass(frozen=True, slots=True)
class FittedDisc:
    """Centre and radius in px of the window, level in counts, and the centre's standard deviation an axis."""

    u_px: float
    v_px: float
    radius_px: float
    level: float
    sigma_px: float


def fit_disc(window: Image, initial_radius_px: float) -> FittedDisc | None:
    """Fit a disc with a soft edge to a window (h, w) of counts by least squares; None if it is no disc.

    Fitted are centre, radius, level, the background under it, and the width of its edge. It may extend beyond
    the window; its centre must be inside. The standard deviation is propagated from the residuals.
    """
    u, v = (places.astype(np.float64) for places in np.meshgrid(*map(np.arange, window.shape[::-1])))
    counts = window.astype(np.float64)
    floor, top = (float(np.percentile(counts, share)) for share in (5.0, 95.0))
    bright = counts > (floor + top) / 2
    if top <= floor or not bright.any():
        return None
    parameters = np.array(
        [u[bright].mean(), v[bright].mean(), initial_radius_px, top - floor, floor, _INITIAL_EDGE_PX]
    )
    residuals = _residuals(parameters, u, v, counts)
    damping = _INITIAL_DAMPING
    for _ in range(_MAX_ITERATIONS):
        jacobian = _jacobian(parameters, u, v, counts)
        normal = jacobian.T @ jacobian
        step = np.linalg.solve(normal + damping * np.diag(np.diag(normal) + 1e-12), -jacobian.T @ residuals)
        candidate = parameters + step
        candidate[5] = max(candidate[5], _MIN_EDGE_PX)
        new_residuals = _residuals(candidate, u, v, counts)
        if new_residuals @ new_residuals < residuals @ residuals:
            parameters, residuals, damping = candidate, new_residuals, damping / 10
            if np.abs(step[:3]).max() < _CONVERGED_PX:
                break
        else:
            damping *= 10
    centre_u, centre_v, radius, level = parameters[:4].tolist()
    rms = math.sqrt(float(residuals @ residuals) / max(len(residuals) - len(parameters), 1))
    inside = 0 <= centre_u < window.shape[1] and 0 <= centre_v < window.shape[0]
    if not inside or radius <= 0 or level <= 0 or rms > _MAX_RELATIVE_RMS * level:
        return None
    jacobian = _jacobian(parameters, u, v, counts)
    normal = jacobian.T @ jacobian
    covariance = rms**2 * np.linalg.pinv(normal)
    sigma_px = math.sqrt(float(covariance[0, 0] + covariance[1, 1]) / 2)
    return FittedDisc(centre_u, centre_v, radius, level, sigma_px)


def _residuals(parameters: FloatArray, u: FloatArray, v: FloatArray, counts: FloatArray) -> FloatArray:
    centre_u, centre_v, radius, level, floor, edge = parameters
    inside = np.clip(0.5 + (radius - np.hypot(u - centre_u, v - centre_v)) / edge, 0.0, 1.0)
    share = inside * inside * (3.0 - 2.0 * inside)  # a blurred edge has no corners
    residuals: FloatArray = (floor + level * share - counts).ravel()
    return residuals


def _jacobian(parameters: FloatArray, u: FloatArray, v: FloatArray, counts: FloatArray) -> FloatArray:
    """Return the derivatives (n, 6) of the residuals by the parameters, by central differences."""
    columns = []
    for index in range(len(parameters)):
        step = np.zeros(len(parameters))
        step[index] = _DIFFERENCE_STEP
        columns.append(
            (_residuals(parameters + step, u, v, counts) - _residuals(parameters - step, u, v, counts))
            / (2 * _DIFFERENCE_STEP)
        )
    return np.stack(columns, axis=1)


LED_SETTINGS = SpotSettings(
    method="moment", smoothing_px=1.5, threshold=0.3, power=1.0, min_diameter_px=5.0, max_aspect=2.0
)
"""A flat-headed LED is an evenly bright disc: little smoothing, contour at 0.3 of the peak, plain moment."""

_MARGIN_PX = 8
_PLACE_TOLERANCE_PX = 3
"""Tolerance of an LED's reference position; an LED beside it still differs from a laser spot."""
_INITIAL_RADIUS_PX = 9.0
_MAX_SIZE_RATIO = 1.4
"""Maximum ratio, either way, of the size of an LED at the border to that of the others."""


@dataclass(frozen=True, slots=True)
class LocatedLeds:
    """Located LEDs by increasing u, and texts on the lights that could not be located."""

    spots: tuple[Spot, ...]
    rejected: tuple[str, ...]


def count_lit_leds(found: Search, leds_px: FloatArray) -> int:
    """Return how many LEDs at ``leds_px``, (n, 2), are lit in one frame, each as a bright region of its own.

    Light that floods them all is one region.
    """
    return sum(
        any(
            region.left - _PLACE_TOLERANCE_PX <= u_px < region.right + _PLACE_TOLERANCE_PX
            and region.top - _PLACE_TOLERANCE_PX <= v_px < region.bottom + _PLACE_TOLERANCE_PX
            for u_px, v_px in leds_px
        )
        for region in found.regions
    )


def locate_leds(lit: Frame, dark: Frame) -> LocatedLeds:
    """Return the positions of the LEDs that are lit in ``lit`` and not in ``dark``.

    Light that is the same in both frames cancels. An LED at the border of the picture is fitted on its
    visible part.
    """
    difference = replace(lit, pixels=cast("PixelArray", cv2.subtract(lit.pixels, dark.pixels)))
    analysis = FrameAnalysis(difference, LED_SETTINGS)
    spots, rejected, at_border = [], [], []
    for region in analysis.found.regions:
        if _reaches_border(region, difference):
            at_border.append(region)
            continue
        spot = spot_in(analysis, region)
        if isinstance(spot, Spot):
            spots.append(spot)
        else:
            rejected.append(_rejection_text(region, spot))
    radii_px = [spot.diameter_px / 2 for spot in spots]
    for region in at_border:
        spot = _fit_at_border(difference, region, float(np.median(radii_px)) if radii_px else None)
        if isinstance(spot, Spot):
            spots.append(spot)
        else:
            rejected.append(_rejection_text(region, spot))
    return LocatedLeds(tuple(sorted(spots, key=lambda spot: spot.u_px)), tuple(rejected))


def _reaches_border(region: Region, frame: Frame) -> bool:
    rows, columns = frame.pixels.shape
    return min(region.left, region.top) <= 0 or region.right >= columns or region.bottom >= rows


def _fit_at_border(difference: Frame, region: Region, usual_radius_px: float | None) -> Spot | NoSpot:
    """Return the LED in a region at the border; ``usual_radius_px`` is the radius of complete ones."""
    left, top = max(region.left - _MARGIN_PX, 0), max(region.top - _MARGIN_PX, 0)
    window = difference.pixels[top : region.bottom + _MARGIN_PX, left : region.right + _MARGIN_PX]
    disc = fit_disc(window.astype(np.float32), usual_radius_px or _INITIAL_RADIUS_PX)
    if disc is None:
        return NoSpot(Reason.CUT_BY_EDGE, "too little of it is in the picture")
    if (
        usual_radius_px is not None
        and not 1 / _MAX_SIZE_RATIO < disc.radius_px / usual_radius_px < _MAX_SIZE_RATIO
    ):
        return NoSpot(
            Reason.WRONG_SIZE,
            f"diameter {2 * disc.radius_px:.1f} px, the others have {2 * usual_radius_px:.1f} px",
        )
    return Spot(left + disc.u_px, top + disc.v_px, disc.sigma_px, 2 * disc.radius_px, disc.level)


def _rejection_text(region: Region, spot: NoSpot) -> str:
    place = f"u {(region.left + region.right) / 2:.0f} v {(region.top + region.bottom) / 2:.0f} px"
    return f"LED at {place}: {spot.reason}" + (f" ({spot.detail})" if spot.detail else "")


def with_leds_as_cause(refused: NoSpot, lit: int, leds: int) -> NoSpot:
    """Return the rejection, with the lit frame LEDs as the cause if they are the visible light."""
    if lit < 2 or 2 * lit < leds:
        return refused
    cause = FaultCause.LEDS_LIT
    detail = f"{cause.meaning}, {lit} of {leds} shine at their places"
    return replace(refused, detail=detail, cause=cause, spot=None)
