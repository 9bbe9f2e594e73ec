"""Spots on many frames, against sigma, bounds, a foreign program and bit depths; frames without one."""

from pathlib import Path

import cv2
import laserbeamsize
import numpy as np
import pytest
from support.cramer_rao import cramer_rao
from support.frames import Blob, frame, light
from support.photographs import ELECTRONS_PER_COUNT, READ_COUNTS, SIZE, dots, found, photographed

from altd.measuring.calibration import Calibration
from altd.reasons import Reason
from altd.records import Frame, NoSpot, Spot
from altd.vision.ellipse import ellipse
from altd.vision.flat import Flat
from altd.vision.frame_analysis import Patch, patch_around
from altd.vision.image import Centre, Noise
from altd.vision.localise import locate, locate_ellipse
from altd.vision.search import search
from altd.vision.settings import SpotSettings
from hw_sim.beam import BeamPose
from hw_sim.faults import Fault
from hw_sim.unit import CAMERAS, FRONT, REAR, Unit, UnitConfig


def test_sigma_is_the_scatter_that_read_and_shot_noise_make() -> None:
    rng = np.random.default_rng(1)
    full_well, full_scale, read = 15_000.0, 255.0, 2.0
    image = light(Blob(380.4, 240.2))
    positions, sigmas = [], []
    for _ in range(120):
        electrons = rng.poisson((image + 8) * full_well / full_scale)
        noisy = electrons * full_scale / full_well - 8
        spot = locate(frame(noisy, rng, noise=read))
        assert isinstance(spot, Spot), spot
        positions.append((spot.u_px, spot.v_px))
        sigmas.append(spot.sigma_px)
    scatter = np.sqrt(np.var(positions, axis=0, ddof=1).mean())
    assert np.mean(sigmas) / scatter == pytest.approx(1.0, abs=0.15)


def rms_and_bound_px(
    frames: int, response: np.ndarray, flat: Flat | None, peak: float, seed: int
) -> tuple[float, float, int]:
    """Rms error per axis, the bound's, and how many frames gave no spot."""
    rng = np.random.default_rng(seed)
    errors, bounds, failures = [], [], 0
    for index in range(frames):
        u, v = rng.uniform(78, 90, 2)
        diameters = rng.uniform(38, 48, 2)
        angle = rng.uniform(0, np.pi)

        def mean(p: np.ndarray, angle: float = angle) -> np.ndarray:
            return response * light(Blob(p[1], p[2], p[3], p[4], angle, p[0]), width=SIZE, height=SIZE)

        truth = np.array([peak, u, v, *diameters])
        expected = mean(truth)
        spot = locate(photographed(expected, rng), flat=flat)
        if not isinstance(spot, Spot):
            failures += 1
            continue
        errors.append((spot.u_px - u, spot.v_px - v))
        if index % 10 == 0:
            variance = READ_COUNTS**2 + 1 / 12 + expected / ELECTRONS_PER_COUNT
            bounds.append(np.diag(cramer_rao(mean, truth, variance))[1:3])
    return float(np.sqrt(np.mean(np.square(errors)))), float(np.sqrt(np.mean(bounds))), failures


def test_on_a_clean_target_the_error_is_the_bound() -> None:
    rms_px, bound_px, failures = rms_and_bound_px(700, np.ones((SIZE, SIZE)), None, 150.0, seed=1)
    assert failures == 0
    assert rms_px <= 1.15 * bound_px
    assert rms_px >= 0.9 * bound_px  # nothing beats the bound: else frames or bound are wrong


def test_on_print_with_a_flat_the_error_is_near_the_bound() -> None:
    response = dots()
    rms_px, bound_px, failures = rms_and_bound_px(
        300, response, Flat.from_response(response, "recording"), 45.0, 2
    )
    assert failures == 0
    assert 0.9 * bound_px <= rms_px <= 1.5 * bound_px


SETTINGS = SpotSettings()


def seen(picture: Frame, read: float, flat: Flat | None = None) -> Centre:
    """The ellipse with the noise that is true: what it says is then its own doing."""
    found_there = search(picture.pixels)
    patch = patch_around(picture, found_there.regions[0], found_there, SETTINGS)
    assert isinstance(patch, Patch)
    noise = Noise(np.sqrt(read**2 + 1 / 12), ELECTRONS_PER_COUNT)
    return found(ellipse(patch, noise, SETTINGS, flat))


