"""Estimates of a verification against errors put in by formula; limits of its tests, and their power."""

import math
from dataclasses import replace

import numpy as np
import pytest
import scipy.stats

from altd.calibration.verification.estimate import (
    BeamSet,
    Estimate,
    Estimated,
    Mounting,
    Scatter,
    estimate,
    why_not_aligned,
    why_too_few,
)
from altd.calibration.verification.verdict import Judgement, LimitTest, Result, judge, variance_ratio_quantile
from altd.records import Limits
from altd.records.limits import NO_LIMITS

SIGMA = (0.01, 0.01, 0.003, 0.003)


def beams(
    places_mm: np.ndarray,
    *,
    turned: bool = False,
    scale_ppm: tuple[float, float] = (0.0, 0.0),
    square_mrad: float = 0.0,
    rotation_mrad: float = 0.0,
    offset_mm: tuple[float, float] = (0.0, 0.0),
    zero_deg: tuple[float, float] = (0.0, 0.0),
    beam_deg: tuple[float, float] = (0.0, 0.0),
    deflection_deg: tuple[float, float] = (0.0, 0.0),
    deflection_sigma_deg: float | None = 0.001,
    slope_ppm: tuple[float, float] = (0.0, 0.0),
    seat_mm_per_m: float | None = 0.05,
    scatter: float = 0.0,
    seed: int = 0,
) -> BeamSet:
    """The readings of a unit with these errors; ``scatter`` is in stated sigmas.

    Its slopes are ``slope_ppm`` too long. ``beam_deg`` is in the axes of the unit as mounted,
    ``deflection_deg`` in those of the stage.
    """
    rng = np.random.default_rng(seed)
    sign = -1.0 if turned else 1.0
    angle = 1e-3 * rotation_mrad
    mount = sign * np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    half = 1e-3 * square_mrad / 2
    reads = np.array([[1 + 1e-6 * scale_ppm[0], half], [half, 1 + 1e-6 * scale_ppm[1]]])
    xy = places_mm @ mount.T @ reads.T + offset_mm
    true_deg = sign * np.array(beam_deg) + mount @ np.array(deflection_deg)
    read = np.arctan(np.tan(np.radians(true_deg)) * (1 + 1e-6 * np.array(slope_ppm)))
    angles = np.array(zero_deg) + np.degrees(read) + np.zeros_like(xy)
    values = np.hstack([xy, angles]) + scatter * rng.normal(0, SIGMA, (len(xy), 4))
    sigma = np.tile(SIGMA, (len(xy), 1))
    mounting = Mounting(turned, 0.0, seat_mm_per_m, deflection_deg, deflection_sigma_deg)
    return BeamSet(places_mm, values, sigma, np.zeros((len(xy), 4, 1)), 280.0, mounting)


def grid(pitch_mm: float = 30.0, columns: int = 5, rows: int = 4) -> np.ndarray:
    x, y = np.meshgrid(np.arange(columns), np.arange(rows))
    return pitch_mm * np.column_stack([x.ravel() - (columns - 1) / 2, y.ravel() - (rows - 1) / 2])


def test_errors_and_mounting_are_told_apart_exactly() -> None:
    wrong = {"scale_ppm": (300.0, -200.0), "square_mrad": 0.4, "zero_deg": (0.02, -0.03)}
    upright = beams(grid(), rotation_mrad=50.0, offset_mm=(1.0, 2.0), beam_deg=(0.1, 0.2), **wrong)
    mounted = {"rotation_mrad": -20.0, "offset_mm": (3.0, -4.0), "beam_deg": (0.1, 0.2)}
    turned = beams(grid(), turned=True, **mounted, **wrong)
    found = estimate([upright, turned])
    # a scale of s and a mount of r rad leave s r² / 2, below 1 ppm here
    assert [one.value for one in found.scale_ppm] == pytest.approx([300.0, -200.0], abs=1.0)
    assert found.square_mrad.value == pytest.approx(0.4, abs=0.002)
    assert [one.value for one in found.zero_deg] == pytest.approx([0.02, -0.03], abs=1e-9)
    assert found.rotations_mrad == pytest.approx([50.0, -20.0], abs=0.05)
    assert found.offsets_mm == pytest.approx(np.array([[1.0, 2.0], [3.0, -4.0]]), abs=1e-3)
    assert found.directions_deg == pytest.approx(np.array([[0.12, 0.17], [-0.08, -0.23]]), abs=1e-9)
    assert found.displacement.experimental < 1e-4
    assert found.direction.experimental < 1e-9


