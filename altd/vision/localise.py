"""Localisation of a frame's one spot, or the reason why there is none (thesis 2.1.1, 2.1.2)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np
import numpy.typing as npt

from altd.reasons import Reason
from altd.records import FaultCause, Frame, NoSpot, Spot
from altd.vision.ellipse import ellipse
from altd.vision.flat import Flat
from altd.vision.frame_analysis import FrameAnalysis, Outline, Patch, brightest_region
from altd.vision.image import Centre, Noise
from altd.vision.misfit import Misfit, excess_sigmas, hidden_px, misfit_of, radial_chi2, unexplained_of
from altd.vision.profile import Profile, fit_profile, moment
from altd.vision.search import Region, is_wide
from altd.vision.settings import SpotReference, SpotSettings

_MIN_DISTORTION_SIGMAS = 5.5
"""Minimum excess of a distorted spot; by noise and texture alone one spot in fifty million exceeds it."""
MIN_DISTORTION_DIAMETERS = 0.015
"""Minimum possible displacement; a smaller one only adds to the spot's sigma, as dust on the window does."""
_MAX_DISTORTIONS = 3.0
"""Maximum distortion of a spot that may be measured with others, in limits; 35 % rms over 6 mm reach 2.6."""

_NO_PROFILE = NoSpot(Reason.WRONG_SHAPE, "no elliptical profile fits it", FaultCause.OTHER_PROFILE)
_MIN_RADIAL_SHARE = 0.6
"""Minimum part of the misfit in rings around the centre from which the beam has another profile."""

_MAX_EQUAL_SHARE = 0.97
"""Maximum share of a spot's bright pixels with an equal neighbour in their row, or in their column: 0.01
to 0.26 in photographs and recordings, 1 in a picture enlarged by repeating pixels."""
_MIN_SHOT_NOISE_COUNTS = 0.6
"""Minimum shot noise at half the peak at which equal neighbours are counted; the recordings have 0.64."""

_BY_LIGHT_AROUND = frozenset(
    (Reason.AMBIGUOUS, Reason.CUT_BY_EDGE, Reason.WRONG_SIZE, Reason.WRONG_SHAPE, Reason.DISTORTED)
)
"""Reasons of a spot that light around it may cause."""
_MAX_UNEVEN = 0.01
"""Maximum rms of what a smooth background leaves around a spot, in parts of its peak: no edge of a shadow."""
_BIAS_PER_UNEVEN = 0.25
"""Displacement in diameters by a background that varies over a diameter, per share of the peak."""

_E_MINUS_2 = math.exp(-2.0)
_MIN_PRINT_CONTRAST = 0.35
"""Relative scatter of a spot's pixels from which it is on print; speckle is below 0.2."""


@dataclass(frozen=True, slots=True)
class _SpotSize:
    """1/e² diameter of a spot by its contour, and its peak over the background in counts."""

    diameter_px: float
    peak: float


def locate(
    frame: Frame,
    settings: SpotSettings | None = None,
    flat: Flat | None = None,
    reference: SpotReference | None = None,
) -> Spot | NoSpot:
    """Find the one laser spot of a frame, or return why there is none.

    ``flat`` is the target's response, of the frame's size; without it the target is treated as plain, unless
    the spot shows that it is printed. The centre is in px, (0, 0) the middle of the top-left pixel.
    ``sigma_px`` is its standard deviation by read and shot noise, without the fixed pattern of print and
    speckle that is not in the flat; the calibration contains that. With a ``reference`` the spot is compared
    with the target's usual spots: the unexplained part adds to ``excess_px``, and above a limit the spot is
    ``distorted``.
    """
    return locate_in(FrameAnalysis(frame, settings or SpotSettings()), flat, reference)


def locate_in(
    analysis: FrameAnalysis, flat: Flat | None = None, reference: SpotReference | None = None
) -> Spot | NoSpot:
    """Run ``locate`` for a frame whose analysis is shared with other steps.

    Where light around the spot may be the cause of a refusal, the spot is located over the background there.
    """
    first = brightest_region(analysis)
    if isinstance(first, NoSpot):
        return first
    spot = spot_in(analysis, first, flat, reference)
    is_clear = isinstance(spot, Spot) and not is_wide(first, analysis.frame.pixels)
    if reference is None or is_clear or (isinstance(spot, NoSpot) and spot.reason not in _BY_LIGHT_AROUND):
        return spot
    around = analysis.around_spot()
    if around is None or isinstance(region := brightest_region(around), NoSpot):
        return spot
    again = spot_in(around, region, flat, reference)
    if isinstance(again, NoSpot):
        return again if isinstance(spot, Spot) else spot
    analysis.become(around)
    return again


