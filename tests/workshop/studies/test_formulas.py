"""The studies' reference figures for altd, against physics and against each other."""

import math
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from support.evidence import calibration, evidence
from support.places import ROOT

from altd.calibration.report.budget import budget_of
from altd.errors import BadInputError
from altd.instruments.planar.homography import apply_homography
from altd.mapping.grid import convex_hull_mm
from altd.mapping.tensor_map import fit_tensor_map
from altd.records import Limits
from hw_sim.beam import BeamPose
from hw_sim.double_triangle import MachineFlaws
from hw_sim.planar import LEDS_MM
from studies import budget, chessboard
from studies.averaging import sliding_mean
from studies.beam import grown, slanted_poses
from studies.budget import monte_carlo
from studies.conic import fit_c2
from studies.fig_3_5 import angle_sigma_deg, monte_carlo_deg, share_within
from studies.fig_3_17 import angle_error_deg
from studies.fig_3_19 import balance_px2
from studies.learnt_pattern import Power, left
from studies.planar_errors import direct_linear_transform
from studies.table_2_1 import driven, error_statistics
from studies.table_3_1 import STEP_MM, displaced_poses
from studies.table_3_3 import between_nodes
from studies.table_3_4 import principal_components
from studies.two_cameras import Way, calibrated, lenses, measured, pictures, undetermined


def test_a_tenth_of_a_millimetre_is_the_thesis_angle() -> None:
    assert angle_sigma_deg(0.1, 0.1) == pytest.approx(0.0288, abs=2e-4)


def test_monte_carlo_through_altd_has_the_sigma_of_the_closed_form() -> None:
    angles, stated = monte_carlo_deg(0.1, 3000, np.random.default_rng(1))
    closed = angle_sigma_deg(0.1, 0.1)
    assert angles.std(axis=0) == pytest.approx([closed, closed], rel=0.04)
    assert stated == pytest.approx(closed, rel=1e-3)


def test_the_closed_form_holds_for_a_slanted_beam_with_unequal_spots() -> None:
    rng = np.random.default_rng(2)
    front, rear = rng.normal(0.0, 0.05, 200_000), rng.normal(0.25 * 280.0, 0.02, 200_000)
    drawn = np.degrees(np.arctan((rear - front) / 280.0)).std()
    assert drawn == pytest.approx(angle_sigma_deg(0.05, 0.02, slope=0.25), rel=0.01)


def test_the_share_within_is_that_of_a_normal_distribution() -> None:
    drawn = np.abs(np.random.default_rng(3).normal(0.0, 0.0289, 200_000)) <= 0.05
    assert share_within(0.05, 0.0289) == pytest.approx(drawn.mean(), abs=0.003)


def test_the_linear_budget_agrees_with_a_simulation_of_all_its_inputs() -> None:
    """JCGM 101, 8: the simulation draws stage, beam, distance, maps, pattern and exposures."""
    limited = replace(calibration(), limits=Limits(0.0, 120.0, 0.2, 0.05, 0.5))
    linear = budget_of(limited, (evidence("front"), evidence("rear", 2)))
    errors = monte_carlo(limited, 4000, np.random.default_rng(5))
    assert len(errors) > 3900
    scatter = np.sqrt(np.mean(np.square(errors), axis=0))
    assert scatter == pytest.approx(np.array(linear.combined), rel=0.06)


def test_heat_falsifies_the_angle_as_a_longer_way_to_the_rear_target_does() -> None:
    expansion = 23.6e-6 * 50.0
    beam = BeamPose(0.0, 0.0, 0.11, 0.25)
    x_mm, y_mm = beam.at(280.0 * (1.0 + expansion))
    for slope, rear_mm, angle in ((0.11, x_mm, beam.yaw_deg), (0.25, y_mm, beam.pitch_deg)):
        read = math.degrees(math.atan2(rear_mm, 280.0))
        assert float(angle_error_deg(slope, expansion)) == pytest.approx(read - angle, abs=1e-12)
    assert float(angle_error_deg(0.25, expansion)) == pytest.approx(0.0159, abs=1e-4)
    assert float(angle_error_deg(0.0, expansion)) == 0.0


