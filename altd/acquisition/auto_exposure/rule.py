"""Brightness of a frame, and the next exposure time and gain of its camera (docs/cameras.md)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum, auto
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from altd.config import READOUT_SHARE, ExposureSettings
from altd.ports import ExposureRange
from altd.reasons import Reason
from altd.records import Frame, NoSpot, PixelArray, Spot
from altd.vision.image import SATURATED_FROM, clipped_from

LOW, HIGH = 0.35, 0.8
"""Limits of the band of levels, as shares of full scale, in which exposure is not changed."""
TARGET = math.sqrt(LOW * HIGH)
"""Target level of the control: the geometric mean of the band's limits."""

CLIPPED_FROM = 0.995
"""Share of full scale from which a pixel counts as clipped."""

_PERCENTILE = 0.98
_CELL_PX = 8
_CLIPPED_CELL = 0.1
"""Share of clipped pixels in a clipped cell: the dots of a window cover a fifth, a hot pixel 1/64."""

_MIN_AGREEING = 3
"""Number of exposures that must agree while nothing valid is measured: a single one may be a flash."""
_ABSENCE_WINDOWS = 2
"""Number of windows to wait for a lost spot; most return unchanged."""
_SEARCH_FACTOR = 4.0
_OVEREXPOSED_FACTOR = 1 / 4
"""Factor after ``saturated``; that needs at least 1.8-fold over-exposure, so at least 0.45 remains."""
_CLIPPED_FACTOR = HIGH / 2
"""Factor for a located but clipped spot; over-exposed about twofold at most, it gets 0.4 to 0.8."""
_MAX_BACKGROUND = 0.5
"""Maximum level of the background during a search."""
_MIN_LEVEL = 0.01
"""Minimum level used in divisions, so that a black frame does not request an infinite exposure."""
_MIN_CHANGE = 1.05
"""Minimum factor of a change; smaller changes are not made."""


@dataclass(frozen=True, slots=True)
class Setting:
    """Exposure and gain of a camera."""

    exposure_ms: float
    gain_db: float

    @property
    def light(self) -> float:
        """Equivalent exposure time without gain, ms: grey values are proportional to it."""
        return self.exposure_ms * _factor(self.gain_db)


class Content(Enum):
    """Content of a frame, as far as it matters for exposure control."""

    SPOT = auto()
    OVEREXPOSED = auto()
    """A saturated spot, or another clipped object."""
    NOTHING = auto()
    """No spot: the laser is off or the spot is too dark."""
    OTHER = auto()
    """An unusable spot that another exposure would not make usable."""


@dataclass(frozen=True, slots=True)
class BrightnessSample:
    """Brightness and content of one frame.

    ``level`` is the brightness of the spot or else of the brightest cell, as a share of full scale, including
    the background.
    """

    content: Content
    level: float


