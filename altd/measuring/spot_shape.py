"""Shape of spots in the unit frame: one beam lights all targets, so their spots are alike."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import repeat

import numpy as np

from altd.reasons import Reason
from altd.records import Fault, FaultCause, FloatArray, MeanSpots, NoSpot, SpotShape, TargetPoint
from altd.vision.settings import ShapeReference

_MAX_DIAMETER_MM = 17.0
"""Maximum diameter at the targets of a unit. Spots of up to 15 mm are measured (App. A.1); an oblique beam
makes a longer one."""
_MAX_ORDER_RATIO = 2.0
"""Maximum ratio of the profile's order to that of the calibration's laser; a lamp's disc is far steeper."""
_MAX_SIZE_RATIO = 1.25
"""Maximum size ratio of two targets' spots, relative to calibration: a beam widens less on its way."""
STRETCH_SIGMA = 0.001
"""Sigma of a stretch by targets not quite parallel, added to the scatter of the calibration's nodes."""
BIAS_PER_STRETCH = 2.0
"""Displacement of a spot by additional light, one sigma in radii, per stretch caused by the light."""
BIAS_PER_MM2 = 7.5e-5
"""Displacement per difference of squared diameters, mm/mm², on simulated lenses of 5.7 and 8 mm. A map holds
for spots of the calibrated size: its curvature and the lens' fall-off displace others by that square."""
_BIAS_PER_LOSS = 1 / 8
"""Displacement in radii per share of the light that a film takes: a film that is a ramp over the spot does
not change its shape, and shifts it by at most a quarter."""
_STRETCH_PER_TEXTURE = 0.7
"""Scatter of a spot's stretch, per component, over that of its centre by texture in radii. In good drawn
frames it is 0.4 to 0.9: print, speckle of laser pointers on paper, JPEG."""
_SIZE_SIGMA = 0.02
"""Scatter of the logarithm of a radius by texture; in the same frames 0.01 to 0.03."""
EXPLAINED_SIGMAS = 3.0
_MIN_DISTORTION_SIGMAS = 6.0
_MIN_DISTORTION_STRETCH = 0.015
"""Minimum stretch of a distorted spot; a disturbance that displaces a spot by less adds to its sigma."""


@dataclass(frozen=True, slots=True)
class ShapeAgreement:
    """Agreement of a target's spot in shape with the first target's.

    ``sigma_mm`` is the uncertainty of either centre that the difference implies, one sigma; ``distortion`` is
    a text why they cannot be spots of one beam, None if they can.
    """

    sigma_mm: float
    distortion: str | None = None


def shape_in_mm(shape: SpotShape, mm_per_px: FloatArray) -> FloatArray:
    """Return the log of the mean 1/e² radius (mm), two components of the stretch, and the order: (4,).

    The stretch is half the difference of the logarithms of the radii along and across x, then along and
    across the diagonal. ``mm_per_px`` is d(x, y)/d(u, v), (2, 2).
    """
    (xu, xv), (yu, yv) = mm_per_px.tolist()
    # at 1/e² of the peak q^order = 2, and q = ½ (xx dx² + 2 xy dx dy + yy dy²)
    scale = 1 / (2 * 2 ** (1 / shape.order) * (xu * yv - xv * yu) ** 2)
    xx = scale * (shape.a * yv * yv - 2 * shape.b * yu * yv + shape.c * yu * yu)
    xy = scale * (shape.b * (xu * yv + xv * yu) - shape.a * xv * yv - shape.c * xu * yu)
    yy = scale * (shape.a * xv * xv - 2 * shape.b * xu * xv + shape.c * xu * xu)
    mean, half = (xx + yy) / 2, (xx - yy) / 2
    apart = math.hypot(half, xy)
    shorter, longer = (-0.5 * math.log(max(value, 1e-12)) for value in (mean + apart, mean - apart))
    stretch = (shorter - longer) / (2 * apart) if apart else 0.0
    return np.array([(shorter + longer) / 2, stretch * half, stretch * xy, shape.order])


def unlike_a_laser(
    shape: FloatArray, known: ShapeReference | None, max_diameter_mm: float = _MAX_DIAMETER_MM
) -> NoSpot | None:
    """Return why a shape (4,) is not that of a spot which this unit measures; None if it is."""
    diameter_mm = _diameter_mm(shape[0])
    if diameter_mm > max_diameter_mm:
        limit = f"up to {max_diameter_mm:g} mm are measured"
        return NoSpot(
            Reason.WRONG_SIZE, f"the spot is {diameter_mm:.1f} mm wide, {limit}", FaultCause.TOO_WIDE
        )
    if known is None:
        return None
    order_ratio = float(shape[3]) / known.mean[3]
    if max(order_ratio, 1 / order_ratio) > _MAX_ORDER_RATIO:
        orders = f"{shape[3]:.1f}, that of the calibrated spots {known.mean[3]:.1f}"
        return NoSpot(Reason.WRONG_SHAPE, f"the profile's order is {orders}", FaultCause.OTHER_PROFILE)
    return None