@pytest.mark.parametrize(
    ("peak", "read", "second_px", "most_bounds"),
    [(150.0, 0.7, 42.0, 1.35), (20.0, 0.7, 42.0, 1.25), (150.0, 3.0, 42.0, 1.25), (150.0, 0.7, 26.0, 1.5)],
)
def test_its_error_is_what_it_says_and_near_the_bound(
    peak: float, read: float, second_px: float, most_bounds: float
) -> None:
    def mean(p: np.ndarray) -> np.ndarray:
        return light(Blob(p[1], p[2], p[3], p[4], 0.5, p[0]), width=SIZE, height=SIZE)

    rng = np.random.default_rng(1)
    errors, sigmas, bounds = [], [], []
    for index in range(250):
        truth = np.array([peak, *rng.uniform(80, 88, 2), 42.0, second_px + 1e-3])
        expected = mean(truth)
        centre = seen(photographed(expected, rng, read), read)
        errors.append((centre.u_px - truth[1], centre.v_px - truth[2]))
        sigmas.append(centre.sigma_px)
        if index % 50 == 0:
            variance = read**2 + 1 / 12 + expected / ELECTRONS_PER_COUNT
            bounds.append(np.diag(cramer_rao(mean, truth, variance))[1:3])
    rms_px, sigma_px = (float(np.sqrt(np.mean(np.square(values)))) for values in (errors, sigmas))
    assert 0.85 < rms_px / sigma_px < 1.15
    assert 0.95 < rms_px / float(np.sqrt(np.mean(bounds))) < most_bounds


@pytest.mark.parametrize("surface", ["print", "grain"])
def test_through_the_flat_neither_print_nor_grain_moves_it(surface: str) -> None:
    rng = np.random.default_rng(3)
    v, u = np.mgrid[:SIZE, :SIZE]
    wave = 2 * np.pi / 6.0
    response = (
        1 + 0.45 * (np.cos(wave * u + 0.1 * v) + np.cos(wave * v - 0.1 * u))
        if surface == "print"
        else np.maximum(1 + 0.2 * rng.standard_normal((SIZE, SIZE)), 0.1)
    )
    flat = Flat.from_response(response, "recording")
    with_flat, without, sigmas = [], [], []
    for _ in range(250):
        at_u, at_v = rng.uniform(74, 94, 2)
        diameters = rng.uniform(36, 50, 2)
        blob = Blob(at_u, at_v, *diameters, rng.uniform(0, np.pi), 90.0)
        picture = photographed(response * light(blob, width=SIZE, height=SIZE), rng)
        centre, bare = seen(picture, 0.7, flat), seen(picture, 0.7)
        with_flat.append((centre.u_px - at_u, centre.v_px - at_v))
        without.append((bare.u_px - at_u, bare.v_px - at_v))
        sigmas.append(centre.sigma_px)
    rms_px, bare_px, sigma_px = (float(np.sqrt(np.mean(np.square(x)))) for x in (with_flat, without, sigmas))
    assert 0.85 < rms_px / sigma_px < 1.15
    if surface == "grain":  # the smoothing alone evens out so fine a print
        assert bare_px > 3 * rms_px


