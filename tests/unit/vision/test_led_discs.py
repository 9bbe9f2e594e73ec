from __future__ import annotations

import cv2
import numpy as np
import pytest
from support.frames import HEIGHT, WIDTH, Blob, light
from support.plates import View, add_disc, grid_mm, plate_light, tilted

from altd.mapping.camera_model import disc_moment_mm2, light_centre_shift_px
from altd.vision.led_discs import disc_centres_px, find_discs

ORDINARY = View(1333.0, 420.0, tilted(12.0, 1.0, 2.0))
TILTED = View(950.0, 340.0, tilted(30.0, 2.5), mirrored=True)
FISHEYE = View(600.0, 160.0, tilted(30.0, 0.4), (-0.02, 0.0, 0.0, 0.0), fisheye=True)


def found_px(image: np.ndarray) -> np.ndarray:
    return np.array([(disc.u_px, disc.v_px) for disc in find_discs(image.astype(np.float32)).found])


def misses_px(view: View, image: np.ndarray) -> np.ndarray:
    """By how much each found disc misses the shifted place of the nearest LED."""
    places = grid_mm().reshape(-1, 2)
    true = view.to_px(places) + light_centre_shift_px(view.to_px, places, disc_moment_mm2(5.0))
    found = found_px(image)
    nearest = np.array([np.linalg.norm(true - at, axis=1).argmin() for at in found])
    assert sorted(nearest) == list(range(35))
    return np.asarray(found - true[nearest])


@pytest.mark.parametrize("view", [ORDINARY, TILTED, FISHEYE], ids=["ordinary", "tilted", "fisheye"])
def test_centres_are_found_to_a_hundredth_of_a_pixel(view: View) -> None:
    picture = plate_light(view)
    assert np.sqrt(np.mean(misses_px(view, picture) ** 2)) < 0.006
    noisy = picture + np.random.default_rng(1).normal(0, 2.0, picture.shape)
    assert np.sqrt(np.mean(misses_px(view, noisy) ** 2)) < 0.012


def test_light_that_falls_off_across_a_disc_does_not_move_it() -> None:
    falling = np.exp(-np.abs(np.arange(WIDTH) - 350) / 150)  # twice what f = 3.6 does in its corners
    misses = misses_px(ORDINARY, plate_light(ORDINARY) * falling)
    assert np.sqrt(np.mean(misses**2)) < 0.01
    radius_px = 8.0
    assert radius_px**2 / 4 / 150.0 > 0.1  # error of the plain moment of the light


def test_what_is_no_disc_is_rejected_with_its_place() -> None:
    scene = plate_light(ORDINARY)
    scene += light(Blob(200.0, 60.0, 40.0, peak=120.0))  # a glow
    cv2.line(scene, (300, 40), (420, 44), 150.0, 4)  # a streak
    cv2.ellipse(scene, (560, 45), (16, 16), 0, 0, 250, 150.0, 5)  # a broken ring
    scene[20:22, 100:102] += 200  # a few hot pixels
    scene[300, 500] += 200
    seen = find_discs(scene.astype(np.float32))
    assert len(seen.found) == 35
    told = " ".join(seen.rejected)
    assert "(200, 60) px has no edge: a glow" in told
    assert "is not a disc: aspect ratio" in told
    assert len(seen.rejected) == 3


def test_leds_that_are_all_soft_are_leds() -> None:
    places = ORDINARY.to_px(grid_mm().reshape(-1, 2))
    scene = light(*(Blob(u, v, 24.0, peak=150.0) for u, v in places))
    found = np.array(sorted(found_px(scene).tolist()))
    assert np.abs(found - np.array(sorted(places.tolist()))).max() < 0.03


def test_a_disc_that_the_edge_cuts_is_told_as_such() -> None:
    scene = np.zeros((HEIGHT, WIDTH))
    for x in (-118.0, 0.0, 118.0):
        add_disc(scene, View(1333.0, 420.0, distortion=(0.0,) * 5), np.array([x, 0.0]), 5.0, 150.0)
    seen = find_discs(scene.astype(np.float32)).found
    assert sorted((int(disc.u_px), disc.is_cut) for disc in seen) == [(3, True), (375, False), (747, True)]


def test_an_unlit_plate_shows_nothing() -> None:
    noise = np.random.default_rng(2).normal(0, 1.5, (HEIGHT, WIDTH))
    assert find_discs(noise.astype(np.float32)).found == ()


def test_a_disc_that_is_dark_in_another_exposure_has_no_centre_there() -> None:
    picture = plate_light(ORDINARY)
    discs = find_discs(picture.astype(np.float32)).found
    without = plate_light(ORDINARY, dark=[(3, 2)])
    centres = disc_centres_px(without.astype(np.float32), discs)
    gone = np.isnan(centres[:, 0])
    middle = ORDINARY.to_px(np.zeros((1, 2)))[0]
    assert gone.sum() == 1
    assert (discs[int(gone.argmax())].u_px, discs[int(gone.argmax())].v_px) == pytest.approx(middle, abs=0.5)
    same = np.array([(disc.u_px, disc.v_px) for disc in discs])
    assert np.abs(centres - same)[~gone].max() < 1e-6