def test_one_orientation_shows_no_zero_without_the_beam() -> None:
    found = estimate([beams(grid(), zero_deg=(0.02, 0.0), beam_deg=(0.1, 0.0))])
    assert found.zero_deg is None
    assert found.upright_deg[0].value == pytest.approx(0.12)


def test_uncertainties_are_those_of_least_squares_where_places_are_far_apart() -> None:
    places = grid()
    found = estimate([beams(places)])
    # independent errors of 10 µm: sigma of a slope is sigma / root of the sum of squares
    per_x, per_y = (0.01 / math.sqrt(np.square(axis).sum()) for axis in places.T)
    assert found.scale_ppm[0].sigma == pytest.approx(1e6 * per_x, rel=1e-6)
    assert found.scale_ppm[1].sigma == pytest.approx(1e6 * per_y, rel=1e-6)
    # dx/dy and dy/dx are independent slopes, squareness is their sum
    assert found.square_mrad.sigma == pytest.approx(1e3 * math.hypot(per_x, per_y), rel=1e-6)
    assert found.displacement.degrees_of_freedom == pytest.approx(2 * len(places) - 6, rel=1e-3)
    assert found.direction.degrees_of_freedom == pytest.approx(2 * len(places) - 2, rel=1e-3)


def test_places_that_are_measured_again_are_no_new_evidence() -> None:
    one = estimate([beams(grid())])
    twice = estimate([beams(grid()), beams(grid())])
    assert twice.scale_ppm[0].sigma == pytest.approx(one.scale_ppm[0].sigma, rel=1e-3)
    assert twice.direction.degrees_of_freedom == pytest.approx(one.direction.degrees_of_freedom, rel=0.03)


def test_an_error_that_the_map_has_everywhere_is_not_averaged_away() -> None:
    upright = beams(grid())
    common = np.zeros((len(upright), 4, 1))
    common[:, 2, 0] = 0.002
    shared = replace(upright, map_factor=common)
    found = estimate([shared])
    own = (0.003**2 - 0.002**2) / len(upright)
    assert found.upright_deg[0].sigma == pytest.approx(math.sqrt(0.002**2 + own), rel=1e-3)


def test_the_experimental_standard_deviation_is_that_of_the_scatter() -> None:
    found = estimate([beams(grid(10.0, 12, 10), scatter=2.0, seed=3)])
    for scatter, stated in ((found.displacement, 0.01), (found.direction, 0.003)):
        assert scatter.stated == pytest.approx(stated)
        spread = 1 / math.sqrt(2 * scatter.degrees_of_freedom)
        assert scatter.experimental / (2 * stated) == pytest.approx(1.0, abs=4 * spread)


@pytest.mark.parametrize(
    ("places", "why"),
    [
        (grid(columns=2, rows=2), "too few positions: 4 valid, at least 5 are needed"),
        (grid(columns=9, rows=1), "its positions are on one line"),
        (np.zeros((9, 2)), "its positions are on one line"),
        (grid(), ""),
    ],
)
def test_a_set_that_cannot_show_anything_says_why(places: np.ndarray, why: str) -> None:
    assert why_too_few(beams(places)) == why


def test_a_set_of_the_wrong_orientation_is_noticed() -> None:
    right = beams(grid(), turned=True)
    assert why_not_aligned(right) == ""
    wrong = replace(right, mounting=Mounting())
    assert "turned by 180°" in why_not_aligned(wrong).replace("-", "")


