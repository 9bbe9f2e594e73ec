"""An undetectable disturbance: a spot behind a smear whose transmission slopes evenly; by formulas.

A Gaussian times exp(−s·u) is the same Gaussian elsewhere: exp(−8 u²/d² − s·u) has its middle at −s·d²/16.
"""

from __future__ import annotations

import numpy as np
import pytest
from support.frames import HEIGHT, WIDTH, Blob, frame, light

from altd.records import Spot
from altd.vision.flat import Flat
from altd.vision.localise import locate
from altd.vision.settings import SpotReference

DIAMETER_PX = 44.0
CLEAN_PLATE = SpotReference(grain=0.005, misfit_ratio=1.0, pattern_px=0.005, noise_px=0.006, shape=None)


@pytest.mark.parametrize("slope_per_px", [0.0005, -0.0015, 0.003])
def test_a_spot_behind_an_even_slope_of_transmission_is_the_same_spot_elsewhere(slope_per_px: float) -> None:
    """So no sigma can hold what grease does: nothing but the place differs. docs/reasons.md says how much."""
    middle_u = 371.3
    clean = light(Blob(middle_u, 240.7, DIAMETER_PX))
    passes = np.exp(-slope_per_px * (np.arange(WIDTH) - middle_u))
    even = Flat.of(np.ones((HEIGHT, WIDTH)), "recording")
    spots = []
    for image in (clean, clean * passes):
        found = locate(frame(image, np.random.default_rng(6), 0.5), flat=even, reference=CLEAN_PLATE)
        assert isinstance(found, Spot)
        spots.append(found)
    before, behind = spots
    assert behind.u_px - before.u_px == pytest.approx(-slope_per_px * DIAMETER_PX**2 / 16, abs=0.005)
    assert behind.v_px == pytest.approx(before.v_px, abs=0.005)
    assert behind.sigma_px == pytest.approx(before.sigma_px, rel=0.01)
    assert behind.excess_px == pytest.approx(before.excess_px, abs=0.005)
    assert before.shape is not None
    assert behind.shape is not None
    assert (behind.shape.a, behind.shape.c, behind.shape.order) == pytest.approx(
        (before.shape.a, before.shape.c, before.shape.order), rel=0.002
    )
