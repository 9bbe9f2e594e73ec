"""Glass behind a target. The truth is a ray, traced in space from surface to surface by Snell's law."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from support.played_unit import PlayedUnit
from support.recordings import place_px

from altd.calibration.file import load_calibration
from altd.config import Installation, Measuring
from altd.instruments.beam.instrument import BeamInstrument, beam_motions, by_line
from altd.instruments.beam.refraction import Refraction, displacement_mm, displacement_sensitivities
from altd.instruments.beam.solver import Beam, fit_beam, joint_jacobian_mm_per_px, line_gain
from altd.records import FloatArray, Glass, MeanSpots, TargetPoint
from altd.records.spots import SpotMotion

WINDOW = Glass(4.0, 1.52)
SLOPES = [each for each in itertools.product((-0.11, 0.0, 0.11), (-0.25, 0.0, 0.25, 0.004)) if any(each)]


def refracted(direction: FloatArray, from_index: float, to_index: float) -> FloatArray:
    """Snell's law for a unit vector that meets a plane normal to z."""
    normal = np.array([0.0, 0.0, 1.0])
    ratio = from_index / to_index
    cosine = float(direction @ normal)
    along = math.sqrt(1 - ratio**2 * (1 - cosine**2))
    inner: FloatArray = ratio * direction + (along - ratio * cosine) * normal
    return inner


def traced(
    foot_mm: tuple[float, float],
    slopes: tuple[float, float],
    panes: list[tuple[float, Glass]],
    z_mm: list[float],
) -> FloatArray:
    """Places (T, 2) at which a ray that starts at ``foot_mm`` on the first target meets each target."""
    targets = [(z, 0.0) for z in z_mm]
    surfaces = [
        surface
        for front, glass in panes
        for surface in ((front, glass.index), (front + glass.thickness_mm, 1.0))
    ]
    place, met, index = np.array([*foot_mm, z_mm[0]]), [], 1.0
    direction = np.array([*slopes, 1.0]) / math.sqrt(1 + slopes[0] ** 2 + slopes[1] ** 2)
    for z, behind in sorted(targets + surfaces):  # a printed surface, of no index, before the glass behind it
        place = place + direction * (z - place[2]) / direction[2]
        if not behind:
            met.append(place[:2])
        else:
            direction, index = refracted(direction, index, behind), behind
    return np.array(met)


def points_at(places: FloatArray) -> list[TargetPoint]:
    return [TargetPoint(float(x), float(y), 0.25 * np.eye(2), 1e-4 * np.eye(2)) for x, y in places]


def numbers(beam: Beam) -> tuple[float, float, float, float]:
    return beam.x_mm, beam.yaw_mm_per_m / 1000, beam.y_mm, beam.pitch_mm_per_m / 1000


def test_at_14_degrees_in_4_mm_the_beam_is_displaced_by_a_third_of_a_millimetre() -> None:
    (_, y), _ = displacement_mm(np.array([0.0, 0.25]), WINDOW)
    assert y == pytest.approx(0.3535, abs=1e-4)
    theta, n = math.atan(0.25), WINDOW.index
    across = 4.0 * math.sin(theta) * (1 - math.cos(theta) / math.sqrt(n**2 - math.sin(theta) ** 2))
    assert y * math.cos(theta) == pytest.approx(across, rel=1e-12)
    assert math.degrees(y / 280 / (1 + 0.25**2)) == pytest.approx(0.068, abs=5e-4)


@pytest.mark.parametrize("slopes", SLOPES)
def test_a_traced_ray_is_found_again_at_every_angle(slopes: tuple[float, float]) -> None:
    panes, z_mm = [(0.0, WINDOW)], [0.0, 280.0]
    points = points_at(traced((10.0, -5.0), slopes, panes, z_mm))
    beam = fit_beam(z_mm, points, 1e-4 * np.eye(4), refraction=Refraction(tuple(panes)))
    assert numbers(beam) == pytest.approx((10.0, slopes[0], -5.0, slopes[1]), abs=1e-12)
    without = fit_beam(z_mm, points, 1e-4 * np.eye(4))
    assert abs(without.pitch_deg - beam.pitch_deg) == pytest.approx(
        abs(math.degrees(math.atan(slopes[1]))) * 0.0049, rel=0.05
    )


@pytest.mark.parametrize("slopes", SLOPES)
def test_three_targets_of_which_two_have_glass_and_a_distant_plane(slopes: tuple[float, float]) -> None:
    """The last has a pane too, which displaces nothing that is measured."""
    panes, z_mm = [(-20.0, WINDOW), (100.0, Glass(9.0, 1.49)), (300.0, Glass(5.0))], [-20.0, 100.0, 300.0]
    points = points_at(traced((3.0, 7.0), slopes, panes, z_mm))
    rng = np.random.default_rng(3)
    root = rng.normal(0, 0.01, (6, 6))
    covariance = root @ root.T + 1e-4 * np.eye(6)
    beam = fit_beam(z_mm, points, covariance, -1000.0, refraction=Refraction(tuple(panes)))
    foot = 3.0 - 980.0 * slopes[0], 7.0 - 980.0 * slopes[1]
    assert numbers(beam) == pytest.approx((foot[0], slopes[0], foot[1], slopes[1]), abs=1e-9)


