import math
from dataclasses import replace

import numpy as np
import pytest
from support.frames import Blob
from support.led_frames import LEDS, LEVEL, Motion, Scene, unit

from altd.selfcheck.records import DriftLimits, LedState, LedView, SelfCheck, Verdict
from altd.selfcheck.verdict import judge

MIDDLE = (375.0, 240.0)
"""The pixel at which the straight maps have x = y = 0."""


def check(
    front: Scene | LedView, rear: Scene | LedView | None = None, seed: int = 1, **options: object
) -> SelfCheck:
    rng = np.random.default_rng(seed)
    rear = rear or Scene()
    views = {
        name: scene.view(rng) if isinstance(scene, Scene) else scene
        for name, scene in (("front", front), ("rear", rear))
    }
    calibration = options.pop("calibration", None) or unit()
    limits = options.pop("limits", DriftLimits())
    return judge(views, calibration, {"front": MIDDLE, "rear": MIDDLE}, limits, **options)  # type: ignore[arg-type]


def test_a_unit_that_stands_as_it_was_calibrated_is_good() -> None:
    for seed in range(5):
        found = check(Scene(), seed=seed)
        assert found.verdict is Verdict.GOOD, found.reasons
        assert found.reasons == ()
        for drift in found.targets.values():
            assert drift.leds_found == drift.leds_expected == 6
            assert drift.similarity.shift_px == pytest.approx((0, 0), abs=0.01)


@pytest.mark.parametrize(
    "motion", [Motion(0.3), Motion(0, -0.3), Motion(turn_deg=0.05), Motion(turn_deg=-0.05)]
)
@pytest.mark.parametrize(
    "levels", [(LEVEL,) * 6, (LEVEL, 0, LEVEL, LEVEL, LEVEL, 0.25 * LEVEL)], ids=["all", "dark and dim"]
)
def test_a_small_drift_is_found_in_one_check(motion: Motion, levels: tuple[float, ...]) -> None:
    found = check(Scene(motion, levels))
    assert found.verdict is Verdict.SUSPECT
    drift = found.targets["front"]
    assert drift.significance > 10
    assert drift.similarity.shift_px == pytest.approx((motion.u_px, motion.v_px), abs=0.02)
    assert drift.similarity.turn_deg == pytest.approx(motion.turn_deg, abs=0.003)
    assert found.targets["rear"].significance < 6  # type: ignore[operator]


def test_the_effect_has_the_sign_and_size_of_measured_minus_true() -> None:
    """4 px/mm; the front camera sees x mirrored, v runs down: 0.4 px right and down are −0.1 and −0.1 mm."""
    found = check(Scene(Motion(0.4, 0.4)))
    turned = math.degrees(math.atan(0.1 / 280))
    expected = {"x_mm": -0.1, "y_mm": -0.1, "yaw_deg": turned, "pitch_deg": turned}
    for key, value in expected.items():
        effect = found.effects[key]
        assert effect.value == pytest.approx(value, abs=max(3 * effect.sigma, 0.02 * abs(value)))
        assert 0 < effect.sigma < 0.05 * abs(value)
    at_the_rear = check(Scene(), Scene(Motion(0.4, 0.4)), reference_plane_mm=280.0)
    assert at_the_rear.effects["x_mm"].value == pytest.approx(0.1, abs=0.005)
    assert at_the_rear.effects["yaw_deg"].value == pytest.approx(turned, abs=0.001)


def test_a_turn_counts_where_the_beam_is_not_though_it_does_nothing_where_it_is() -> None:
    found = check(Scene(Motion(turn_deg=0.05)))
    middle = LEDS.mean(axis=0)
    assert np.hypot(*(middle - MIDDLE)) < 10
    assert abs(found.effects["x_mm"].value) < 0.005
    assert found.verdict is Verdict.SUSPECT


@pytest.mark.parametrize(
    ("shift_px", "verdict"),
    [
        (0.04, Verdict.GOOD),
        (0.25, Verdict.SUSPECT),
        (1.0, Verdict.BAD),
        (30.0, Verdict.BAD),
        (42.0, Verdict.BAD),
        (90.0, Verdict.BAD),
    ],
)
def test_limits_are_of_the_measurement(shift_px: float, verdict: Verdict) -> None:
    assert check(Scene(Motion(shift_px))).verdict is verdict


