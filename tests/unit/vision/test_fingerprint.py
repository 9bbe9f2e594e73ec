"""A view is held against where the picture is known to lie; the print's dots are drawn where it lies."""

from dataclasses import replace

import numpy as np
import pytest
from support.dotted_print import DottedPrint
from support.frames import HEIGHT, WIDTH, Blob, frame, light
from support.led_frames import LEDS, Motion

from altd.records import FloatArray, Frame
from altd.vision.fingerprint import Fingerprint, ViewOutcome, ViewVerdict
from altd.vision.flat import Flat
from altd.vision.frame_analysis import FrameAnalysis
from altd.vision.hot_pixels import HotPixels, places_of
from altd.vision.settings import SpotSettings
from altd.vision.texture import Texture

PRINT = DottedPrint(1)
PLATE = DottedPrint(1, contrast=0.12)
"""With a faint texture."""
CHECKED = Motion(0.5, -0.33, turn_deg=0.1)
"""The result of the last self-check: 0.6 px and 0.1°."""
SPOT = Blob(200.0, 130.0, 60.0, peak=55.0)
HOT = [(40, 50), (700, 60), (90, 420), (300, 30), (620, 440), (200, 200)]


def affine(motion: Motion) -> FloatArray:
    """(2, 3), by where three places go."""
    corners = np.array([(0.0, 0.0), (1000.0, 0.0), (0.0, 1000.0)])
    origin, right, down = motion.of(corners)
    return np.column_stack([(right - origin) / 1000, (down - origin) / 1000, origin])


def seen(
    motion: Motion,
    beside_px: tuple[float, float] = (0.0, 0.0),
    surface: DottedPrint = PRINT,
    spot: Blob = SPOT,
    hot: list[tuple[int, int]] | None = None,
) -> Frame:
    """A spot on a print whose picture moved, and lies further beside that."""
    response = surface.response(lambda places: motion.of(places) + np.array(beside_px))
    image = light(spot) * response
    for u, v in hot or []:
        image[v, u] += 90
    return frame(image, np.random.default_rng(5), noise=1.0)


def verdict(fingerprint: Fingerprint, shown: Frame) -> ViewVerdict:
    return fingerprint.examine(FrameAnalysis(shown, SpotSettings()), has_spot=True)


@pytest.fixture(scope="module")
def calibrated() -> Fingerprint:
    return PRINT.fingerprint()


@pytest.fixture(scope="module")
def moved(calibrated: Fingerprint) -> Fingerprint:
    return replace(calibrated, moved=affine(CHECKED))


def test_a_picture_that_moved_is_refused_until_it_is_known_where_it_lies(
    calibrated: Fingerprint, moved: Fingerprint
) -> None:
    shown = seen(CHECKED)
    assert verdict(calibrated, shown).outcome is ViewOutcome.REFUTED
    there = verdict(moved, shown)
    assert there.outcome is ViewOutcome.VERIFIED
    assert there.shift_px < 0.03
    assert there.displaced_px == pytest.approx(0.0, abs=0.02)


def test_a_shift_that_was_known_in_part_adds_what_is_left_of_it(calibrated: Fingerprint) -> None:
    """A picture aside by 0.3 px, of which a check found all, or all but a fifth of a pixel."""
    shown = seen(Motion(0.3))
    for known_px, left_px in ((0.0, 0.3), (0.1, 0.2), (0.3, 0.0)):
        found = verdict(replace(calibrated, moved=affine(Motion(known_px))), shown)
        assert found.outcome is ViewOutcome.VERIFIED
        assert found.displaced_px == pytest.approx(left_px, abs=0.03)


@pytest.mark.parametrize(
    ("aside_px", "max_shift_px", "outcome"),
    [
        (0.3, 0.2, ViewOutcome.REFUTED),
        (0.3, 0.4, ViewOutcome.VERIFIED),
        (0.6, 0.4, ViewOutcome.REFUTED),
        (0.6, 0.8, ViewOutcome.VERIFIED),
    ],
    ids=["half the resolution", "as usual", "as usual, farther", "twice the resolution"],
)
def test_how_far_a_picture_may_lie_aside_is_the_callers(
    calibrated: Fingerprint, aside_px: float, max_shift_px: float, outcome: ViewOutcome
) -> None:
    shown = FrameAnalysis(seen(Motion(aside_px)), SpotSettings())
    assert replace(calibrated, max_shift_px=max_shift_px).examine(shown, True).outcome is outcome