def test_displacements_are_a_millimetre_long_in_any_direction() -> None:
    poses = displaced_poses(np.random.default_rng(1))
    at = np.array([(pose.x_mm, pose.y_mm) for pose in poses])
    moved = at[1::2] - at[::2]
    assert np.linalg.norm(moved, axis=1) == pytest.approx(np.full(50, STEP_MM))
    assert np.abs(moved.mean(axis=0)).max() < 0.4


def test_c2_finds_the_centre_of_an_exact_ellipse_and_of_a_hyperbola() -> None:
    angle, centre = np.linspace(0.0, 5.0, 24), np.array([0.1, -0.2])
    ellipse = np.array([1.2 * np.cos(angle) + 0.3 * np.sin(angle), 0.8 * np.sin(angle)])
    along = np.linspace(-1.0, 1.0, 12)
    branch = np.array([np.cosh(along), 0.7 * np.sinh(along)])
    for points, is_ellipse in ((ellipse, True), (np.hstack([branch, -branch]), False)):
        found, said = fit_c2(*(points + centre[:, None]))
        assert found == pytest.approx(centre)
        assert said is is_ellipse


@pytest.mark.parametrize("count", [4, 5, 7])
def test_dlt_is_exact_on_exact_points(count: int) -> None:
    rng = np.random.default_rng(count)
    wanted = np.eye(3) + rng.normal(0.0, 0.1, (3, 3))
    source = rng.uniform(-1.0, 1.0, (count, 2))
    found = direct_linear_transform(source, apply_homography(wanted, source))
    assert found / found[2, 2] == pytest.approx(wanted / wanted[2, 2], abs=1e-9)


def test_two_cameras_find_poses_and_leds_that_were_not_measured() -> None:
    """From exact pictures; the lens of the pictures has its middle elsewhere than that of the model."""
    rng, leds_mm, cameras = np.random.default_rng(3), np.array(LEDS_MM), lenses(1)
    poses = np.array((0.0, 700.0, 0.0)) + rng.uniform(-1.0, 1.0, (20, 3)) * (45.0, 32.0, 40.0)
    poses[0] = (0.0, 700.0, 0.0)
    seen_px = pictures(cameras, leds_mm, poses)
    model = calibrated(Way("", 2, False, False), seen_px[:, :12], leds_mm, poses[:12])
    found = measured(model, seen_px[:, 12:])
    assert np.abs(found - poses[12:]).max() < 0.002
    assert model.blocks(model.values)[1] == pytest.approx(leds_mm, abs=0.002)


@pytest.mark.parametrize("cameras", [1, 2])
def test_pictures_show_neither_placement_nor_length_and_without_turns_no_shape(cameras: int) -> None:
    """A similarity of the plane and a motion of the plate; without turns any linear map of the plane."""
    assert undetermined(cameras, turns=True) == 4 + 3
    assert undetermined(cameras, turns=False) == 6 + 3


def test_the_balance_of_misfit_and_covariance_is_the_error_at_the_nodes() -> None:
    """On average over noise, for a map of a degree that is too low, right, and too high."""
    rng, noise_px = np.random.default_rng(5), 0.1
    nodes_mm = np.stack(np.meshgrid(np.arange(7.0), np.arange(5.0)), axis=-1).reshape(-1, 2) * 20.0
    true_px = 3.0 * nodes_mm + 1e-5 * nodes_mm**3
    for degree in ((1, 1), (3, 3), (4, 3)):
        estimated, actual = [], []
        for _ in range(100):
            noisy_px = true_px + rng.normal(0.0, noise_px, true_px.shape)
            fit = fit_tensor_map(nodes_mm, noisy_px, convex_hull_mm(nodes_mm), degree)
            estimated.append(balance_px2(fit, noise_px))
            actual.append(np.mean(np.square(fit.map.to_px(nodes_mm) - true_px)))
        assert np.mean(estimated) == pytest.approx(np.mean(actual), rel=0.05, abs=2e-4)


def test_the_machine_without_errors_is_driven_as_eq_2_64_says() -> None:
    assert driven(1, MachineFlaws()) == pytest.approx((18.75, -40.91, 0.0), abs=0.005)