def spot_in(
    analysis: FrameAnalysis, region: Region, flat: Flat | None = None, reference: SpotReference | None = None
) -> Spot | NoSpot:
    """Return the spot in one bright region of a frame, regardless of other lights, or why it is none."""
    frame, settings = analysis.frame, analysis.settings
    patch = analysis.patch(region)
    if isinstance(patch, NoSpot):
        return patch
    size = _classify(frame, patch, settings)
    if isinstance(size, NoSpot):
        return size
    noise = analysis.noise
    if _repeats_pixels(patch, noise):
        return NoSpot(Reason.DISTORTED, "its pixels repeat their neighbours: the camera enlarges the picture")
    by_moment = settings.method == "moment" or (
        settings.method == "auto" and flat is None and is_patterned(patch, noise)
    )
    if by_moment and patch.is_cut:
        return NoSpot(Reason.CUT_BY_EDGE, "the spot reaches the edge of the image")
    profile = None
    if not by_moment or reference is not None:
        profile = _profile(patch, size.diameter_px, noise, flat)
    if by_moment:
        centre = moment(patch, noise, settings)
    elif profile is not None:
        centre = profile.centre
    else:
        return _NO_PROFILE
    if centre.sigma_px > settings.max_sigma_px:
        dim = f"too dim: its place is uncertain by {centre.sigma_px:.1f} px"
        return NoSpot(Reason.SPOT_MISSING, dim, FaultCause.TOO_DIM)
    light_per_ms = None if patch.is_cut else _light_per_ms(frame, size, profile)
    spot = Spot(
        centre.u_px, centre.v_px, centre.sigma_px, size.diameter_px, size.peak, light_per_ms=light_per_ms
    )
    if profile is None:
        return spot if reference is None else _NO_PROFILE
    hidden = 0.0 if flat is None else flat.hidden(spot.u_px, spot.v_px, profile.diameter_px)
    return _compared_with_reference(reference, analysis, patch, profile, spot, hidden)


def _compared_with_reference(
    reference: SpotReference | None,
    analysis: FrameAnalysis,
    patch: Patch,
    profile: Profile,
    spot: Spot,
    hidden: float,
) -> Spot | NoSpot:
    """Return the spot with its shape and its unexplained excess, or why it is rejected.

    ``hidden`` is from ``Flat.hidden``.
    """
    settings = analysis.settings
    shape = profile.shape
    if reference is None and not patch.is_cut:
        return replace(spot, shape=shape)
    misfit = misfit_of(profile.residuals, reference.grain if reference else None)
    if misfit is None:
        part = "too little of it is visible to decide whether it is one spot"
        return NoSpot(Reason.WRONG_SHAPE, part, FaultCause.SEEN_IN_PART)
    unexplained = None if reference is None else unexplained_of(misfit, reference.misfit_ratio)
    excess_px, distorted = 0.0, None
    if reference is not None and unexplained is not None:
        excess_px = unexplained.displacement_px
        limit_px = MIN_DISTORTION_DIAMETERS * max(spot.diameter_px, settings.min_diameter_px)
        distorted = _distortion(reference, misfit, profile) if excess_px > limit_px else None
        is_alone = patch.is_cut or excess_px > _MAX_DISTORTIONS * limit_px
        if distorted is not None and (is_alone or distorted.reason is Reason.WRONG_SHAPE):
            return distorted
    uneven = patch.uneven_counts / patch.peak
    if uneven > _MAX_UNEVEN:
        return NoSpot(Reason.DISTORTED, f"the light around it is uneven by {uneven:.1%} of its peak")
    uneven_px = _BIAS_PER_UNEVEN * spot.diameter_px * uneven
    excess_px = math.hypot(excess_px, uneven_px, _excess_texture_px(misfit, reference, patch.is_cut))
    if reference is not None and hidden:
        excess_px = math.hypot(excess_px, hidden_px(misfit, reference.misfit_ratio, hidden))
    if patch.is_cut:
        rows, columns = analysis.frame.pixels.shape
        is_inside = 0 <= spot.u_px <= columns - 1 and 0 <= spot.v_px <= rows - 1
        if not is_inside or math.hypot(spot.sigma_px, excess_px) > settings.max_sigma_px:
            return NoSpot(Reason.CUT_BY_EDGE, "too much of the spot lies beyond the edge of the image")
        spot = replace(spot, diameter_px=profile.diameter_px)
    spot = replace(spot, excess_px=excess_px, shape=shape, unexplained=unexplained)
    return spot if distorted is None else replace(distorted, spot=spot)