def ceiling_of(frame: Frame, spot: Spot | NoSpot) -> float | None:
    """Return the largest value that the camera delivers if a clipped spot shows it; None: full scale."""
    if isinstance(spot, Spot):
        bright = _middle_of(spot, frame.pixels)
    elif spot.reason is Reason.SATURATED:
        bright = frame.pixels[frame.pixels > frame.pixels.max() // 2]
    else:
        return None
    clipped = clipped_from(bright, frame.full_scale)
    return clipped if clipped < SATURATED_FROM * frame.full_scale else None


def sample_brightness(frame: Frame, spot: Spot | NoSpot, ceiling: float | None = None) -> BrightnessSample:
    """Return the brightness of a frame, given the localiser's result; ``ceiling`` replaces full scale.

    The level of a spot is the 98th percentile of a square as wide as half its 1/e² diameter. A Gaussian falls
    there to 0.78 at the corners. So the level is the peak, both on a plate and on the dots of a window (a
    fifth of the area), and neither a hot pixel nor a grain of speckle determines it.
    """
    pixels, full = frame.pixels, ceiling or frame.full_scale
    if isinstance(spot, Spot):
        around = _middle_of(spot, pixels)
        place = int(_PERCENTILE * (around.size - 1))
        return BrightnessSample(Content.SPOT, float(np.partition(around, place)[place]) / full)
    if spot.reason is Reason.SATURATED or _is_clipped_somewhere(pixels, full):
        return BrightnessSample(Content.OVEREXPOSED, 1.0)
    content = Content.NOTHING if spot.reason is Reason.SPOT_MISSING else Content.OTHER
    return BrightnessSample(content, float(_cells(pixels).max()) / full)


def _middle_of(spot: Spot, pixels: PixelArray) -> PixelArray:
    """Return the pixels of a square half as wide as the spot."""
    half = max(round(spot.diameter_px / 4), 2)
    u, v = round(spot.u_px), round(spot.v_px)
    return pixels[max(v - half, 0) : v + half + 1, max(u - half, 0) : u + half + 1].ravel()


def limits_of(control: ExposureSettings, camera: ExposureRange, fps: float) -> ExposureRange:
    """Return the exposure limits set by the config, the camera, and the time between two frames."""
    longest_ms = min(control.longest_ms, camera.longest_ms, (1 - READOUT_SHARE) * 1000 / fps)
    return ExposureRange(
        shortest_ms=min(max(control.shortest_ms, camera.shortest_ms), longest_ms),
        longest_ms=longest_ms,
        smallest_gain_db=camera.smallest_gain_db,
        largest_gain_db=max(min(control.largest_gain_db, camera.largest_gain_db), camera.smallest_gain_db),
    )


def setting_for(light: float, limits: ExposureRange) -> Setting:
    """Return the setting nearest to ``light`` within the limits; gain only beyond the longest exposure."""
    exposure_ms = light / _factor(limits.smallest_gain_db)
    exposure_ms = min(max(exposure_ms, limits.shortest_ms), limits.longest_ms)
    gain_db = 20 * math.log10(light / exposure_ms)
    return Setting(exposure_ms, min(max(gain_db, limits.smallest_gain_db), limits.largest_gain_db))


@dataclass(frozen=True, slots=True)
class _Demand:
    """Requested light, ms, and the number of consecutive exposures that must request a change that way."""

    light: float
    exposures: int


class ExposureRule:
    """Exposure rule of one camera: brightness samples in, settings out.

    ``window`` is the number of exposures that one measurement averages. In normal operation a change needs
    that many exposures outside the band, so it disturbs at most one of several windows. After a change, three
    suffice until the level is in the band again, because no valid measurement is lost.
    """

    def __init__(self, limits: ExposureRange, window: int) -> None:
        self._limits = limits
        self._window = window
        self._settled = False
        self._good_light: float | None = None
        self._brighter = False
        self._count = 0

    def next(self, sample: BrightnessSample, present: Setting) -> Setting | None:
        """Return the setting that follows from ``sample``, exposed with ``present``; None: no change."""
        demand = self._demand(sample, present.light)
        if demand is None:
            self._count = 0
            return None
        brighter = demand.light > present.light
        self._count = self._count + 1 if brighter is self._brighter else 1
        self._brighter = brighter
        if self._count < demand.exposures:
            return None
        setting = setting_for(demand.light, self._limits)
        if 1 / _MIN_CHANGE < setting.light / present.light < _MIN_CHANGE:
            return None  # already at the limit
        self._count, self._settled = 0, False
        return setting

    def _demand(self, sample: BrightnessSample, light: float) -> _Demand | None:
        match sample.content:
            case Content.OVEREXPOSED:
                return self._darker(light)
            case Content.NOTHING:
                return self._searched(light, sample.level)
            case Content.OTHER:
                return None
        exposures = max(self._window, _MIN_AGREEING) if self._settled else _MIN_AGREEING
        if sample.level >= CLIPPED_FROM:
            return _Demand(light * _CLIPPED_FACTOR, exposures)
        if not LOW <= sample.level <= HIGH:
            return _Demand(light * TARGET / max(sample.level, _MIN_LEVEL), exposures)
        self._settled, self._good_light = True, light
        return None

    def _darker(self, light: float) -> _Demand:
        """Return to the light of the last good spot if that is less: a search may end with far too much."""
        good = self._good_light
        if good is not None and good * _MIN_CHANGE < light:
            return _Demand(good, _MIN_AGREEING)
        return _Demand(light * _OVEREXPOSED_FACTOR, _MIN_AGREEING)

    def _searched(self, light: float, level: float) -> _Demand:
        """Search upwards only, for a too bright spot would be found, up to the limits or the background's.

        Wait for a previously good spot first.
        """
        most = light * _MAX_BACKGROUND / max(level, _MIN_LEVEL)
        exposures = max(_ABSENCE_WINDOWS * self._window, _MIN_AGREEING) if self._settled else _MIN_AGREEING
        return _Demand(max(min(light * _SEARCH_FACTOR, most), light), exposures)


def _factor(gain_db: float) -> float:
    return float(10 ** (gain_db / 20))


def _is_clipped_somewhere(pixels: PixelArray, full: float) -> bool:
    """Whether more than hot pixels is clipped."""
    _, clipped = cv2.threshold(pixels, math.ceil(CLIPPED_FROM * full) - 1, 255, cv2.THRESH_BINARY)
    return bool(_cells(np.asarray(clipped)).max() >= _CLIPPED_CELL * 255)


def _cells(pixels: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return the means over cells of 8 × 8 px."""
    size = max(pixels.shape[1] // _CELL_PX, 1), max(pixels.shape[0] // _CELL_PX, 1)
    return np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA))
