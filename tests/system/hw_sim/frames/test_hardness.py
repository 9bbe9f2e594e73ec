"""Physics of the effects that ``hw_sim.hardness`` adds."""

import json
import math
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from hw_sim.__main__ import main
from hw_sim.assembly import make_dots
from hw_sim.beam import BeamFlaws, BeamPose, Laser, footprint, glass_shift_mm
from hw_sim.hardness import HARD, Hardness
from hw_sim.motion import Vibration
from hw_sim.optics import transmission
from hw_sim.targets import DotPattern
from hw_sim.unit import CAMERAS, FRONT, REAR, Unit, UnitConfig

Array = npt.NDArray[np.float64]

CLEAN = UnitConfig(seed=7, speckle_contrast=0.0, lux=0.0, hot_pixels=0, bits=16)


def light(unit: Unit, camera: str, pose: BeamPose) -> Array:
    """Mean electrons of a picture of the beam."""
    unit.place(pose)
    return unit.imagers[camera].mean_e(unit.spots(camera, 0), False, 1.6).astype(np.float64)


def first_moment(image: Array) -> Array:
    rows, columns = np.indices(image.shape)
    return np.array([(columns * image).sum(), (rows * image).sum()]) / image.sum()


@pytest.fixture(scope="module")
def clean() -> Unit:
    return Unit(CLEAN)


@pytest.fixture(scope="module")
def speckled() -> Unit:
    return Unit(replace(CLEAN, hard=Hardness(speckle_contrast=0.12)))


def pattern(clean: Unit, speckled: Unit, pose: BeamPose, at_mm: tuple[float, float]) -> Array:
    """The factor of the laser's own speckle at 25 × 25 pixels of the rear spot, around a place."""
    u, v = (round(float(part)) for part in clean.imagers[REAR].view.lens.project(*at_mm))
    here = slice(v - 12, v + 13), slice(u - 12, u + 13)
    return np.asarray(light(speckled, REAR, pose)[here] / light(clean, REAR, pose)[here])


def test_laser_speckle_has_its_contrast_and_its_grain(clean: Unit, speckled: Unit) -> None:
    factors = [pattern(clean, speckled, BeamPose(0.1 * k, 0.0), (0.0, 0.0)) for k in range(30)]
    by_phase = [np.mean([factors[k].std() for k in range(phase, 30, 5)]) for phase in range(5)]
    assert by_phase == pytest.approx([0.12] * 5, rel=0.05)  # between two patterns as on one
    rest = np.array(factors) - 1.0
    beside = float((rest[:, :, :-1] * rest[:, :, 1:]).mean() / rest.var())
    assert beside == pytest.approx(0.09, abs=0.03)


def test_laser_speckle_decorrelates_with_place_and_with_the_angle_of_the_pupil(
    clean: Unit, speckled: Unit
) -> None:
    """Light at an angle that the pupil subtends at the target leaves nothing of the field in the pupil."""
    lens = speckled.imagers[REAR].view.lens
    pupil_rad = lens.focal_mm / 4.0 / lens.translation_mm[2]
    starts = np.linspace(0.0, 1.0, 8, endpoint=False)

    def correlation(place_mm: float, angle_rad: float) -> float:
        """Mean correlation of pictures that differ by so much, from several places on."""
        pairs = []
        for start in starts:
            one = BeamPose(start * 0.5, 0.2, start * pupil_rad, 0.0)
            aside_mm = place_mm - 280.0 * angle_rad  # the place on the rear target counts
            other = replace(one, x_mm=one.x_mm + aside_mm, slope_x=one.slope_x + angle_rad)
            first, second = (pattern(clean, speckled, pose, one.at(280.0)) for pose in (one, other))
            pairs.append(float(np.corrcoef(first.ravel(), second.ravel())[0, 1]))
        return float(np.mean(pairs))

    assert correlation(0.0, 0.0) == pytest.approx(1.0)
    assert correlation(0.05, 0.0) > 0.9
    assert correlation(0.0, 0.1 * pupil_rad) > 0.9
    for beside in (correlation(0.5, 0.0), correlation(0.0, pupil_rad)):
        assert 0.1 < beside < 0.5  # around 1/e
    for far in (correlation(1.5, 0.0), correlation(0.0, 3.0 * pupil_rad)):
        assert abs(far) < 0.1