def _distortion(reference: SpotReference, misfit: Misfit, profile: Profile) -> NoSpot | None:
    """Return why a spot's light is not that of one calibrated spot; None if it may be."""
    chi2 = misfit.chi2 / reference.misfit_ratio
    if excess_sigmas(chi2, misfit.degrees_of_freedom) <= _MIN_DISTORTION_SIGMAS:
        return None
    usual = f"by {chi2 / misfit.degrees_of_freedom:.0f} times the usual"
    if radial_chi2(profile.residuals, reference.grain) > _MIN_RADIAL_SHARE * misfit.chi2:
        other = f"its profile misses the calibrated one {usual}"
        return NoSpot(Reason.WRONG_SHAPE, other, FaultCause.OTHER_PROFILE)
    return NoSpot(Reason.DISTORTED, f"its light misses that of one spot {usual}")


def _light_per_ms(frame: Frame, size: _SpotSize, profile: Profile | None) -> float | None:
    """Return the light of a spot: counts × px² for 1 ms of exposure and 0 dB of gain.

    Without a profile it is that of a Gaussian of the spot's peak and 1/e² diameter d, peak · π d²/8. None if
    the exposure is not known.
    """
    if frame.per_ms is None:
        return None
    light = size.peak * math.pi * size.diameter_px**2 / 8 if profile is None else profile.light
    return light * frame.per_ms


def _excess_texture_px(misfit: Misfit, reference: SpotReference | None, cut: bool) -> float:
    """Return the displacement by texture beyond that of usual spots, which the map's covariance contains."""
    known_px = reference.pattern_px if reference else None
    if reference is None or not known_px:
        return misfit.worst_px if cut else 0.0
    if cut:
        return misfit.worst_px * max(reference.noise_px / known_px, 1.0)
    return reference.noise_px * math.sqrt(max((misfit.pattern_px / known_px) ** 2 - 1, 0.0))


def fitted_profile(frame: Frame, settings: SpotSettings, flat: Flat | None) -> Profile | None:
    """Return the profile of the spot that ``locate`` has found in a frame; None if none fits."""
    analysis = FrameAnalysis(frame, settings)
    patch = analysis.brightest_patch
    if patch is None or patch.is_cut:
        return None
    size = _classify(frame, patch, settings)
    return None if isinstance(size, NoSpot) else _profile(patch, size.diameter_px, analysis.noise, flat)


def is_patterned_spot(frame: Frame, settings: SpotSettings) -> bool:
    """Return whether the spot of a frame is on print; False without a spot."""
    analysis = FrameAnalysis(frame, settings)
    patch = analysis.brightest_patch
    return patch is not None and is_patterned(patch, analysis.noise)


def locate_ellipse(
    frame: Frame, settings: SpotSettings | None = None, flat: Flat | None = None
) -> Centre | None:
    """Return the centre of the spot found by ``locate``, by the second localiser; None if it finds none."""
    analysis = FrameAnalysis(frame, settings or SpotSettings())
    patch = analysis.brightest_patch
    return None if patch is None else ellipse(patch, analysis.noise, analysis.settings, flat)


def is_patterned(patch: Patch, noise: Noise) -> bool:
    """Return whether a spot's pixels scatter about the smoothed spot more than noise and speckle explain."""
    core = patch.smooth > 0.5 * patch.peak
    light, smooth = patch.excess[core], patch.smooth[core]
    scale = float(light @ smooth) / float(smooth @ smooth)  # smoothing lowers a peak
    residual = light - np.float32(scale) * smooth
    expected = len(residual) * noise.read_counts**2 + float(smooth.sum()) / noise.electrons_per_count
    return float(residual @ residual) - expected > _MIN_PRINT_CONTRAST**2 * float(light @ smooth) * scale


def _profile(patch: Patch, diameter_px: float, noise: Noise, flat: Flat | None) -> Profile | None:
    """Fit the profile without the clipped pixels."""
    clipped = patch.pixels >= patch.clipped_from if patch.pixels.max() >= patch.clipped_from else None
    return fit_profile(patch, flat, diameter_px, noise, clipped)


