"""The brightness of a frame, and its camera's next exposure and gain (docs/cameras.md)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum, auto
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from altd.config import ExposureSettings
from altd.ports import ExposureRange
from altd.reasons import Reason
from altd.records import Frame, NoSpot, PixelArray, Spot

LOW, HIGH = 0.35, 0.8
"""The band of levels, shares of full scale, in which exposure is left alone."""
TARGET = math.sqrt(LOW * HIGH)
"""The target of the control: the geometric middle of the band."""

CLIPPED_FROM = 0.995
"""Share of full scale from which a pixel counts as clipped."""

_PERCENTILE = 0.98
_CELL_PX = 8
_CLIPPED_CELL = 0.1
"""Share of a cell's pixels: the dots of a window cover a fifth of it, a hot pixel a sixty-fourth."""

_MIN_AGREEING = 3
"""Exposures that must agree while nothing valid is measured: one may be a flash."""
_ABSENCE_WINDOWS = 2
"""A spot that is gone is waited for so long; most come back as they were."""
_SEARCH_FACTOR = 4.0
_OVEREXPOSED_FACTOR = 1 / 4
"""``saturated`` is said from 1.8-fold over-exposure on at the earliest, so this leaves 0.45 at least."""
_CLIPPED_FACTOR = HIGH / 2
"""A clipped spot that is found is over-exposed about twofold at most: this brings it to 0.4 to 0.8."""
_MAX_BACKGROUND = 0.5
"""A search makes no background brighter than this."""
_MIN_LEVEL = 0.01
"""Level that is taken for the least, so that a black frame does not ask for infinitely more."""
_MIN_CHANGE = 1.05
"""Factor; a change by less is none."""
_READOUT_SHARE = 0.1
"""Of the time between two frames, what a camera may need beside the exposure."""


@dataclass(frozen=True, slots=True)
class Setting:
    """Exposure and gain of a camera."""

    exposure_ms: float
    gain_db: float

    @property
    def light(self) -> float:
        """The quantity that grey values follow: the equivalent exposure time without gain, ms."""
        return self.exposure_ms * _factor(self.gain_db)


class Content(Enum):
    """The contents of a frame that decide on its exposure."""

    SPOT = auto()
    OVEREXPOSED = auto()
    """Saturated, or something else that is no spot and is clipped."""
    NOTHING = auto()
    """Laser off or spot too dark."""
    OTHER = auto()
    """Something that is no usable spot for a reason that exposure does not mend."""


@dataclass(frozen=True, slots=True)
class BrightnessSample:
    """The brightness of one frame, and what it holds.

    ``level`` is a share of full scale, the background in it: that of the spot, or of the brightest place.
    """

    content: Content
    level: float


def sample_brightness(frame: Frame, spot: Spot | NoSpot) -> BrightnessSample:
    """The brightness of a frame, by what the localiser found in it.

    The level of a spot is the 98th percentile of a square as wide as half its 1/e² diameter: a Gaussian fades
    there to 0.78 at the corners, so on a plate as on the dots of a window (a fifth of the area) that is the
    peak, and neither a hot pixel nor a grain of speckle is.
    """
    pixels, full = frame.pixels, frame.full_scale
    if isinstance(spot, Spot):
        half = max(round(spot.diameter_px / 4), 2)
        u, v = round(spot.u_px), round(spot.v_px)
        around = pixels[max(v - half, 0) : v + half + 1, max(u - half, 0) : u + half + 1].ravel()
        place = int(_PERCENTILE * (around.size - 1))
        return BrightnessSample(Content.SPOT, float(np.partition(around, place)[place]) / full)
    if spot.reason is Reason.SATURATED or _is_clipped_somewhere(pixels, full):
        return BrightnessSample(Content.OVEREXPOSED, 1.0)
    content = Content.NOTHING if spot.reason is Reason.SPOT_MISSING else Content.OTHER
    return BrightnessSample(content, float(_cells(pixels).max()) / full)


def limits_of(control: ExposureSettings, camera: ExposureRange, fps: float) -> ExposureRange:
    """The limits by the config, the camera, and the time between two frames."""
    longest_ms = min(control.longest_ms, camera.longest_ms, (1 - _READOUT_SHARE) * 1000 / fps)
    return ExposureRange(
        shortest_ms=min(max(control.shortest_ms, camera.shortest_ms), longest_ms),
        longest_ms=longest_ms,
        smallest_gain_db=camera.smallest_gain_db,
        largest_gain_db=max(min(control.largest_gain_db, camera.largest_gain_db), camera.smallest_gain_db),
    )


def setting_for(light: float, limits: ExposureRange) -> Setting:
    """Exposure first, gain only where the longest exposure does not do; as near as the limits allow."""
    exposure_ms = light / _factor(limits.smallest_gain_db)
    exposure_ms = min(max(exposure_ms, limits.shortest_ms), limits.longest_ms)
    gain_db = 20 * math.log10(light / exposure_ms)
    return Setting(exposure_ms, min(max(gain_db, limits.smallest_gain_db), limits.largest_gain_db))


@dataclass(frozen=True, slots=True)
class _Demand:
    """Light that would do better, and how many exposures in a row must ask for more, or for less."""

    light: float
    exposures: int


class ExposureRule:
    """One camera's rule: brightness samples in, settings out.

    ``window`` is the number of exposures that one measurement averages. While all is well a change needs
    that many exposures out of the band, so it disturbs no more than one window of several. Until the level
    has once been in the band again nothing valid is lost, and three do.
    """

    def __init__(self, limits: ExposureRange, window: int) -> None:
        self._limits = limits
        self._window = window
        self._settled = False
        self._good_light: float | None = None
        self._brighter = False
        self._count = 0

    def next(self, sample: BrightnessSample, present: Setting) -> Setting | None:
        """The next setting after a frame exposed with ``present`` that shows ``sample``; None: no change."""
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
            return None  # as far as it goes
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
        """Back to where the spot was good, when that is darker: a search ends with a spot far too bright."""
        good = self._good_light
        if good is not None and good * _MIN_CHANGE < light:
            return _Demand(good, _MIN_AGREEING)
        return _Demand(light * _OVEREXPOSED_FACTOR, _MIN_AGREEING)

    def _searched(self, light: float, level: float) -> _Demand:
        """Up only, for a spot too bright would be seen; and to rest where the limits or the background end.

        A spot that was good is waited for first.
        """
        most = light * _MAX_BACKGROUND / max(level, _MIN_LEVEL)
        exposures = max(_ABSENCE_WINDOWS * self._window, _MIN_AGREEING) if self._settled else _MIN_AGREEING
        return _Demand(max(min(light * _SEARCH_FACTOR, most), light), exposures)


def _factor(gain_db: float) -> float:
    return float(10 ** (gain_db / 20))


def _is_clipped_somewhere(pixels: PixelArray, full: int) -> bool:
    """Whether more is clipped than hot pixels."""
    _, clipped = cv2.threshold(pixels, math.ceil(CLIPPED_FROM * full) - 1, 255, cv2.THRESH_BINARY)
    return bool(_cells(np.asarray(clipped)).max() >= _CLIPPED_CELL * 255)


def _cells(pixels: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Means over cells of 8 × 8 px."""
    size = max(pixels.shape[1] // _CELL_PX, 1), max(pixels.shape[0] // _CELL_PX, 1)
    return np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA))