def iso_centroid_and_diameter(image: np.ndarray, spot: Spot) -> tuple[float, float, float]:
    """First moment on the region around the beam, a plane background through the region's rim taken off."""
    half = 1.25 * spot.diameter_px
    left, top = max(int(spot.u_px - half), 0), max(int(spot.v_px - half), 0)
    region = image[top : int(spot.v_px + half) + 1, left : int(spot.u_px + half) + 1].astype(float)
    v, u = np.mgrid[: region.shape[0], : region.shape[1]]
    rim = np.ones(region.shape, bool)
    width = max(4, len(region) // 20)
    rim[width:-width, width:-width] = False
    design = np.column_stack([np.ones(rim.sum()), u[rim], v[rim]])
    plane = np.linalg.lstsq(design, region[rim], rcond=None)[0]
    region -= plane[0] + plane[1] * u + plane[2] * v
    x, y, major, minor, _ = laserbeamsize.beam_size(region)
    return left + x, top + y, (major + minor) / 2


@pytest.mark.parametrize("name", ["TEM00_200mm.pgm", "k-500mm.png", "t-348mm.pgm", "t-hene.pgm"])
def test_a_real_beam_is_found_within_3_percent_of_its_diameter(name: str, shared_data: Path) -> None:
    image = cv2.imread(str(shared_data / "beams" / name), cv2.IMREAD_UNCHANGED)
    frame = Frame("photograph", 0, 0, image, 8 * image.dtype.itemsize)
    spot = locate(frame)
    assert isinstance(spot, Spot), spot
    x, y, diameter = iso_centroid_and_diameter(image, spot)
    assert np.hypot(spot.u_px - x, spot.v_px - y) < 0.03 * diameter
    second = locate_ellipse(frame)
    assert second is not None
    assert np.hypot(second.u_px - x, second.v_px - y) < 0.04 * diameter


DEPTHS = (8, 10, 12, 16)
EXPOSURES = 16
POSES = (BeamPose(0.0, 0.0), BeamPose(30.3, 20.7, 0.05, 0.02), BeamPose(-41.2, 11.3, -0.03, 0.08))


@pytest.fixture(scope="module")
def units() -> dict[int, Unit]:
    return {bits: Unit(UnitConfig(seed=3, bits=bits)) for bits in DEPTHS}


@pytest.fixture(scope="module")
def off_px(units: dict[int, Unit], calibration_of_unit_3: Calibration) -> dict[str, np.ndarray]:
    """Positions less those with 16 bits, by camera: (8, 10, 12 bits; poses; exposures; u, v)."""
    targets = {target.name: target for target in calibration_of_unit_3.targets}

    def at(camera: str, bits: int, pose: BeamPose, sequence: int) -> tuple[float, float]:
        units[bits].place(pose)
        taken = units[bits].expose(camera, sequence, 0, exact=True)
        spot = locate(taken, targets[camera].localiser, targets[camera].flat)
        assert isinstance(spot, Spot)
        return spot.u_px, spot.v_px

    numbers = range(EXPOSURES)
    found = {
        camera: np.array(
            [[[at(camera, bits, pose, n) for n in numbers] for pose in POSES] for bits in DEPTHS]
        )
        for camera in CAMERAS
    }
    return {camera: places[:-1] - places[-1] for camera, places in found.items()}


def test_the_depths_see_the_same_electrons(units: dict[int, Unit]) -> None:
    frames = {bits: unit.expose(FRONT, 7, 0, exact=True) for bits, unit in units.items()}
    shares = {bits: taken.pixels / taken.full_scale for bits, taken in frames.items()}
    for bits, share in shares.items():
        assert np.abs(share - shares[16]).max() <= 0.5 / frames[bits].full_scale + 1e-4


@pytest.mark.parametrize("camera", [FRONT, REAR])
def test_what_is_measured_is_the_same_within_a_hundredth_of_a_pixel(
    camera: str, off_px: dict[str, np.ndarray]
) -> None:
    """The mean of a window; one of 16 exposures, the daemon takes 20."""
    assert np.hypot(*np.moveaxis(off_px[camera].mean(axis=2), -1, 0)).max() <= 0.01


@pytest.mark.parametrize("camera", [FRONT, REAR])
@pytest.mark.parametrize(("bits", "limit_px"), [(8, 0.012), (10, 0.005), (12, 0.002)])
def test_a_single_frame_differs_by_what_rounding_adds(
    bits: int, limit_px: float, camera: str, off_px: dict[str, np.ndarray]
) -> None:
    """Rounding to 8 bits is noise of 0.29 counts beside 0.68 counts of the read-out: rms over u and v."""
    off = off_px[camera][DEPTHS.index(bits)]
    assert np.sqrt(np.mean(np.sum(off**2, axis=-1))) <= limit_px


@pytest.mark.parametrize("lux", [0.0, 200.0, 1000.0])
def test_ambient_light_alone_is_no_spot(lux: float) -> None:
    for seed in (1, 3, 9, 12):
        unit = Unit(UnitConfig(seed=seed, lux=lux))
        unit.inject(Fault.NO_LASER)
        for camera in CAMERAS:
            outcome = locate(unit.expose(camera, 0, 0))
            assert isinstance(outcome, NoSpot)
            assert outcome.reason is Reason.SPOT_MISSING, (seed, camera, outcome)
