from __future__ import annotations

import numpy as np
import pytest
from support.plates import COLUMNS, ROWS, View, grid_mm, tilted

from altd.vision.led_grid import match_grid

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
def test_leds_are_put_in_order_under_tilt_mirror_and_fisheye(
    seed: int, mirrored: bool, fisheye: bool
) -> None:
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