def _of_dim_frames(fingerprint: Fingerprint, motion: Motion, count: int) -> list[ViewVerdict]:
    """Of frames in a row with little light, each with noise of its own, as the daemon examines them."""
    image = light(replace(SPOT, peak=4.0)) * PLATE.response(motion.of)
    found: list[ViewVerdict] = []
    for seed in range(count):
        shown = FrameAnalysis(frame(image, np.random.default_rng(seed), noise=0.7), SpotSettings())
        earlier = [each.faint for each in found if each.faint is not None]
        found.append(fingerprint.examine(shown, True, earlier))
    return found


def test_dim_frames_that_decide_nothing_alone_refute_a_moved_view_together() -> None:
    """A camera that was turned while the laser became dim gave 0.064° of error, marked valid."""
    found = _of_dim_frames(PLATE.fingerprint(), Motion(1.2), 8)
    refuted = [each for each in found if each.outcome is ViewOutcome.REFUTED]
    assert len(refuted) >= 3
    assert [each.shift_px for each in refuted] == pytest.approx([1.2] * len(refuted), abs=0.15)
    others = [each for each in found if each.outcome is not ViewOutcome.REFUTED]
    assert {each.outcome for each in others} == {ViewOutcome.UNDECIDED}
    measured = [each.displaced_px for each in others if each.displaced_px is not None]
    assert measured  # a shift that is measured, though uncertain, adds to sigma
    assert min(measured) > 0.5


def test_dim_frames_that_decide_nothing_alone_verify_a_view_together() -> None:
    found = _of_dim_frames(PLATE.fingerprint(), Motion(), 8)
    assert found[0].outcome is ViewOutcome.UNDECIDED
    assert ViewOutcome.REFUTED not in {each.outcome for each in found}
    assert found[-1].outcome is ViewOutcome.VERIFIED
    assert found[-1].displaced_px == pytest.approx(0.0, abs=0.1)


def test_dim_frames_are_not_kept_for_a_texture_that_refutes_nothing() -> None:
    """Most plates show none, whatever the light: to stack their frames would cost time for no verdict."""
    found = _of_dim_frames(replace(PLATE.fingerprint(), source="scan"), Motion(), 2)
    assert [(each.outcome, each.faint) for each in found] == [(ViewOutcome.UNDECIDED, None)] * 2


@pytest.mark.parametrize("beside_px", [(0.3, 0.0), (0.0, -0.2), (-0.2, 0.2)])
def test_a_small_shift_since_then_is_uncertainty(moved: Fingerprint, beside_px: tuple[float, float]) -> None:
    found = verdict(moved, seen(CHECKED, beside_px))
    assert found.outcome is ViewOutcome.VERIFIED
    assert found.displaced_px == pytest.approx(np.hypot(*beside_px), rel=0.1)


@pytest.mark.parametrize("shift_px", [(0.3, 0.0), (0.0, -0.25), (-0.2, 0.15)])
def test_a_small_shift_of_texture_as_fine_as_the_pixels_is_found_whole(shift_px: tuple[float, float]) -> None:
    """A parabola through three lags found a third of these."""
    grain = np.random.default_rng(7).normal(1.0, 0.12, (HEIGHT, WIDTH))
    fingerprint = replace(PRINT.fingerprint(), texture=Texture.of_flat(Flat.from_response(grain, "plate")))
    aside = grain
    for axis, part in zip((1, 0), shift_px, strict=True):  # each pixel averages the two that it lies on
        aside = (1 - abs(part)) * aside + abs(part) * np.roll(aside, int(np.sign(part)), axis)
    found = verdict(fingerprint, frame(light(SPOT) * aside, np.random.default_rng(5), noise=1.0))
    assert found.outcome is ViewOutcome.VERIFIED
    assert found.shift_px == pytest.approx(np.hypot(*shift_px), abs=0.03)