REFERENCE = Limits(0.002, 30.0, 0.03, 0.1)
CALIBRATION = Limits(0.002, 40.0, 0.04, 0.02, 0.05)
NOTHING = Estimated(0.0, 0.0)
GOOD = Estimate(
    scale_ppm=(Estimated(0.0, 50.0), NOTHING),
    square_mrad=NOTHING,
    offsets_mm=np.zeros((2, 2)),
    rotations_mrad=np.zeros(2),
    directions_deg=np.zeros((2, 2)),
    zero_deg=(Estimated(0.0, 0.001, 0.002), NOTHING),
    upright_deg=(NOTHING, NOTHING),
    angle_scale_ppm=(Estimated(0.0, 200.0, 300.0), NOTHING),
    distance_mm=Estimated(0.0, 0.06, 0.08),
    stated_distance_mm=280.0,
    displacement=Scatter(0.01, 0.01, 30.0),
    direction=Scatter(0.003, 0.003, 30.0),
    residuals=(),
)


def judged(estimate: Estimate = GOOD, reference: Limits | None = REFERENCE) -> Judgement:
    return judge(estimate, reference, CALIBRATION)


def found(judgement: Judgement, key: str) -> LimitTest:
    return next(test for test in judgement.tests if test.key == key)


def test_limits_share_five_per_cent_among_the_tests() -> None:
    judgement = judged()
    assert (judgement.verdict, judgement.made, judgement.reasons) == (Result.PASSED, 10, ())
    scale = found(judgement, "scale_x_ppm")
    assert scale.sigma == pytest.approx(math.sqrt(50**2 + 30**2 + 40**2))
    assert scale.limit == pytest.approx(scale.sigma * scipy.stats.norm.ppf(1 - 0.05 / 20))
    zero = found(judgement, "zero_yaw_deg")
    # both orientations: the seat but nothing of the reference's beam, all of the calibration's
    assert zero.sigma == pytest.approx(math.hypot(0.001, 0.002, math.degrees(0.02e-3)))
    angle = found(judgement, "scale_yaw_ppm")
    assert angle.sigma == pytest.approx(math.hypot(200, 300, 40, 0.05 / 280e-6))
    distance = found(judgement, "target_distance_mm")
    assert distance.sigma == pytest.approx(math.hypot(0.06, 0.08, 280 * 30e-6, 0.05))
    scatter = found(judgement, "standard_deviation_mm")
    ratio = scipy.stats.f.ppf(1 - 0.05 / 10, 30, 45)
    assert scatter.limit == pytest.approx(0.01 * math.sqrt(ratio), rel=1e-3)


def test_the_smallest_detectable_error_fails_with_95_per_cent() -> None:
    judgement = judged()
    scale = found(judgement, "scale_x_ppm")
    assert scipy.stats.norm(scale.detectable, scale.sigma).sf(scale.limit) == pytest.approx(0.95, abs=1e-3)
    scatter = found(judgement, "standard_deviation_mm")
    ratio = (scatter.limit / scatter.detectable) ** 2
    assert scipy.stats.f(30, 45).sf(ratio) == pytest.approx(0.95, abs=1e-3)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"scale_ppm": (Estimated(-400.0, 50.0), NOTHING)}, "scale of x is beyond its limit"),
        ({"square_mrad": Estimated(0.2, 0.0)}, "squareness is beyond its limit"),
        ({"zero_deg": (NOTHING, Estimated(0.05, 0.001))}, "zero of pitch is beyond its limit"),
        ({"displacement": Scatter(0.016, 0.01, 30.0)}, "standard deviation of x, y is beyond its limit"),
        ({"direction": Scatter(0.005, 0.003, 30.0)}, "standard deviation of yaw, pitch is beyond its limit"),
    ],
)
def test_one_error_beyond_its_limit_fails_the_unit(change: dict[str, object], reason: str) -> None:
    judgement = judged(replace(GOOD, **change))  # type: ignore[arg-type]
    assert (judgement.verdict, judgement.reasons) == (Result.FAILED, (reason,))


def test_nothing_is_tested_against_a_reference_of_which_nothing_is_known() -> None:
    judgement = judged(replace(GOOD, square_mrad=Estimated(9.0, 0.0)), None)
    assert (judgement.verdict, judgement.made) == (Result.NOT_DECIDED, 0)
    assert judgement.reasons == ("the uncertainty of the reference is unknown: its header states no limits",)