@pytest.mark.parametrize(
    "motion", [Motion(turn_deg=7.0), Motion(turn_deg=179.0), Motion(scale_ppm=-80_000)], ids=str
)
def test_a_camera_that_stands_quite_otherwise_is_bad_and_not_unknown(motion: Motion) -> None:
    found = check(Scene(motion))
    assert found.verdict is Verdict.BAD
    assert found.targets["front"].similarity.turn_deg == pytest.approx(motion.turn_deg, abs=0.01)


def test_wider_limits_in_mm_and_degrees_let_the_same_drift_pass() -> None:
    wide = DriftLimits(suspect_mm=0.2, suspect_deg=0.05, bad_mm=0.5, bad_deg=0.1)
    assert check(Scene(Motion(0.25)), limits=wide).verdict is Verdict.GOOD
    of_direction = replace(wide, suspect_deg=0.01)
    assert check(Scene(Motion(0.25)), limits=of_direction).verdict is Verdict.SUSPECT


def test_a_verdict_ends_only_below_a_share_of_its_limit() -> None:
    only_mm = DriftLimits(suspect_deg=9, bad_deg=9)
    just_below = Scene(Motion(0.11))  # 0.0275 mm of 0.030
    assert check(just_below, limits=only_mm).verdict is Verdict.GOOD
    for previous in (Verdict.SUSPECT, Verdict.BAD):
        assert check(just_below, limits=only_mm, previous=previous).verdict is Verdict.SUSPECT
    assert check(Scene(Motion(0.08)), limits=only_mm, previous=Verdict.SUSPECT).verdict is Verdict.GOOD
    below_bad = Scene(Motion(0.36))  # 0.090 mm of 0.100
    assert check(below_bad, limits=only_mm).verdict is Verdict.SUSPECT
    assert check(below_bad, limits=only_mm, previous=Verdict.BAD).verdict is Verdict.BAD


def test_too_few_leds_are_unknown_whatever_the_others_show() -> None:
    two = (LEVEL, 0, 0, LEVEL, 0, 0)
    found = check(Scene(levels=two))
    assert found.verdict is Verdict.UNKNOWN
    assert found.effects == {}
    assert found.targets["front"].leds_found == 2
    assert found.targets["front"].similarity is None
    assert "2 of 6 LEDs can be used" in found.reasons[0]
    assert check(Scene(levels=two), Scene(Motion(2.0))).verdict is Verdict.BAD


def test_a_bad_verdict_is_not_ended_by_a_check_that_sees_but_a_part() -> None:
    """The front was bad and is dark now; that the rear is no more than suspect says nothing of it."""
    dark, moved = Scene(levels=(0,) * 6), Scene(Motion(0.25))
    found = check(dark, moved)
    assert (found.verdict, found.is_whole) == (Verdict.SUSPECT, False)
    assert check(dark, moved, previous=Verdict.SUSPECT).verdict is Verdict.SUSPECT
    assert check(dark, moved, previous=Verdict.BAD).verdict is Verdict.UNKNOWN
    assert check(dark, Scene(Motion(2.0)), previous=Verdict.BAD).verdict is Verdict.BAD
    whole = check(Scene(), moved, previous=Verdict.BAD)
    assert (whole.verdict, whole.is_whole) == (Verdict.SUSPECT, True)


def test_an_led_that_is_elsewhere_does_not_hide_that_the_others_tell_too_little() -> None:
    """The picture vibrates by 0.1 mm, and LED 4 is not where the others' motion puts it."""
    rng = np.random.default_rng(5)
    shaken = [Scene(Motion(*rng.normal(0, 0.4, 2))).view(rng, 1) for _ in range(4)]
    trembling = LedView(tuple(v.lit[0] for v in shaken), tuple(v.dark[0] for v in shaken))
    known = unit()
    moved = LEDS.copy()
    moved[3] += (6.0, 0.0)
    elsewhere = replace(known, targets=(replace(known.targets[0], leds_px=moved), known.targets[1]))
    found = check(trembling, calibration=elsewhere)
    assert found.targets["front"].leds[3] is LedState.DISPLACED
    assert (found.verdict, found.is_whole) == (Verdict.SUSPECT, False)
    assert check(trembling, calibration=elsewhere, previous=Verdict.BAD).verdict is Verdict.UNKNOWN


