"""altd's localiser and other libraries', each used as its own documentation says."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import cv2
import laserbeamsize
import numpy as np
import numpy.typing as npt
import trackpy
from photutils.centroids import centroid_2dg, centroid_com
from scipy import ndimage
from skimage.filters import gaussian, threshold_otsu
from skimage.measure import label, regionprops

from altd.records import Spot
from altd.vision.frame_analysis import FrameAnalysis
from altd.vision.localise import locate, spot_in
from altd.vision.settings import SpotSettings
from benchmarks.peers_frames import SMOOTHING_PX, Sample

FRAME, REGION, FRAME_FLAT, FLAT = "frame", "region", "frame, flat", "region, flat"

_SETTINGS = SpotSettings()
_SIGMA_PX = SMOOTHING_PX
_MIN_RESPONSE = 0.3
"""Of a flat's mean: where a pixel shows less, dividing by the flat gives noise."""
_PEAK_SHARE = 0.05
_SOFT_SHARE = 0.1
_CONTOUR = math.exp(-2.0)
"""Shares of the peak: of those tried (5, 10, 20 %; 14, 30, 50 % for the ellipse) the best on the window."""

_FEATURE_PX = 75
"""The feature's extent that trackpy must be told: of 41, 51, 61 and 75 px the best on the window's frames."""
_MIN_COUNTS = 10
"""Below this trackpy clips its band pass: the noise of a whole frame else makes it look for minutes."""

Place = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Localiser:
    """``given`` is a frame, a spot's region, or that with a flat; ``find`` returns (u, v) px in the frame."""

    library: str
    name: str
    given: str
    how: str
    find: Callable[[Sample], Place]


def _altd(sample: Sample) -> Place:
    return _place(locate(sample.frame, _SETTINGS))


def _altd_in_region(sample: Sample) -> Place:
    return _place(spot_in(_analysis(sample), sample.region))


def _altd_with_flat(sample: Sample) -> Place:
    return _place(locate(sample.frame, _SETTINGS, sample.flat.for_altd))


def _altd_in_region_with_flat(sample: Sample) -> Place:
    return _place(spot_in(_analysis(sample), sample.region, sample.flat.for_altd))


def _analysis(sample: Sample) -> FrameAnalysis:
    """The search is given, as the other libraries are given the region; the rest is made again."""
    return FrameAnalysis(sample.frame, _SETTINGS, sample.found)


def _place(spot: object) -> Place:
    if not isinstance(spot, Spot):
        raise LookupError(spot)
    return spot.u_px, spot.v_px


def _laserbeamsize(sample: Sample) -> Place:
    u, v, *_ = laserbeamsize.beam_size(sample.mended_excess)
    return u, v


def _laserbeamsize_in_region(sample: Sample) -> Place:
    u, v, *_ = laserbeamsize.beam_size(sample.excess, corner_fraction=0)
    return _in_frame(sample, u, v)


def _photutils_com(sample: Sample) -> Place:
    return _in_frame(sample, *centroid_com(sample.excess))


def _photutils_2dg(sample: Sample) -> Place:
    return _in_frame(sample, *centroid_2dg(sample.excess))


def _trackpy(sample: Sample) -> Place:
    return _brightest(sample.mended)


def _trackpy_in_region(sample: Sample) -> Place:
    return _in_frame(sample, *_brightest(sample.raw))


def _brightest(pixels: npt.NDArray[Any]) -> Place:
    features = trackpy.locate(
        pixels,
        _FEATURE_PX,
        topn=1,
        noise_size=_SIGMA_PX,
        threshold=_MIN_COUNTS,
        characterize=False,
        engine="numba",
    )
    return float(features["x"].iloc[0]), float(features["y"].iloc[0])


def _skimage(sample: Sample) -> Place:
    smooth = gaussian(sample.excess, _SIGMA_PX, preserve_range=True)
    regions = regionprops(
        label(smooth > threshold_otsu(smooth)), intensity_image=np.maximum(sample.excess, 0)
    )
    v, u = max(regions, key=lambda region: region.area).centroid_weighted
    return _in_frame(sample, u, v)


def _scipy(sample: Sample) -> Place:
    smooth = ndimage.gaussian_filter(sample.excess, _SIGMA_PX)
    labels, _ = ndimage.label(smooth > _PEAK_SHARE * smooth.max())
    v, u = ndimage.center_of_mass(
        sample.excess, labels, labels[np.unravel_index(smooth.argmax(), smooth.shape)]
    )
    return _in_frame(sample, u, v)


def _opencv_moments(sample: Sample) -> Place:
    smooth = cv2.GaussianBlur(sample.excess, (0, 0), _SIGMA_PX)
    _, above = cv2.threshold(smooth, _PEAK_SHARE * float(smooth.max()), 0, cv2.THRESH_TOZERO)
    moments = cv2.moments(above)
    return _in_frame(sample, moments["m10"] / moments["m00"], moments["m01"] / moments["m00"])


def _opencv_soft_moments(sample: Sample) -> Place:
    smooth = cv2.GaussianBlur(sample.excess, (0, 0), _SIGMA_PX)
    over = np.maximum(smooth - np.float32(_SOFT_SHARE * smooth.max()), np.float32(0))
    moments = cv2.moments(over)
    return _in_frame(sample, moments["m10"] / moments["m00"], moments["m01"] / moments["m00"])


