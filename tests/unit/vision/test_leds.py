from collections.abc import Sequence

import cv2
import numpy as np
import pytest
from support.frames import HEIGHT, WIDTH, Blob, frame, light
from support.plates import COLUMNS, ROWS, View, add_disc, grid_mm, plate_light, tilted

from altd.mapping.camera_model import disc_moment_mm2, light_centre_shift_px
from altd.vision.frame_leds import LocatedLeds, locate_leds
from altd.vision.led_discs import disc_centres_px, find_discs
from altd.vision.led_grid import match_grid

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


LEDS_MM = grid_mm().reshape(-1, 2)


def view(seed: int, mirrored: bool, fisheye: bool) -> View:
    """Up to 30° of tilt and 10° of roll."""
    rng = np.random.default_rng(seed)
    turn = tilted(rng.uniform(20, 30), rng.uniform(0, 2 * np.pi), rng.uniform(-10, 10))
    if fisheye:
        return View(600.0, 160.0, turn, (rng.uniform(-0.03, 0.01), 0.0, 0.0, 0.0), True, mirrored)
    return View(950.0, 330.0, turn, mirrored=mirrored)


def matched(
    seen: View, dark: tuple[int, ...] = (), false_px: np.ndarray | None = None, mirrored: bool | None = None
) -> np.ndarray:
    """Which LED the matching takes each for (35,): itself, −1 for none, −2 for a false light."""
    rng = np.random.default_rng(1)
    lit = np.setdiff1d(np.arange(len(LEDS_MM)), dark)
    points = seen.to_px(LEDS_MM)[lit] + rng.normal(0, 0.1, (len(lit), 2))
    known = lit
    if false_px is not None:
        points, known = np.vstack([points, false_px]), np.append(lit, np.full(len(false_px), -2))
    order = rng.permutation(len(points))
    match = match_grid(points[order], COLUMNS, ROWS, seen.mirrored if mirrored is None else mirrored)
    rows = match.rows_of.ravel()
    assert sorted([*rows[rows >= 0], *match.extra]) == list(range(len(points)))
    return np.where(rows >= 0, known[order][rows], -1)


@pytest.mark.parametrize("fisheye", [False, True])
@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("seed", range(5))
def test_leds_are_put_in_order_under_tilt_mirror_fisheye(seed: int, mirrored: bool, fisheye: bool) -> None:
    assert list(matched(view(seed, mirrored, fisheye))) == list(range(35))


@pytest.mark.parametrize(
    "dark",
    [(17, 18), (0, 34), (6, 28), (0, 1), (0, 7), (5, 6, 13), (0, 1, 7, 8), (27, 34, 33), (3, 10, 17, 24)],
    ids=str,
)
@pytest.mark.parametrize("fisheye", [False, True])
def test_dark_leds_leave_the_others_their_places(dark: tuple[int, ...], fisheye: bool) -> None:
    for seed in range(2):
        expected = [-1 if led in dark else led for led in range(35)]
        assert list(matched(view(seed, seed % 2 == 0, fisheye), dark)) == expected


def test_false_lights_do_not_shift_the_grid() -> None:
    rng = np.random.default_rng(5)
    for seed in range(8):
        false_px = rng.uniform((0, 0), (752, 480), (5, 2))
        taken = matched(view(seed, False, seed % 2 == 0), (0, 20), false_px)
        assert all(led in (own, -2, -1) for own, led in enumerate(taken))
        assert np.count_nonzero(taken == np.arange(35)) >= 32


def test_a_light_where_the_next_column_would_be_is_left_out() -> None:
    seen = view(3, False, False)
    beyond = seen.to_px(np.array([[100.0, 0.0]]))
    assert list(matched(seen, (0, 7), beyond)) == [-1 if led in (0, 7) else led for led in range(35)]


def test_a_whole_dark_line_at_the_edge_is_refused() -> None:
    for line in ((0, 7, 14, 21, 28), tuple(range(28, 35))):
        with pytest.raises(ValueError, match="where they belong in it is unknown"):
            matched(view(1, True, False), line)


def test_a_plate_that_does_not_stand_upright_is_refused() -> None:
    with pytest.raises(ValueError, match=r"turned by -?4\d° in the picture; it must be upright"):
        matched(View(950.0, 400.0, tilted(5.0, 1.0, 43.0)))
    with pytest.raises(ValueError, match="form 5 × 7 in the picture, the plate has 7 × 5"):
        matched(View(750.0, 400.0, tilted(5.0, 1.0, 90.0)))


def test_lights_that_are_no_grid_are_refused() -> None:
    scattered = np.random.default_rng(1).uniform(0, 480, (30, 2))
    with pytest.raises(ValueError, match=r"of 30 lights only [0-9]+ lie on a grid"):
        match_grid(scattered, COLUMNS, ROWS, mirrored=False)
    with pytest.raises(ValueError, match="of 2 lights only"):
        match_grid(scattered[:2], COLUMNS, ROWS, mirrored=False)


def test_the_side_is_what_the_camera_is_said_to_see() -> None:
    """A full grid looks alike from both sides: nothing in the picture can tell."""
    seen = View(950.0, 400.0, mirrored=True)
    assert matched(seen, (0,))[0] == -1
    assert matched(seen, (0,), mirrored=False)[6] == -1


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
    assert locate_leds(frame(scene, rng), frame(scene, rng)) == LocatedLeds((), ())


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