def test_leds_so_dim_in_noise_that_the_limit_is_not_known_are_unknown_not_good() -> None:
    tight = DriftLimits(suspect_mm=0.0005)
    assert check(Scene(), limits=tight).verdict is Verdict.UNKNOWN


@pytest.mark.parametrize(
    ("always_lit", "state"), [((0.0,) * 6, LedState.DARK), ((LEVEL,) * 6, LedState.ALWAYS_LIT)]
)
def test_all_dark_and_leds_that_cannot_be_switched_off_are_unknown_and_named(
    always_lit: tuple[float, ...], state: LedState
) -> None:
    found = check(Scene(levels=(0,) * 6, always_lit=always_lit))
    assert found.verdict is Verdict.UNKNOWN
    assert found.targets["front"].leds == (state,) * 6
    assert "no LED can be used" in found.reasons[0]


def test_an_led_under_the_spot_is_hidden_and_does_no_harm() -> None:
    near = Blob(float(LEDS[0, 0]) + 14, float(LEDS[0, 1]) + 6, peak=200.0)
    found = check(Scene(spot=near))
    assert found.verdict is Verdict.GOOD, found.reasons
    assert found.targets["front"].leds[0] is LedState.HIDDEN
    assert found.targets["front"].leds_found == 5


@pytest.mark.parametrize("right_px", [30.0, 36.0, 42.0])
def test_the_faint_rim_of_a_spot_over_leds_near_full_scale_moves_nothing(right_px: float) -> None:
    """An LED of 243 counts on 8 has 4 left; what the rim adds beyond is cut off on its side."""
    near = Blob(float(LEDS[0, 0]) + right_px, float(LEDS[0, 1]), peak=200.0)
    found = check(Scene(levels=(243.0,) * 6, spot=near))
    assert found.verdict is Verdict.GOOD, found.reasons
    assert found.targets["front"].leds_found >= 5


def test_an_led_that_the_edge_cuts_is_left_out() -> None:
    """The picture moves up by 19 px: the upper middle LED is cut."""
    found = check(Scene(Motion(0, -19)))
    drift = found.targets["front"]
    assert drift.leds[1] is LedState.CUT
    assert drift.similarity.shift_px == pytest.approx((0, -19), abs=0.02)
    assert found.verdict is Verdict.BAD


@pytest.mark.parametrize("level", [0.5 * LEVEL, 235.0])
def test_reflections_are_named_and_change_nothing(level: float) -> None:
    places = ((250.0, 120.0), (500.3, 300.6))
    found = check(Scene(reflections=places, reflection_level=level))
    assert found.verdict is Verdict.GOOD, found.reasons
    drift = found.targets["front"]
    assert sorted(drift.foreign_px) == [pytest.approx(place, abs=0.5) for place in sorted(places)]
    assert "a light that is not an LED shines with the LEDs at u 250 v 120 px" in drift.detail


def test_a_light_that_blinks_by_itself_is_named() -> None:
    rng = np.random.default_rng(3)
    quiet, blink = Scene().view(rng, 3), Scene(reflections=((500.0, 300.0),)).view(rng, 3)
    found = check(LedView((*quiet.lit[:2], blink.lit[2]), quiet.dark))
    assert found.verdict is Verdict.GOOD, found.reasons
    assert "shines without the LEDs at u 500 v 300 px" in found.targets["front"].detail


def test_an_led_that_shines_in_some_pairs_only_is_unsteady() -> None:
    rng = np.random.default_rng(4)
    good, without = Scene().view(rng, 4), Scene(levels=(LEVEL,) * 5 + (0,)).view(rng, 4)
    found = check(LedView((*good.lit[:2], *without.lit[2:]), good.dark))
    assert found.targets["front"].leds[5] is LedState.UNSTEADY
    assert found.targets["front"].leds_found == 5