def _classify(frame: Frame, patch: Patch, settings: SpotSettings) -> _SpotSize | NoSpot:
    """Classify the contour by size and shape (2.1.1); return the spot's size, or why it is none."""
    peak, clipped = _brightness(patch)
    if clipped > settings.max_saturated:
        return NoSpot(Reason.SATURATED, f"{clipped:.0%} of the spot's bright pixels are saturated")
    second = second_piece_share(patch.core)
    if second >= settings.like_size:
        double = f"two spots touch, the second has {second:.0%} of the first one's area"
        return NoSpot(Reason.AMBIGUOUS, double, FaultCause.DOUBLE)
    diameter_px = _diameter_px(patch, settings)
    max_diameter_px = settings.max_diameter_px or 0.6 * min(frame.pixels.shape)
    if not settings.min_diameter_px <= diameter_px <= max_diameter_px:
        limits = f"{settings.min_diameter_px:.0f} to {max_diameter_px:.0f} px"
        return NoSpot(Reason.WRONG_SIZE, f"diameter {diameter_px:.1f} px, expected {limits}")
    aspect, fill = shape_of(patch.outline)
    if patch.is_cut:  # the visible part of a spot has another shape
        return _SpotSize(diameter_px, peak)
    if aspect > settings.max_aspect or fill < settings.min_fill:
        return NoSpot(Reason.WRONG_SHAPE, f"aspect ratio {aspect:.1f}, fill {fill:.2f}")
    return _SpotSize(diameter_px, peak)


def _brightness(patch: Patch) -> tuple[float, float]:
    """Return the peak of the spot over the background, and the saturated fraction of its bright pixels.

    The peak is where the brightest hundredth of its core begins, so that a hot pixel among the dots makes
    none. Bright pixels reach half of that: on the printed window the dots, not the glass between them.
    """
    raw, excess = patch.pixels[patch.core], patch.excess[patch.core]
    brightest = len(excess) - 1 - len(excess) // 100
    peak = float(np.partition(excess, brightest)[brightest])
    saturated = raw >= patch.clipped_from
    bright = excess >= 0.5 * peak
    return peak, np.count_nonzero(saturated & bright) / np.count_nonzero(bright)


def _repeats_pixels(patch: Patch, noise: Noise) -> bool:
    """Return whether rows or columns repeat within a spot, as in a binned picture enlarged to its old size.

    The enlarged picture has another scale if the factor does not divide the picture's size.
    """
    if 0.5 * patch.peak < _MIN_SHOT_NOISE_COUNTS**2 * noise.electrons_per_count:
        return False
    bright = patch.smooth > 0.5 * patch.peak
    bright &= patch.pixels < patch.clipped_from
    limit = _MAX_EQUAL_SHARE * np.count_nonzero(bright)
    for pixels, chosen in ((patch.pixels, bright), (patch.pixels.T, bright.T)):
        equal = pixels[:, 1:] == pixels[:, :-1]
        neighboured = np.zeros_like(chosen)
        neighboured[:, 1:] = equal
        neighboured[:, :-1] |= equal
        if 0 < limit < np.count_nonzero(neighboured & chosen):
            return True
    return False


def second_piece_share(core: npt.NDArray[np.bool_]) -> float:
    """Return the area of the second largest piece of the core, relative to the largest."""
    count, labels = cv2.connectedComponents(core.view(np.uint8))
    if count <= 2:
        return 0.0
    areas = np.sort(np.bincount(np.asarray(labels).ravel())[1:])[::-1]
    return float(areas[1] / areas[0])


def _diameter_px(patch: Patch, settings: SpotSettings) -> float:
    """Return the 1/e² diameter of the circle of equal area, less the smoothing Gaussian's (4 sigma)."""
    area = np.count_nonzero((patch.smooth > _E_MINUS_2 * patch.peak) & (patch.mask > 0))
    return math.sqrt(max(4 * area / math.pi - 16 * settings.smoothing_px**2, 0.0))


def shape_of(outline: Outline) -> tuple[float, float]:
    """Return the aspect ratio of the ellipse of equal second moments, and the outline's area over its."""
    # 1/12: the second moment of a pixel, so that a thin line has a width
    uu, vv, uv = outline.uu + 1 / 12, outline.vv + 1 / 12, outline.uv
    mean, difference = (uu + vv) / 2, math.hypot((uu - vv) / 2, uv)
    major, minor = mean + difference, max(mean - difference, 1e-9)
    return math.sqrt(major / minor), outline.area / (4 * math.pi * math.sqrt(major * minor))
