"""What a target's spots were like when it was calibrated: what later spots are held against."""

from __future__ import annotations

from dataclasses import dataclass

Four = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True)
class ShapeReference:
    """Mean and standard deviation of a spot's shape over a target, in the unit frame.

    Logarithm of the mean 1/e² radius in mm, two components of the stretch, and the profile's order, as
    ``altd.measuring.spot_shape.shape_in_mm`` gives them.
    """

    mean: Four
    sigma: Four


@dataclass(frozen=True, slots=True)
class SpotReference:
    """Figures of a target's calibrated spots.

    ``grain`` is the usual relative scatter of the light from pixel to pixel (None: not known, a spot is held
    against its own); ``misfit_ratio`` how much of chi-square a good spot's residuals usually make, above 1
    where grain is coarser than a block; ``pattern_px`` what the grain does to a centre, predicted from the
    fit, while ``noise_px`` is what it really does about the map. None of both: the map's noise holds it.
    """

    grain: float | None
    misfit_ratio: float
    pattern_px: float | None
    noise_px: float
    shape: ShapeReference | None


UNKNOWN_SPOT = SpotReference(grain=None, misfit_ratio=2.0, pattern_px=None, noise_px=0.0, shape=None)
"""For a calibration that no laser spots were used for, such as one from a plate."""