def test_rates_and_sigma_have_the_gain_of_a_beam_behind_glass() -> None:
    """A ray is traced before and after the unit has turned: the spots' speed becomes the turn's."""
    panes, z_mm = [(0.0, Glass(20.0))], [0.0, 280.0]
    refraction, turn = Refraction(tuple(panes)), np.array([2e-6, -3e-6])
    slopes = np.array([0.1, -0.24])
    turned = (tuple((slopes + k * turn).tolist()) for k in (-0.5, 0.5))
    before, after = (traced((1.0, 2.0), each, panes, z_mm) for each in turned)
    points, covariance = points_at((before + after) / 2), 1e-4 * np.eye(4)
    beam = fit_beam(z_mm, points, covariance, refraction=refraction)
    rate_px = 4.0 * (after - before).ravel()
    motion = SpotMotion(rate_px, 1e-4 * np.eye(4), np.zeros((4, 4)), np.zeros(4), 0.0, 0.1, 1.0, 0.5)
    gain, _ = line_gain(z_mm, covariance, 0.0, refraction.displaced_mm(beam.slopes, z_mm)[1])
    by_px = by_line(beam, Installation()) @ gain @ joint_jacobian_mm_per_px(points)
    of_beam = beam_motions(motion, by_px)
    wanted = np.degrees(turn / (1 + slopes**2))
    assert [of_beam["yaw_deg"].rate, of_beam["pitch_deg"].rate] == pytest.approx(wanted, rel=1e-6)
    draws = np.random.default_rng(1).normal(0, 0.01, (2000, 4)) + (before + after).ravel() / 2
    scatter = np.std(
        [
            numbers(fit_beam(z_mm, points_at(d.reshape(2, 2)), covariance, refraction=refraction))[3]
            for d in draws
        ]
    )
    sigma = math.radians(beam.scatter[3]) * (1 + slopes[1] ** 2)
    assert sigma == pytest.approx(scatter, rel=0.05)


@pytest.mark.parametrize("slopes", [(0.11, -0.25), (0.05, 0.0), (0.0, 0.25)])
def test_sigma_holds_what_thickness_and_index_are_not_known_to(slopes: tuple[float, float]) -> None:
    """Rays through windows that differ from the stated one by 0.1 mm and 0.01, one sigma each."""
    rng, z_mm = np.random.default_rng(2), [0.0, 280.0]
    off = rng.normal(0, (0.1, 0.01), (3000, 2)).tolist()
    real = [Glass(WINDOW.thickness_mm + a, WINDOW.index + b) for a, b in off]
    met = np.array([traced((0, 0), slopes, [(0.0, glass)], z_mm)[1] for glass in real])
    effects = np.hstack([*Refraction(((0.0, WINDOW),)).effects_mm(np.array(slopes), z_mm).values()])
    covariance = effects @ effects.T
    assert covariance[2:, 2:] == pytest.approx(np.cov(met.T), rel=0.08, abs=1e-9)
    assert not covariance[:2].any()
    per_mm, per_index = displacement_sensitivities(np.array(slopes), WINDOW)
    others = Glass(4.001), Glass(4.0, 1.5201)
    thicker, denser = (traced((0, 0), slopes, [(0.0, glass)], z_mm)[1] for glass in others)
    nominal = traced((0, 0), slopes, [(0.0, WINDOW)], z_mm)[1]
    assert per_mm == pytest.approx((nominal - thicker) / 0.001, rel=1e-4)
    assert per_index == pytest.approx((nominal - denser) / 0.0001, rel=1e-3)


@pytest.mark.parametrize("slopes", [(0.11, -0.2), (-0.11, 0.2), (0.0, 0.25)])
def test_a_unit_with_a_window_measures_a_slanted_beam_through_its_maps(
    played_unit: PlayedUnit, slopes: tuple[float, float]
) -> None:
    calibration = load_calibration(played_unit.calibration)
    front, rear = calibration.targets
    with_window = replace(calibration, targets=(replace(front, glass=WINDOW), rear))
    foot = -14.0 * np.sign(slopes[0]), -30.0 * np.sign(slopes[1])
    places = traced(foot, slopes, [(0.0, WINDOW)], [0.0, 280.0])
    spots = np.array([place_px(name, *place) for name, place in zip(("front", "rear"), places, strict=True)])
    mean = MeanSpots(("front", "rear"), spots, 1e-4 * np.eye(4), 0, 20, 0, (None, None), (0.0, 0.0))
    solved, without = (BeamInstrument(each, Measuring()).solve(mean) for each in (with_window, calibration))
    wanted = dict(zip(("yaw_deg", "pitch_deg"), np.degrees(np.arctan(slopes)), strict=True))
    for key, angle in wanted.items():
        value = solved.values[key]
        assert value.value == pytest.approx(angle, abs=4 * value.sigma)
        assert value.value == pytest.approx(angle, abs=0.004)
    assert abs(without.values["pitch_deg"].value - wanted["pitch_deg"]) > 0.05
    assert solved.targets == without.targets
