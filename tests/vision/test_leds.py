from __future__ import annotations

import numpy as np
import pytest
from support.frames import HEIGHT, WIDTH, Blob, frame, light

from altd.vision.leds import locate_leds

PLACES = [(95.4, 60.2), (110.1, 410.7), (371.5, 430.3), (376.2, 28.6), (627.9, 412.2), (647.3, 59.8)]


def discs(radius_px: float = 9.0) -> np.ndarray:
    """Evenly bright discs with an edge one pixel wide."""
    v, u = np.mgrid[:HEIGHT, :WIDTH].astype(float)
    image = np.zeros((HEIGHT, WIDTH))
    for x, y in PLACES:
        image += 190 * np.clip(radius_px - np.hypot(u - x, v - y) + 0.5, 0, 1)
    return image


@pytest.mark.parametrize("laser", [True, False])
def test_all_leds_are_found_at_their_places_with_and_without_the_laser(laser: bool) -> None:
    rng = np.random.default_rng(1)
    scene = light(Blob(340, 230)) if laser else light()
    spots = locate_leds(frame(scene + discs(), rng), frame(scene, rng))
    assert [(s.u_px, s.v_px) for s in spots] == [pytest.approx(place, abs=0.06) for place in PLACES]


def test_lamps_that_stay_dark_give_no_led() -> None:
    rng = np.random.default_rng(2)
    scene = light(Blob(340, 230))
    assert locate_leds(frame(scene, rng), frame(scene, rng)) == ()