def test_what_the_reference_does_not_state_is_not_tested() -> None:
    judgement = judged(reference=replace(REFERENCE, stage_scale_ppm=None))
    assert (judgement.verdict, judgement.made) == (Result.NOT_DECIDED, 7)
    assert judgement.reasons == tuple(
        f"{name}: the reference's limits do not state stage_scale_ppm"
        for name in ("scale of x", "scale of y", "distance of the targets")
    )


def test_without_a_turned_set_the_zero_is_that_of_the_stated_beam_or_not_decided() -> None:
    upright = replace(GOOD, zero_deg=None, upright_deg=(Estimated(0.001, 0.001), NOTHING))
    zero = found(judged(upright), "zero_yaw_deg")
    assert zero.value == 0.001
    assert zero.parts["reference"] == pytest.approx(math.degrees(0.1e-3))
    unstated = judged(upright, replace(REFERENCE, beam_normal_mm_per_m=None))
    assert (unstated.verdict, unstated.made) == (Result.NOT_DECIDED, 8)
    assert unstated.reasons[0].startswith("zero of yaw: needs a set with the unit turned by 180°")


@pytest.mark.parametrize(
    ("change", "reasons"),
    [
        (
            {"zero_deg": (Estimated(0.0, 0.001, None), NOTHING)},
            ["zero of yaw: the sets do not state seat_mm_per_m"],
        ),
        (
            {"angle_scale_ppm": (None, NOTHING)},
            ["scale of yaw: needs a set with the beam deflected by a known yaw"],
        ),
        (
            {
                "angle_scale_ppm": (NOTHING, Estimated(0.0, 1.0, None)),
                "distance_mm": Estimated(0.0, 0.1, None),
            },
            [
                "scale of pitch: the set does not state deflection_sigma_deg",
                "distance of the targets: the set does",
            ],
        ),
    ],
)
def test_what_is_not_measured_or_not_stated_is_not_decided(
    change: dict[str, object], reasons: list[str]
) -> None:
    judgement = judged(replace(GOOD, **change))  # type: ignore[arg-type]
    assert judgement.verdict is Result.NOT_DECIDED
    for given, reason in zip(judgement.reasons, reasons, strict=False):
        assert given.startswith(reason)


def test_a_test_that_cannot_detect_what_is_required_is_not_decided() -> None:
    wide = judge(GOOD, REFERENCE, replace(CALIBRATION, beam_normal_mm_per_m=0.3))
    assert wide.verdict is Result.NOT_DECIDED
    # 0.0172° and 0.0022°, (2.807 + 1.645) sigma; 1 mm/m at a slope of 110 mm/m is 0.0566°
    assert wide.reasons[0] == (
        "zero of yaw: cannot detect less than 0.0772°, required is 0.0566°: "
        "calibrate with a second scan, the unit turned"
    )
    beyond = judge(replace(GOOD, zero_deg=(Estimated(0.1, 0.001, 0.002), NOTHING)), REFERENCE, NO_LIMITS)
    assert beyond.verdict is Result.FAILED, "power is not needed to fail"


def test_the_greatest_error_is_decided_outside_its_guard_bands() -> None:
    """Zero and scale each agree with a calibration that states them loosely; both together do not conform."""
    loose = replace(CALIBRATION, beam_normal_mm_per_m=0.2, target_distance_mm=0.2)
    degree = math.degrees(1e-3)
    for scale_ppm, result in ((500.0, Result.PASSED), (1600.0, Result.NOT_DECIDED), (2400.0, Result.FAILED)):
        wrong = replace(
            GOOD,
            zero_deg=(NOTHING, Estimated(0.5 * degree, 0.0)),
            angle_scale_ppm=(NOTHING, Estimated(scale_ppm, 200.0)),
            direction=Scatter(0.0, 0.003, 1e9),
        )
        error = found(judge(wrong, REFERENCE, loose), "error_pitch_mm_per_m")
        # a slope of 0.25 lengthens the zero's part by 1 + 0.25²; the expanded uncertainty is 0.1 mm/m
        assert error.value == pytest.approx(0.5 * (1 + 0.25**2) + 0.25e-3 * scale_ppm)
        assert (error.limit, error.rejection) == pytest.approx((0.9, 1.1))
        assert error.result is result


