"""Statistics of a target's spots at its calibration, with which later spots are compared."""

from __future__ import annotations

from dataclasses import dataclass

ShapeVector = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True)
class ShapeReference:
    """Mean and standard deviation of a spot's shape over a target, in the unit frame.

    Logarithm of the mean 1/e² radius in mm, two components of the stretch, and the profile's order, as
    ``altd.measuring.spot_shape.shape_in_mm`` gives them.
    """

    mean: ShapeVector
    sigma: ShapeVector


@dataclass(frozen=True, slots=True)
class SpotReference:
    """Figures of a target's calibrated spots.

    ``grain`` is the usual texture contrast, the relative scatter of the light from pixel to pixel (None: not
    known, each spot's own is taken); ``misfit_ratio`` the usual chi-square of a good spot's residuals over
    its expectation, above 1 where the texture is coarser than a block; ``pattern_px`` the standard deviation
    of a centre by the texture, predicted from the fit, ``noise_px`` the one observed about the map.
    ``pattern_px`` None: not known, nothing is added to the map's noise. The names are the calibration file's.
    """

    grain: float | None
    misfit_ratio: float
    pattern_px: float | None
    noise_px: float
    shape: ShapeReference | None


UNKNOWN_SPOT = SpotReference(grain=None, misfit_ratio=2.0, pattern_px=None, noise_px=0.0, shape=None)
"""For a calibration that no laser spots were used for, such as one from a plate."""