def _photutils_2dg_with_flat(sample: Sample) -> Place:
    response = sample.flat.response[sample.window]
    dark = response < _MIN_RESPONSE
    corrected = sample.excess / np.where(dark, np.float32(1), response)
    return _in_frame(sample, *centroid_2dg(corrected, mask=dark))


def _opencv_moments_with_flat(sample: Sample) -> Place:
    weighted = sample.excess * sample.flat.response[sample.window]
    smooth = cv2.GaussianBlur(weighted, (0, 0), _SIGMA_PX) / sample.flat.smooth_square[sample.window]
    _, above = cv2.threshold(smooth, _PEAK_SHARE * float(smooth.max()), 0, cv2.THRESH_TOZERO)
    moments = cv2.moments(above)
    return _in_frame(sample, moments["m10"] / moments["m00"], moments["m01"] / moments["m00"])


def _opencv_ellipse(sample: Sample) -> Place:
    smooth = cv2.GaussianBlur(sample.excess, (0, 0), _SIGMA_PX)
    mask = (smooth > _CONTOUR * float(smooth.max())).astype(np.uint8)
    contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    (u, v), _, _ = cv2.fitEllipse(max(contours, key=cv2.contourArea))
    return _in_frame(sample, u, v)


def _in_frame(sample: Sample, u: float, v: float) -> Place:
    return sample.left + float(u), sample.top + float(v)


LOCALISERS = (
    Localiser("altd", "altd `locate`", FRAME, "the frame as the camera delivers it; default settings", _altd),
    Localiser(
        "altd",
        "altd `spot_in`",
        REGION,
        "the same, from the coarse search's region and background on; it judges the spot and states a sigma",
        _altd_in_region,
    ),
    Localiser("altd", "altd `locate`", FRAME_FLAT, "the same with the flat", _altd_with_flat),
    Localiser("altd", "altd `spot_in`", FLAT, "the same with the flat", _altd_in_region_with_flat),
    Localiser(
        "laserbeamsize",
        "laserbeamsize `beam_size`",
        FRAME,
        "defaults (ISO 11146), on the frame without the background that altd finds: on the raw frame, with"
        " its own background from the corners, it fails on more",
        _laserbeamsize,
    ),
    Localiser(
        "laserbeamsize",
        "laserbeamsize `beam_size`",
        REGION,
        "the region, with corner_fraction 0 as its documentation says for such images;"
        " better here than its own corners",
        _laserbeamsize_in_region,
    ),
    Localiser(
        "photutils",
        "photutils `centroid_com`",
        REGION,
        "a background-subtracted cutout with one source, as its documentation asks for",
        _photutils_com,
    ),
    Localiser(
        "photutils", "photutils `centroid_2dg`", REGION, "the same cutout; no error image", _photutils_2dg
    ),
    Localiser(
        "trackpy",
        "trackpy `locate`",
        FRAME,
        f"diameter {_FEATURE_PX} px, topn 1, noise_size {_SIGMA_PX:g} px (bridges the dots), threshold"
        f" {_MIN_COUNTS} counts, its own band pass, numba engine (compiled before), no extras",
        _trackpy,
    ),
    Localiser(
        "trackpy",
        "trackpy `locate`",
        REGION,
        "the same on the region's raw counts",
        _trackpy_in_region,
    ),
    Localiser(
        "scikit-image",
        "scikit-image `regionprops`",
        REGION,
        f"gaussian {_SIGMA_PX:g} px, threshold_otsu, label, centroid_weighted of the largest, the excess"
        " as intensity",
        _skimage,
    ),
    Localiser(
        "scipy",
        "scipy `ndimage.center_of_mass`",
        REGION,
        f"gaussian_filter {_SIGMA_PX:g} px, label above {_PEAK_SHARE:.0%} of the peak, center_of_mass of the"
        " excess in that label",
        _scipy,
    ),
    Localiser(
        "opencv-python-headless",
        "OpenCV `moments`",
        REGION,
        f"GaussianBlur {_SIGMA_PX:g} px, THRESH_TOZERO at {_PEAK_SHARE:.0%} of the peak, m10/m00 and m01/m00",
        _opencv_moments,
    ),
    Localiser(
        "opencv-python-headless",
        "OpenCV `moments`, (I − T)₊",
        REGION,
        f"the same with T = {_SOFT_SHARE:.0%} of the peak subtracted, which its documentation does not say",
        _opencv_soft_moments,
    ),
    Localiser(
        "opencv-python-headless",
        "OpenCV `fitEllipse`",
        REGION,
        f"GaussianBlur {_SIGMA_PX:g} px, contour at {_CONTOUR:.0%} of the peak (findContours), fitEllipse",
        _opencv_ellipse,
    ),
    Localiser(
        "photutils",
        "photutils `centroid_2dg`",
        FLAT,
        f"the cutout divided by the flat, mask where the flat is below {_MIN_RESPONSE:.0%} of its mean",
        _photutils_2dg_with_flat,
    ),
    Localiser(
        "opencv-python-headless",
        "OpenCV `moments`",
        FLAT,
        f"GaussianBlur {_SIGMA_PX:g} px of excess times flat over that of the flat's square"
        " (kept from before), then as without a flat",
        _opencv_moments_with_flat,
    ),
)