def test_a_window_that_doubles_all_leds_is_unknown() -> None:
    ghosts = tuple((float(u) - 33, float(v) + 14) for u, v in LEDS)
    found = check(Scene(reflections=ghosts))
    assert found.verdict is Verdict.UNKNOWN
    assert "two groups of lights look like the LEDs" in found.reasons[0]


def test_leds_that_disagree_with_any_similarity_are_never_good() -> None:
    """One side of the frame is bent: two LEDs have moved by 0.4 px."""
    bent = unit()
    moved = LEDS.copy()
    moved[[2, 5]] -= (0.4, 0.0)
    moved[[0, 1]] += (0.0, 0.3)
    targets = (replace(bent.targets[0], leds_px=moved), bent.targets[1])
    found = check(Scene(), calibration=replace(bent, targets=targets))
    assert not found.targets["front"].is_similarity
    assert found.verdict in (Verdict.SUSPECT, Verdict.BAD)
    assert any("disagree with any shift, turn and scale" in reason for reason in found.reasons)


def test_one_led_that_is_elsewhere_is_never_good() -> None:
    places = unit()
    moved = LEDS.copy()
    moved[3] += (6.0, 0.0)
    targets = (replace(places.targets[0], leds_px=moved), places.targets[1])
    found = check(Scene(), calibration=replace(places, targets=targets))
    assert found.targets["front"].leds[3] is not LedState.USED
    assert found.targets["front"].leds_found == 5


def test_a_target_without_references_or_without_frames_is_unknown() -> None:
    known = unit()
    none = (replace(known.targets[0], leds_px=np.empty((0, 2))), known.targets[1])
    found = check(Scene(), calibration=replace(known, targets=none))
    assert found.verdict is Verdict.UNKNOWN
    assert "the calibration knows 0 LEDs" in found.reasons[0]
    rear_only = judge({"rear": Scene().view(np.random.default_rng(1))}, known, None, DriftLimits())
    assert rear_only.verdict is Verdict.UNKNOWN
    assert rear_only.targets["front"].leds_found == 0


def test_frames_of_another_size_are_refused() -> None:
    view = Scene().view(np.random.default_rng(1), 1)
    small = LedView(tuple(replace(f, pixels=f.pixels[:-1]) for f in view.lit), view.dark)
    with pytest.raises(ValueError, match="not 752 × 480"):
        check(small)


@pytest.mark.parametrize("shift_px", [0.0, 0.3])
def test_a_single_pair_of_frames_is_enough(shift_px: float) -> None:
    found = check(Scene(Motion(shift_px)).view(np.random.default_rng(6), 1))
    assert found.verdict is (Verdict.SUSPECT if shift_px else Verdict.GOOD), found.reasons


def test_references_that_lie_all_in_one_place_tell_nothing() -> None:
    known = unit()
    same = np.repeat(LEDS[:1], 6, axis=0)
    for places in (same, np.concatenate([same[:5], LEDS[1:2]])):
        targets = (replace(known.targets[0], leds_px=places), known.targets[1])
        found = check(Scene(), calibration=replace(known, targets=targets))
        assert found.verdict is Verdict.UNKNOWN
        assert found.targets["front"].similarity is None


def test_a_stable_verdict_needs_no_spot() -> None:
    assert check(Scene(spot=None)).verdict is Verdict.GOOD


def test_a_picture_that_trembles_between_the_frames_is_known_less_well() -> None:
    rng = np.random.default_rng(5)
    still = Scene().view(rng, 6)
    shaken = [Scene(Motion(*rng.normal(0, 0.1, 2))).view(rng, 1) for _ in range(6)]
    trembling = LedView(tuple(v.lit[0] for v in shaken), tuple(v.dark[0] for v in shaken))
    sigmas = [check(view).effects["x_mm"].sigma for view in (still, trembling)]
    assert sigmas[1] > 10 * sigmas[0]  # type: ignore[operator]