def test_neither_lamp_nor_target_shows_laser_speckle(clean: Unit, speckled: Unit) -> None:
    for camera in CAMERAS:
        even, other = (unit.imagers[camera].mean_e([], True, 1.6, 0.03) for unit in (clean, speckled))
        assert np.array_equal(even, other)


def test_vibration_averages_speckle_within_an_exposure() -> None:
    shaken = replace(CLEAN, vibration=Vibration(rms_mm=0.3, rms_mrad=0.0))
    units = [Unit(replace(shaken, hard=Hardness(speckle, instants=16))) for speckle in (0.0, 0.12)]
    spread = []
    for exposure_ms in (0.001, 40.0):
        for unit in units:
            unit.set_camera(REAR, exposure_ms=exposure_ms)
        even, speckled = (
            unit.imagers[REAR].mean_e(unit.exposed_spots(REAR, 0), False, 1.0) for unit in units
        )
        here = even > 0.3 * even.max()
        spread.append(float((speckled[here] / even[here]).std()))
    assert spread[0] == pytest.approx(0.12, rel=0.05)
    assert spread[1] < 0.8 * spread[0]


def test_a_moving_spot_is_the_mean_of_the_spots_at_the_instants() -> None:
    unit = Unit(replace(CLEAN, hard=Hardness(instants=4)))
    unit.follow(lambda t_ns: BeamPose(t_ns * 1e-6, 0.0))  # 1 mm in 1 ms, at 4 ms
    unit.set_camera(REAR, exposure_ms=4.0)
    imager = unit.imagers[REAR]
    seen = imager.mean_e(unit.exposed_spots(REAR, 0), False, 4.0)
    peak = unit.spots(REAR, 0)[0].peak_mw_per_mm2
    still = [footprint(CLEAN.laser, BeamPose(x, 0.0), 280.0) for x in (-1.5, -0.5, 0.5, 1.5)]
    spots = [replace(spot, peak_mw_per_mm2=peak) for spot in still]
    mean = sum(imager.mean_e([spot], False, 4.0) for spot in spots) / 4.0
    assert np.abs(seen - mean).max() < 1e-4 * mean.max()


@pytest.mark.parametrize("order", [1.0, 2.0])
@pytest.mark.parametrize(
    "flaws",
    [
        BeamFlaws(skew=0.3),
        BeamFlaws(aperture=0.8),
        BeamFlaws(halo_share=0.2),
        BeamFlaws(skew=-0.2, aperture=0.7, halo_share=0.1),
    ],
)
def test_the_stated_place_of_a_flawed_beam_is_its_centroid(flaws: BeamFlaws, order: float) -> None:
    axis = np.arange(-60.0, 60.0, 0.1, dtype=np.float32)
    x, y = np.meshgrid(axis, axis)
    spot = footprint(Laser(order=order, flaws=flaws), BeamPose(0.0, 0.0, 0.11, 0.25), 20.0)
    weight = spot.irradiance(x, y).astype(np.float64)
    centroid = [(x * weight).sum() / weight.sum(), (y * weight).sum() / weight.sum()]
    assert centroid == pytest.approx((2.2, 5.0), abs=2e-3)
    if math.isinf(flaws.aperture):
        assert weight.sum() * 0.1**2 == pytest.approx(3.0, rel=1e-3)
    half_x, half_y = spot.half_box_mm
    outside = (np.abs(x - 2.2) > half_x) | (np.abs(y - 5.0) > half_y)
    assert weight[outside].max(initial=0.0) < 2e-6 * weight.max()


def test_a_skewed_beam_has_its_peak_beside_its_centroid_and_a_long_side() -> None:
    spot = footprint(Laser(angle_rad=0.0, flaws=BeamFlaws(skew=0.3)), BeamPose(0.0, 0.0), 0.0)
    axis = np.arange(-20.0, 20.0, 0.01, dtype=np.float32)
    along = spot.irradiance(axis, np.zeros_like(axis)).astype(np.float64)
    peak_mm = float(axis[along.argmax()])
    assert peak_mm == pytest.approx(-2.0 * 0.3 * 6.0 / math.sqrt(2.0 * math.pi), abs=0.02)
    edges = axis[along > math.exp(-2.0) * along.max()]
    assert (edges[-1] - peak_mm, peak_mm - edges[0]) == pytest.approx((7.8, 4.2), abs=0.03)


