from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from support.frames import HEIGHT, WIDTH, Blob, frame, light

from altd.vision.frame_leds import Leds, locate_leds

PLACES = [(95.4, 60.2), (110.1, 410.7), (371.5, 430.3), (376.2, 28.6), (627.9, 412.2), (647.3, 59.8)]


def discs(radius_px: float = 9.0, places: Sequence[tuple[float, float]] = PLACES) -> np.ndarray:
    """Evenly bright discs with an edge one pixel wide."""
    v, u = np.mgrid[:HEIGHT, :WIDTH].astype(float)
    image = np.zeros((HEIGHT, WIDTH))
    for x, y in places:
        image += 190 * np.clip(radius_px - np.hypot(u - x, v - y) + 0.5, 0, 1)
    return image


@pytest.mark.parametrize("laser", [True, False])
def test_all_leds_are_found_at_their_places_with_and_without_the_laser(laser: bool) -> None:
    rng = np.random.default_rng(1)
    scene = light(Blob(340, 230)) if laser else light()
    found = locate_leds(frame(scene + discs(), rng), frame(scene, rng))
    assert found.rejected == ()
    assert [(s.u_px, s.v_px) for s in found.spots] == [pytest.approx(place, abs=0.06) for place in PLACES]


def test_lamps_that_stay_dark_give_no_led() -> None:
    rng = np.random.default_rng(2)
    scene = light(Blob(340, 230))
    assert locate_leds(frame(scene, rng), frame(scene, rng)) == Leds((), ())


@pytest.mark.parametrize("edge_px", [12.0, 9.0, 6.0, 3.0])
@pytest.mark.parametrize("border", ["left", "top", "right", "bottom"])
def test_an_led_that_the_border_cuts_is_where_its_whole_disc_would_be(border: str, edge_px: float) -> None:
    """12 px from the border it is whole and its smoothed foot is not; 3 px: a third of it is missing."""
    cut = {
        "left": (edge_px, 200.3),
        "top": (300.4, edge_px),
        "right": (WIDTH - 1 - edge_px, 200.3),
        "bottom": (300.4, HEIGHT - 1 - edge_px),
    }[border]
    rng = np.random.default_rng(3)
    scene = light(Blob(340, 230))
    found = locate_leds(frame(scene + discs(places=[*PLACES, cut]), rng), frame(scene, rng))
    assert found.rejected == ()
    assert min(np.hypot(s.u_px - cut[0], s.v_px - cut[1]) for s in found.spots) < 0.06
    assert len(found.spots) == len(PLACES) + 1


def test_an_led_of_which_too_little_is_left_is_named() -> None:
    rng = np.random.default_rng(4)
    scene = light()
    found = locate_leds(frame(scene + discs(places=[*PLACES, (200.0, -2.0)]), rng), frame(scene, rng))
    assert len(found.spots) == len(PLACES)
    (line,) = found.rejected
    assert line.startswith("LED at u 200 v ")
    assert "cut_by_edge" in line


def test_a_reflection_at_the_border_that_is_no_led_is_named() -> None:
    rng = np.random.default_rng(5)
    scene, streak = light(), np.zeros((HEIGHT, WIDTH))
    streak[:5, 500:580] = 190.0
    found = locate_leds(frame(scene + discs() + streak, rng), frame(scene, rng))
    assert len(found.spots) == len(PLACES)
    assert len(found.rejected) == 1