def test_scale_of_the_angles_and_distance_follow_from_a_known_deflection() -> None:
    wrong = {"slope_ppm": (3000.0, -2000.0), "scale_ppm": (100.0, 200.0), "zero_deg": (0.02, -0.03)}
    straight = beams(grid(), beam_deg=(0.1, 0.2), rotation_mrad=80.0, **wrong)
    turned = beams(grid(), turned=True, beam_deg=(0.1, 0.2), **wrong)
    deflected = beams(grid(), beam_deg=(0.1, 0.2), rotation_mrad=80.0, deflection_deg=(3.0, 4.0), **wrong)
    back = beams(grid(), turned=True, beam_deg=(0.1, 0.2), deflection_deg=(-3.0, -4.0), **wrong)
    for sets in ([straight, turned, deflected], [straight, turned, deflected, back]):
        found = estimate(sets)
        assert [one.value for one in found.angle_scale_ppm] == pytest.approx([3000.0, -2000.0], abs=20.0)
        assert [one.value for one in found.zero_deg] == pytest.approx([0.02, -0.03], abs=0.001)
    assert estimate([straight, turned]).angle_scale_ppm == (None, None)
    # one wedge of 0.001° twice: the errors of 3° and of -3° are one error
    assert found.angle_scale_ppm[0].reference == pytest.approx(1e6 * 0.001 / 3.0, rel=0.1)


def test_a_distance_stated_a_millimetre_too_short_is_found_as_such() -> None:
    long_ppm = (
        1e6 / 279.0 + 100.0
    )  # of the slopes: the true distance is 280 mm, and lengths are 100 ppm too long
    sets = [
        replace(
            beams(grid(), scale_ppm=(100.0, 100.0), slope_ppm=(long_ppm,) * 2, deflection_deg=deg),
            distance_mm=279.0,
        )
        for deg in ((0.0, 0.0), (3.0, 4.0))
    ]
    assert estimate(sets).distance_mm.value == pytest.approx(-1.0, abs=0.01)


def test_the_seat_scatters_each_orientation_and_a_deflection_leaves_the_pattern_of_the_first_target() -> None:
    sets = [beams(grid(), turned=turned) for turned in (False, True)]
    assert estimate(sets).zero_deg[0].reference == pytest.approx(math.degrees(0.05e-3) / math.sqrt(2))
    assert estimate([sets[0], beams(grid(), turned=True, seat_mm_per_m=None)]).zero_deg[0].reference is None
    found = estimate([sets[0], beams(grid(), deflection_deg=(4.0, 0.0))])
    # half of the variance is of the first target, where the spots are again, and cancels
    of_mean_deg = 0.003 / math.sqrt(len(grid()))
    lever_deg = math.degrees(math.sin(math.radians(8.0)) / 2)
    assert found.angle_scale_ppm[0].sigma == pytest.approx(1e6 * of_mean_deg / lever_deg, rel=0.02)


def test_few_degrees_of_freedom_and_other_reasons_leave_it_open_unless_a_test_fails() -> None:
    few = replace(GOOD, displacement=Scatter(0.1, 0.01, 4.0))
    judgement = judged(few)
    assert judgement.verdict is Result.NOT_DECIDED
    assert "4.0 degrees of freedom" in judgement.reasons[0]
    assert judge(GOOD, REFERENCE, NO_LIMITS, ["why"]).reasons == ("why",)
    failed = judge(replace(GOOD, square_mrad=Estimated(9.0, 0.0)), REFERENCE, CALIBRATION, ["why"])
    assert failed.verdict is Result.FAILED


def test_quantiles_are_those_of_scipy() -> None:
    for freedom in (8, 12, 34.5, 200):
        for below in (45, 1e6):
            for probability in (0.05, 0.5, 0.95, 0.995):
                expected = scipy.stats.f.ppf(probability, freedom, below)
                found = variance_ratio_quantile(probability, freedom, below)
                assert found == pytest.approx(expected, rel=5e-3)