def shape_agreement(
    first: FloatArray,
    second: FloatArray,
    first_known: ShapeReference,
    second_known: ShapeReference,
    changed_light: float = 0.0,
) -> ShapeAgreement:
    """Compare two targets' shapes (4,), relative to their difference at calibration.

    Light beside one of two spots (share ε, d sigmas off the spot) stretches it by ε d²/4 and displaces it by
    ε d/2 of its 1/e² radius. Sigma is two radii times the stretch, so that the error is below five sigmas
    from d = 0.2 on, of equal ones 0.4. Nearer light appears only in ``changed_light``, the relative change of
    one spot's light against the other's: with a stretch s, additional ε displaces the spot by √(ε s) radii.
    """
    difference = (second - first) - (np.array(second_known.mean) - np.array(first_known.mean))
    sigma = np.hypot(np.array(first_known.sigma), np.array(second_known.sigma))
    smaller = math.exp(float(first_known.mean[0] - first[0]))
    if smaller > _MAX_SIZE_RATIO:  # texture displaces the edges of all spots by as much
        sigma[1:3] *= smaller
    stretch = float(np.hypot(difference[1], difference[2]))
    stretch_sigma = math.hypot(float(sigma[1] + sigma[2]) / 2, STRETCH_SIGMA)
    unexplained = math.sqrt(max(stretch**2 - (EXPLAINED_SIGMAS * stretch_sigma) ** 2, 0.0))
    added = math.sqrt(changed_light * math.hypot(stretch, stretch_sigma))
    bias = math.hypot(BIAS_PER_STRETCH * unexplained, added, _BIAS_PER_LOSS * changed_light)
    sigma_mm = bias * math.exp(float(max(first[0], second[0])))
    size_ratio = math.exp(abs(float(difference[0])))
    if size_ratio > _MAX_SIZE_RATIO + _MIN_DISTORTION_SIGMAS * float(sigma[0]):
        return ShapeAgreement(sigma_mm, f"the spots differ in size by {size_ratio - 1:.0%}")
    if stretch > max(_MIN_DISTORTION_SIGMAS * stretch_sigma, _MIN_DISTORTION_STRETCH):
        return ShapeAgreement(sigma_mm, f"the spots differ in elongation by {2 * stretch:.1%}")
    return ShapeAgreement(sigma_mm)


def shape_doubts_mm(
    mean: MeanSpots, points: Sequence[TargetPoint], known: Sequence[ShapeReference | None]
) -> FloatArray | Fault:
    """Return the uncertainty of each target's point from the spots' shapes, one sigma in mm, (targets,).

    Returns a fault if a spot is not the beam's. The value is 0 for targets without a shape or a reference.
    A difference below the calibration's scatter adds nothing. So a disturbance that begins or ends in the
    window could be too small in the mean: the uncertainty is the mean of those of the window's parts.
    """
    doubts_mm = np.zeros(len(points))
    shapes = _in_mm(mean.shapes, points)
    for target, shape, reference in zip(mean.targets, shapes, known, strict=True):
        if shape is not None and (why := unlike_a_laser(shape, reference)):
            return why.fault(target)
    for index, (shape, reference) in enumerate(zip(shapes, known, strict=True)):
        if shape is not None and reference is not None:
            doubts_mm[index] = BIAS_PER_MM2 * abs(
                _diameter_mm(shape[0]) ** 2 - _diameter_mm(reference.mean[0]) ** 2
            )
    if not any(known):
        known = [
            None if shape is None else _unseen_by_the_calibration(shape, point, excess_px)
            for shape, point, excess_px in zip(shapes, points, mean.excess_px or repeat(0.0), strict=False)
        ]
    first, first_known = shapes[0], known[0]
    if first is None or first_known is None:
        return doubts_mm
    parts = [_in_mm(part, points) for part in mean.shape_parts]
    for index, (second, second_known) in enumerate(zip(shapes[1:], known[1:], strict=True), start=1):
        if second is None or second_known is None:
            continue
        changed_light = mean.changed_light[index] if mean.changed_light else 0.0
        compared = shape_agreement(first, second, first_known, second_known, changed_light)
        if compared.distortion is not None:
            pair = f"{mean.targets[0]} and {mean.targets[index]}"
            detail = f"{pair}: {compared.distortion}"
            return Fault(Reason.DISTORTED, mean.targets[index], detail, FaultCause.UNLIKE_SPOTS)
        sigmas_mm = [
            shape_agreement(one, other, first_known, second_known, changed_light).sigma_mm
            for one, other in ((part[0], part[index]) for part in parts)
            if one is not None and other is not None
        ]
        sigma_mm = sum(sigmas_mm) / len(sigmas_mm) if sigmas_mm else compared.sigma_mm
        doubts_mm[[0, index]] = np.hypot(doubts_mm[[0, index]], sigma_mm)
    return doubts_mm


def _unseen_by_the_calibration(shape: FloatArray, point: TargetPoint, excess_px: float) -> ShapeReference:
    """Return the reference for a calibration without laser spots, as from a plate, whose mean is not known.

    The targets' spots are alike but for the texture, by which their centres scatter, too.
    """
    px2_to_mm2 = float(np.square(point.jacobian_mm_per_px).sum()) / 2
    texture_mm = math.sqrt(float(np.trace(point.covariance_mm2)) / 2 + excess_px**2 * px2_to_mm2)
    sigma = _STRETCH_PER_TEXTURE * texture_mm / math.exp(shape[0])
    return ShapeReference((0.0, 0.0, 0.0, 1.0), (_SIZE_SIGMA, sigma, sigma, 1.0))


def _in_mm(shapes: Sequence[SpotShape | None], points: Sequence[TargetPoint]) -> list[FloatArray | None]:
    return [
        None if shape is None else shape_in_mm(shape, point.jacobian_mm_per_px)
        for shape, point in zip(shapes, points, strict=True)
    ]


def _diameter_mm(log_radius: float) -> float:
    return 2 * math.exp(float(log_radius))
