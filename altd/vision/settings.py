"""Localiser's part of a calibration file: its settings, and statistics of the target's good spots.

The limits of the numbers apply to those that are read from a file.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from altd.records import FloatArray

Method = Literal["auto", "moment", "profile"]


@dataclass(frozen=True, slots=True)
class SpotSettings:
    """Settings by which a spot is found and classified.

    The first four determine the centre, so a map and the frames it is used on must share them.
    """

    method: Method = "auto"
    """``profile`` fits a super-Gaussian through the flat, ``moment`` takes the first moment, which a printed
    pattern without a flat disturbs less; ``auto`` chooses by whether the spot is on print."""
    smoothing_px: Annotated[float, Field(ge=0, le=100)] = 4.0
    """Sigma of the Gaussian that bridges the printed dots: about one dot pitch. 0 switches it off."""
    threshold: Annotated[float, Field(gt=0, lt=1)] = 0.07
    """Threshold T of (I − T)₊ as a fraction of the smoothed spot's peak over the background."""
    power: Annotated[float, Field(gt=0, le=10)] = 0.4
    """Exponent p of Eq. 2.7. Below 1 it flattens the weights, which suits noise that increases with the
    light, such as speckle and printed dots: on six simulated units and unit-a, 0.4 above 7 % scatters 10 to
    30 % less than 1 above 10 %."""
    min_diameter_px: Annotated[float, Field(gt=0, le=10_000)] = 8.0
    """Minimum 1/e² diameter; spots outside the limits are ``wrong_size``."""
    max_diameter_px: Annotated[float, Field(gt=0, le=20_000)] | None = None
    """Maximum 1/e² diameter; None: 0.6 of the image's smaller side."""
    max_aspect: Annotated[float, Field(ge=1, le=100)] = 3.5
    """Maximum aspect ratio; longer is ``wrong_shape``. A laser diode's ellipse reaches 2.6 (App. A.2)."""
    min_fill: Annotated[float, Field(ge=0, le=1)] = 0.8
    """Minimum area over that of the ellipse with the same second moments; rings and crescents have less."""
    like_size: Annotated[float, Field(gt=0, le=1)] = 0.3
    """Share of the first spot's light from which a second spot makes the frame ``ambiguous``."""
    max_saturated: Annotated[float, Field(ge=0, le=1)] = 0.5
    """Saturated fraction of the spot's bright pixels above which it is ``saturated``: a Gaussian reaches it
    when it is over-exposed twofold. Below that the fit excludes clipped pixels and loses little."""
    max_sigma_px: Annotated[float, Field(gt=0, le=1000)] = 0.5
    """Maximum uncertainty of a spot's centre, px; above it the spot is too dim."""
    full_well_electrons: Annotated[float, Field(ge=100, le=10_000_000)] = 15_000.0
    """Electrons at full scale, for the shot noise in ``sigma_px``."""


ShapeVector = tuple[float, float, float, float]
_Feature = Annotated[float, Field(ge=-10, le=10)]
_Scatter = Annotated[float, Field(ge=0, le=10)]
_LogLight = Annotated[float, Field(ge=-1000, le=1000)]


@dataclass(frozen=True, slots=True)
class ShapeReference:
    """Mean and standard deviation of a spot's shape over a target, in the unit frame.

    Logarithm of the mean 1/e² radius in mm, two components of the stretch, and the profile's order, as
    ``altd.measuring.spot_shape.shape_in_mm`` returns them.
    """

    mean: tuple[_Feature, _Feature, _Feature, Annotated[float, Field(gt=0, le=1000)]]
    sigma: tuple[_Scatter, _Scatter, _Scatter, _Scatter]


@dataclass(frozen=True, slots=True)
class LightReference:
    """Logarithm of the light of the scan's spots over a target, counts · px² / ms.

    ``log_light`` holds the coefficients of 1, u, v, u², uv and v², with u and v in units of 1000 px;
    ``sigma`` is the scatter of single spots about it.
    """

    log_light: tuple[_LogLight, _LogLight, _LogLight, _LogLight, _LogLight, _LogLight]
    sigma: Annotated[float, Field(gt=0, le=10)]

    @staticmethod
    def powers(px: FloatArray) -> FloatArray:
        """Return the terms (n, 6) at places (n, 2) px."""
        u, v = np.moveaxis(px / 1000.0, -1, 0)
        return np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=-1)


@dataclass(frozen=True, slots=True)
class SpotReference:
    """Figures of a target's calibrated spots.

    ``grain`` is the usual texture contrast, the relative scatter of the light from pixel to pixel (None: not
    known, each spot's own is used); ``misfit_ratio`` the usual chi-square of a good spot's residuals over its
    expectation, above 1 if the texture is coarser than a block; ``pattern_px`` the standard deviation of a
    centre by the texture, predicted from the fit, ``noise_px`` the one observed about the map. ``pattern_px``
    None: not known, nothing is added to the map's noise. ``light`` is None if the exposure of
    the scan is not known. The names are the calibration file's.
    """

    grain: Annotated[float, Field(gt=0, le=10)] | None
    misfit_ratio: Annotated[float, Field(ge=1, le=1000)]
    pattern_px: Annotated[float, Field(ge=0, le=100)] | None
    noise_px: Annotated[float, Field(ge=0, le=100)]
    shape: ShapeReference | None
    light: LightReference | None = None

    @property
    def texture_px(self) -> float:
        """Standard deviation of a centre by the texture, fine and coarse; 0: not known."""
        return (self.pattern_px or 0.0) * math.sqrt(self.misfit_ratio)


UNKNOWN_SPOT = SpotReference(grain=None, misfit_ratio=2.0, pattern_px=None, noise_px=0.0, shape=None)
"""Reference for a calibration made without laser spots, such as one from a plate."""