@pytest.mark.parametrize("slopes", [(0.11, 0.0), (-0.05, 0.25), (0.0, -0.2)])
def test_glass_displaces_the_rear_spot_as_a_ray_in_space(slopes: tuple[float, float]) -> None:
    """The vector form of Snell's law at both faces of a plate of 4 mm, index 1.52."""
    ray = np.array([*slopes, 1.0]) / math.sqrt(1.0 + slopes[0] ** 2 + slopes[1] ** 2)

    def refracted(direction: Array, ratio: float) -> Array:
        """Direction behind a plane across z, from index n1 to n2; ratio is n1/n2."""
        cosine = direction[2]
        turned = ratio * direction
        turned[2] += math.sqrt(1.0 - ratio**2 * (1.0 - cosine**2)) - ratio * cosine
        return turned

    inside = refracted(ray, 1.0 / 1.52)
    behind = refracted(inside, 1.52)
    place = np.array([5.0, -3.0, 0.0]) + inside * 4.0 / inside[2]
    place += behind * (280.0 - 4.0) / behind[2]
    assert behind == pytest.approx(ray)

    unit = Unit(replace(CLEAN, glass_mm=4.0))
    unit.place(BeamPose(5.0, -3.0, *slopes))
    (rear,), (front,) = unit.spots(REAR, 0), unit.spots(FRONT, 0)
    assert (rear.x_mm, rear.y_mm) == pytest.approx(tuple(place[:2]), abs=1e-9)
    assert (front.x_mm, front.y_mm) == (5.0, -3.0)
    assert glass_shift_mm(BeamPose(0.0, 0.0), 4.0, 1.52) == (0.0, 0.0)


def test_the_filter_dims_an_oblique_laser_more_than_a_lamp() -> None:
    """Half of a line is left where the filter's middle has moved by half its width."""
    width_nm, sine = 10.0, 2.0 * math.sqrt(1.0 - (1.0 - 5.0 / 650.0) ** 2)
    tangent = sine / math.sqrt(1.0 - sine**2)
    laser, lamp = (float(transmission(tangent, width_nm, source)) for source in (0.0, 25.0))
    assert laser == pytest.approx(0.5)
    assert 0.8 < lamp < 1.0
    assert float(transmission(0.0, width_nm)) == float(transmission(0.0, width_nm, 25.0)) == 1.0


def test_a_laser_beside_the_filters_centre_is_dimmed_and_an_angle_shifts_the_centre_towards_it() -> None:
    """Two cavities pass 1/17 of a laser a whole width off; one of a shorter wavelength gains by the angle."""
    laser = [float(transmission(0.0, 10.0, laser_nm=laser_nm)) for laser_nm in (640.0, 650.0, 660.0)]
    assert laser == pytest.approx([1 / 17, 1.0, 1 / 17])
    sine = 2.0 * math.sqrt(1.0 - (590.0 / 600.0) ** 2)
    tangent = sine / math.sqrt(1.0 - sine**2)
    assert float(transmission(tangent, 10.0, laser_nm=590.0, centre_nm=600.0)) == pytest.approx(1.0)
    assert float(transmission(tangent, 10.0, laser_nm=610.0, centre_nm=600.0)) < 0.01
    dimmed = Unit(replace(CLEAN, hard=Hardness(filter_nm=15.0, laser_nm=660.0)))
    falloff = dimmed.imagers[CAMERAS[0]].view.laser_falloff
    assert falloff is not None
    assert float(falloff.max()) == pytest.approx(1 / (1 + (20 / 15) ** 4), rel=1e-3)


def test_a_unit_behind_a_filter_has_a_fall_off_of_the_laser_and_another_of_the_lamp(clean: Unit) -> None:
    filtered = Unit(replace(CLEAN, hard=Hardness(filter_nm=25.0)))
    for camera in CAMERAS:
        before, after = clean.imagers[camera].view, filtered.imagers[camera].view
        centre, corner = (240, 376), (5, 5)
        laser = np.array([after.response[at] / before.response[at] for at in (centre, corner)])
        lamp = np.array([after.even_response[at] / before.response[at] for at in (centre, corner)])
        assert laser[0] > 0.95
        assert laser[1] + 0.02 < lamp[1] < lamp[0] - 0.02
        even = filtered.imagers[camera].mean_e([], False, 1.0, 1.0) - after.hot_e
        assert even == pytest.approx(after.even_response, rel=1e-5)