@pytest.mark.parametrize("beside_px", [(0.45, 0.0), (-0.35, -0.35), (0.0, 1.5)])
def test_a_large_shift_since_then_is_another_view(moved: Fingerprint, beside_px: tuple[float, float]) -> None:
    found = verdict(moved, seen(CHECKED, beside_px))
    assert found.outcome is ViewOutcome.REFUTED
    assert found.shift_px == pytest.approx(np.hypot(*beside_px), abs=0.05)
    assert "from where the self-check found it" in found.reason


@pytest.mark.parametrize(
    ("motion", "surface"),
    [
        (Motion(), PRINT),
        *((CHECKED, DottedPrint(n)) for n in (2, 3, 4)),
        (CHECKED, DottedPrint(1, contrast=0.0)),
    ],
    ids=["back where it was calibrated", "print 2", "print 3", "print 4", "no print"],
)
def test_a_picture_that_went_back_another_print_and_a_plate_without_stay_refused(
    moved: Fingerprint, motion: Motion, surface: DottedPrint
) -> None:
    assert verdict(moved, seen(motion, surface=surface)).outcome is ViewOutcome.REFUTED


def test_a_mirrored_picture_stays_refused(moved: Fingerprint) -> None:
    shown = seen(CHECKED)
    mirrored = replace(shown, pixels=np.ascontiguousarray(shown.pixels[:, ::-1]))
    assert verdict(moved, mirrored).outcome is ViewOutcome.REFUTED


def test_hot_pixels_stay_where_the_sensor_has_them(moved: Fingerprint) -> None:
    of_sensor = replace(moved, hot=HotPixels(places_of(HOT), places_of([])))
    assert verdict(of_sensor, seen(CHECKED, hot=HOT)).is_same_sensor
    aside = [(u + 3, v - 2) for u, v in HOT]
    with_the_picture = verdict(of_sensor, seen(CHECKED, hot=aside))
    assert with_the_picture.outcome is ViewOutcome.REFUTED
    assert with_the_picture.is_other_sensor


def test_at_the_border_only_what_is_known_of_the_print_counts(calibrated: Fingerprint) -> None:
    """The picture moved inwards: what comes into it at the edge was never seen."""
    inwards = Motion(2.5, 2.0)
    corner = Blob(26.0, 24.0, 48.0, peak=55.0)
    known = replace(calibrated, moved=affine(inwards))
    found = verdict(known, seen(inwards, spot=corner))
    assert found.outcome is ViewOutcome.VERIFIED
    assert found.displaced_px == pytest.approx(0.0, abs=0.02)
    assert verdict(known, seen(inwards, (0.6, 0.0), spot=corner)).outcome is ViewOutcome.REFUTED


def test_where_the_print_moved_away_from_nothing_is_verified(calibrated: Fingerprint) -> None:
    """It is known in one half of the picture, and too little of that is left under the spot."""
    relative = calibrated.texture.relative.copy()
    relative[:, 200:] = 0
    half = replace(calibrated, texture=replace(calibrated.texture, relative=relative))
    assert verdict(half, seen(Motion())).outcome is ViewOutcome.VERIFIED
    away = Motion(-26.0)
    found = verdict(replace(half, moved=affine(away)), seen(away))
    assert found.outcome is ViewOutcome.UNDECIDED
    assert (found.shift_px, found.displaced_px) == (None, None)


def test_a_texture_of_the_scan_moves_likewise_and_refuses_nothing(calibrated: Fingerprint) -> None:
    of_scan = replace(calibrated, source="scan")
    shown = seen(CHECKED)
    assert verdict(of_scan, shown).outcome is ViewOutcome.UNDECIDED
    there = verdict(replace(of_scan, moved=affine(CHECKED)), shown)
    assert there.outcome is ViewOutcome.VERIFIED
    assert there.shift_px < 0.03
    assert there.displaced_px is None


def test_the_motions_of_this_test_turn_about_the_leds() -> None:
    """The reference of ``affine``."""
    there = affine(CHECKED) @ np.column_stack([LEDS, np.ones(len(LEDS))]).T
    assert pytest.approx(CHECKED.of(LEDS), abs=1e-6) == there.T