def test_statistics_of_errors_are_of_the_repeats_of_a_camera_and_the_std_is_of_signed_ones() -> None:
    errors = np.array([[[1.0, -2.0, 0.5], [-3.0, -2.0, 0.5]], [[5.0, -2.0, 0.5], [5.0, 0.0, 1.5]]])
    found = error_statistics(errors)
    expected = (3.5, 4.0, math.sqrt(2.0), 1.5, 2.0, math.sqrt(0.5), 0.75, 1.0, math.sqrt(0.125))
    assert found == pytest.approx(expected)


def test_the_places_between_the_nodes_are_in_the_middle_of_the_meshes() -> None:
    at = {(pose.x_mm, pose.y_mm) for pose in between_nodes()}
    assert at == {(x, y) for x in (-50.0, -25.0, 0.0, 25.0, 50.0) for y in (-37.5, -12.5, 12.5, 37.5)}


def test_a_beam_spreads_by_its_divergence_far_away_and_by_root_two_at_its_rayleigh_length() -> None:
    rayleigh_m = math.pi * 6.0**2 / (2.0 * 650e-6) * 1e-3
    assert grown(12.0, rayleigh_m, 2.0) == pytest.approx(12.0 * math.sqrt(2.0))
    assert grown(12.0, 1e5, 2.0) == pytest.approx(1e8 * 4.0 * 2.0 * 650e-6 / (math.pi * 12.0), rel=1e-4)


def test_slanted_beams_have_the_angle_up_and_down_and_both_spots_on_the_area() -> None:
    poses = slanted_poses(14.0, 280.0, np.random.default_rng(6))
    assert {round(pose.pitch_deg, 9) for pose in poses} == {14.0, -14.0}
    ends = np.array([pose.at(z_mm) for pose in poses for z_mm in (0.0, 280.0)])
    assert (np.abs(ends) <= (70.0, 55.0)).all()
    assert (np.abs(ends).max(axis=0) > (50.0, 50.0)).all()


def test_principal_components_of_errors_are_their_axes_and_sizes() -> None:
    turn = math.radians(30.0)
    axes = np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])
    errors = np.random.default_rng(4).normal(0.0, [3.0, 1.0], size=(50_000, 2)) @ axes + [5.0, -2.0]
    spread, found = principal_components(errors)
    assert spread == pytest.approx([3.0, 1.0], rel=0.02)
    assert np.abs(found @ axes.T) == pytest.approx(np.eye(2), abs=0.02)


def test_a_sliding_mean_has_one_value_for_each_whole_window() -> None:
    values = np.arange(12.0).reshape(6, 2) ** 2
    means = sliding_mean(values, 4)
    assert means == pytest.approx(np.array([values[k : k + 4].mean(axis=0) for k in range(3)]))


def test_the_data_are_looked_for_beside_the_checkout() -> None:
    assert ROOT.parent / "shared" / "data" / "chessboard" == chessboard.PHOTOGRAPHS
    assert ROOT.parent / "shared" / "data" / "unit-a" / "scan" == budget.UNIT_A


@pytest.mark.parametrize(
    ("study", "data", "said"),
    [(chessboard, "PHOTOGRAPHS", "holds no photographs"), (budget, "UNIT_A", "is not a recording")],
)
def test_without_its_data_a_study_is_refused_in_one_line_and_no_row_is_left_out(
    study: ModuleType, data: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(study, data, tmp_path)
    with pytest.raises(BadInputError, match=said):
        study.run(lambda _what: None)


@pytest.mark.parametrize("power", ["constant", "estimated"])
@pytest.mark.parametrize("wave", [0.5, 1.0, 1.7])
def test_spots_learn_the_share_of_a_wave_that_they_do_not_follow(power: Power, wave: float) -> None:
    """Spots of sigma 1 at all places of a period, each fitted with the weights of photons."""
    x = np.arange(-6.0, 6.0, 0.05)
    spot = np.exp(-(x**2) / 2)
    fitted = np.stack([x * spot] + [spot] * (power == "estimated"))  # of the place, of the power
    weighted = fitted / spot
    light = seen = 0.0
    for place in np.linspace(0, 2 * math.pi / wave, 60, endpoint=False):
        texture = np.cos(wave * (place + x))
        excess = spot * texture
        rest = excess - fitted.T @ np.linalg.solve(weighted @ fitted.T, weighted @ excess)
        light += float(spot @ texture**2)
        seen += float(rest @ texture)
    assert 1 - seen / light == pytest.approx(float(left(np.array(wave), 1, power)), abs=1e-3)