def test_a_tilted_filter_passes_most_where_the_ray_runs_along_its_normal() -> None:
    tilted = Unit(replace(CLEAN, hard=Hardness(filter_nm=10.0, filter_tilt_mrad=150.0)))
    for camera in CAMERAS:
        view = tilted.imagers[camera].view
        assert view.laser_falloff is not None
        v_px, u_px = np.nonzero(view.laser_falloff > 0.9999)
        (u0_px, v0_px), focal_px = view.lens.principal_px, view.lens.focal_mm / 0.006
        assert u_px.mean() == pytest.approx(u0_px + math.tan(0.15) * focal_px, abs=4.0)
        assert v_px.mean() == pytest.approx(v0_px, abs=2.0)


def test_glare_spreads_its_share_and_conserves_the_light(clean: Unit) -> None:
    veiled = Unit(replace(CLEAN, hard=Hardness(glare_share=0.05)))
    pose = BeamPose(0.0, 0.0)
    sharp, seen = light(clean, REAR, pose), light(veiled, REAR, pose)
    assert seen.sum() == pytest.approx(sharp.sum(), rel=3e-3)  # light beside the chip is lost
    beside = sharp < 1e-6 * sharp.max()
    assert 0.02 < seen[beside].sum() / seen.sum() < 0.05
    assert first_moment(seen) == pytest.approx(first_moment(sharp), abs=0.15)


def test_dots_of_a_flawed_print_are_displaced_and_grown_by_what_is_stated() -> None:
    """Their light, one spot a dot: places and areas against those of the same print without flaws."""
    dots = DotPattern(diameter_mm=1.5, pitch_mm=4.0, hexagonal=False)
    drawn = Unit(replace(CLEAN, dots=dots)).imagers[FRONT].view
    flawed = Unit(replace(CLEAN, dots=dots, hard=Hardness(jitter_mm=0.1, bleed_mm=0.05))).imagers[FRONT].view
    dot = make_dots(dots, np.random.default_rng(np.random.SeedSequence(CLEAN.seed).spawn(1)[0]))
    moved, area = [], []
    for column in range(-14, 14):
        for row in range(-11, 11):
            turn, (x0, y0) = dot.rotation_rad, dot.phase_mm
            x = x0 + 4.0 * (column * math.cos(turn) - row * math.sin(turn))
            y = y0 + 4.0 * (column * math.sin(turn) + row * math.cos(turn))
            here = np.hypot(drawn.x_mm - x, drawn.y_mm - y) < 1.6
            if here.sum() < 90:
                continue
            sums = []
            for view in (drawn, flawed):
                ink = view.response[here].astype(np.float64)
                sums.append((ink @ view.x_mm[here] / ink.sum(), ink @ view.y_mm[here] / ink.sum(), ink.sum()))
            moved += [sums[1][0] - sums[0][0], sums[1][1] - sums[0][1]]
            area.append(sums[1][2] / sums[0][2])
    assert len(area) > 300
    assert np.std(moved) == pytest.approx(0.1, rel=0.1)
    # area goes with the square of the radius
    assert np.std(area) == pytest.approx(2.0 * 0.05 / 0.75, rel=0.1)
    assert np.mean(area) == pytest.approx(1.0, abs=0.02)


def test_the_command_records_a_hard_unit(tmp_path: Path) -> None:
    truth = tmp_path / "truth.json"
    arguments = ["--poses", "1", "--exposures", "1", "--seed", "3", "--hard"]
    assert main(["measure", "-o", str(tmp_path / "poses"), "--truth", str(truth), *arguments]) == 0
    (pose,) = json.loads(truth.read_text())["poses"]
    unit = Unit(UnitConfig(seed=3, hard=HARD))
    unit.place(BeamPose(**pose))
    recorded = cv2.imread(str(tmp_path / "poses" / "rear" / "000000.png"), cv2.IMREAD_UNCHANGED)
    assert np.array_equal(recorded, unit.expose(REAR, 0, 0, exact=True).pixels)
