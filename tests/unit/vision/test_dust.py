"""Specks under a spot, counted in pictures whose dust is known by their geometry; an unseen smear."""

import math

import cv2
import numpy as np
import pytest
from support.frames import HEIGHT, WIDTH, Blob, frame, light

from altd.records import Frame, Spot
from altd.vision.dust import DustCount, count_dust
from altd.vision.flat import Flat
from altd.vision.frame_analysis import FrameAnalysis
from altd.vision.image import Image
from altd.vision.localise import locate
from altd.vision.settings import SpotReference, SpotSettings
from altd.vision.texture import Texture

ROWS, COLUMNS = 240, 320
V, U = np.mgrid[0:ROWS, 0:COLUMNS].astype(np.float32)
MIDDLE = 158.3, 121.7
ELECTRONS_PER_COUNT = 40.0


def grain(contrast: float, seed: int = 1) -> Image:
    """A plate whose grain has this contrast, blurred as by a lens."""
    noise = np.random.default_rng(seed).normal(0, 1, (ROWS, COLUMNS)).astype(np.float32)
    blurred = cv2.GaussianBlur(noise, (0, 0), 0.8)
    return np.asarray(1 + contrast * blurred / blurred.std(), dtype=np.float32)


def dots(pitch_px: float = 6.5) -> Image:
    """A print of bright dots, a third of the area."""
    u, v = (np.mod(place + 0.3, pitch_px) - pitch_px / 2 for place in (U, V))
    edge = np.clip(pitch_px * 0.33 - np.hypot(u, v) + 0.5, 0, 1)
    return np.asarray(cv2.GaussianBlur(edge, (0, 0), 0.7), dtype=np.float32) + np.float32(0.02)


def specks(*places: tuple[float, float, float]) -> Image:
    """The light past opaque discs at (u, v) from the spot's middle, of a diameter in px, blurred a little."""
    passes = np.ones((ROWS, COLUMNS), np.float32)
    for right, down, diameter in places:
        distance = np.hypot(U - MIDDLE[0] - right, V - MIDDLE[1] - down)
        passes *= 1 - np.clip(diameter / 2 - distance + 0.5, 0, 1)
    return np.asarray(cv2.GaussianBlur(passes, (0, 0), 0.7), dtype=np.float32)


def seen(
    response: Image,
    texture: Texture,
    *,
    peak: float = 170.0,
    radius_px: float = 24.0,
    shift_px: tuple[float, float] = (0.0, 0.0),
    seed: int = 5,
) -> DustCount | None:
    """The count under a Gaussian spot of this 1/e² radius, with photon noise, on a shifted picture."""
    rng = np.random.default_rng(seed)
    moved = np.array([[1, 0, shift_px[0]], [0, 1, shift_px[1]]])
    there = cv2.warpAffine(response, moved, (COLUMNS, ROWS), flags=cv2.INTER_LANCZOS4)
    spot = np.exp(-2 * ((U - MIDDLE[0]) ** 2 + (V - MIDDLE[1]) ** 2) / radius_px**2)
    light = peak * spot * there / response.mean() + 6.0
    counts = light + rng.normal(0, 1, light.shape) * np.sqrt(np.maximum(light, 0) / ELECTRONS_PER_COUNT + 0.5)
    pixels = np.clip(np.rint(counts), 0, 255).astype(np.uint8)
    settings = SpotSettings(full_well_electrons=ELECTRONS_PER_COUNT * 255)
    return count_dust(FrameAnalysis(Frame("front", 0, 0, pixels, 8), settings), texture)


def texture_of(response: Image) -> Texture:
    return Texture.of_flat(Flat.from_response(response, "recording"))


def share(count: DustCount | None) -> float:
    return count.covered / count.looked_at


@pytest.mark.parametrize("response", [grain(0.06), grain(0.15), dots()], ids=["plate", "coarse", "print"])
@pytest.mark.parametrize("shift_px", [(0.0, 0.0), (0.3, -0.2), (0.5, 0.5), (4.4, -3.7)], ids=str)
@pytest.mark.parametrize("peak", [40.0, 80.0])
def test_a_clean_surface_has_none_however_the_camera_drifts_and_whatever_the_light(
    response: Image, shift_px: tuple[float, float], peak: float
) -> None:
    counts = [
        seen(response, texture_of(response), peak=peak, shift_px=shift_px, seed=seed) for seed in range(5)
    ]
    assert max(share(count) for count in counts) <= 0.002
    assert sum(count.covered for count in counts if count) <= 2


@pytest.mark.parametrize("diameter_px", [2.5, 4.0, 6.0])
def test_on_a_plate_the_area_of_specks_is_counted(diameter_px: float) -> None:
    """Discs of known area; of a blurred disc's edge some belongs to it."""
    plate = grain(0.06)
    places = [(0.0, 0.0), (10.5, 4.2), (-8.4, 6.3), (2.1, -11.3)]
    dusty = plate * specks(*((right, down, diameter_px) for right, down in places))
    count = seen(dusty, texture_of(plate))
    area_px = len(places) * math.pi / 4 * diameter_px**2
    assert 0.6 * area_px < count.covered < 1.3 * area_px


def test_on_a_print_specks_are_counted_as_a_share_of_what_is_bright() -> None:
    response = dots()
    rng = np.random.default_rng(8)
    counted, true = [], []
    for _ in range(20):
        places = [(*rng.uniform(-14, 14, 2), 4.0) for _ in range(2)]
        true.append(1 - float(specks(*places)[108:136, 144:173].mean()))
        dusty = response * specks(*places)
        counted.append(share(seen(dusty, texture_of(response), peak=70.0, radius_px=20.0)))
    assert np.mean(true) > 0.02
    assert 0.4 * np.mean(true) < np.mean(counted) < 1.3 * np.mean(true)


def test_a_smear_a_dim_spot_and_coarse_speckle_are_no_dust() -> None:
    plate = grain(0.06)
    smear = 1 - 0.4 * np.exp(-0.5 * ((U - 150) ** 2 + (V - 110) ** 2) / 12.0**2)
    assert share(seen(np.asarray(plate * smear, np.float32), texture_of(plate))) == 0
    foreign = grain(0.3, seed=7)  # of another laser
    assert share(seen(np.asarray(plate * foreign, np.float32), texture_of(plate), peak=90.0)) < 0.001
    dim = seen(plate, texture_of(plate), peak=6.0)
    assert dim is None or dim.covered == 0


def test_where_the_calibration_knows_nothing_a_plate_is_looked_at_and_a_print_is_not() -> None:
    plate, printed = grain(0.06), dots()
    nothing = np.zeros((ROWS, COLUMNS), np.float32)
    beside = np.where(V < 40, texture_of(printed).relative, 0).astype(np.float32)
    dusty = plate * specks((5.0, 5.0, 5.0))
    assert share(seen(dusty, Texture(nothing))) > 0.005
    assert share(seen(plate, Texture(nothing))) == 0
    assert seen(printed, Texture(beside)) is None


def test_without_a_spot_there_is_nothing_to_see() -> None:
    plate = grain(0.06)
    assert seen(plate, texture_of(plate), peak=0.0) is None


DIAMETER_PX = 44.0
CLEAN_PLATE = SpotReference(grain=0.005, misfit_ratio=1.0, pattern_px=0.005, noise_px=0.006, shape=None)


@pytest.mark.parametrize("slope_per_px", [0.0005, -0.0015, 0.003])
def test_a_spot_behind_an_even_slope_of_transmission_is_the_same_spot_elsewhere(slope_per_px: float) -> None:
    """Undetectable: exp(−8 u²/d² − s·u) is the same Gaussian with its middle at −s·d²/16.

    So no sigma can hold what grease does: nothing but the place differs. docs/reasons.md says how much.
    """
    middle_u = 371.3
    clean = light(Blob(middle_u, 240.7, DIAMETER_PX))
    passes = np.exp(-slope_per_px * (np.arange(WIDTH) - middle_u))
    even = Flat.from_response(np.ones((HEIGHT, WIDTH)), "recording")
    spots = []
    for image in (clean, clean * passes):
        found = locate(frame(image, np.random.default_rng(6), 0.5), flat=even, reference=CLEAN_PLATE)
        assert isinstance(found, Spot)
        spots.append(found)
    before, behind = spots
    assert behind.u_px - before.u_px == pytest.approx(-slope_per_px * DIAMETER_PX**2 / 16, abs=0.005)
    assert behind.v_px == pytest.approx(before.v_px, abs=0.005)
    assert behind.sigma_px == pytest.approx(before.sigma_px, rel=0.01)
    assert behind.excess_px == pytest.approx(before.excess_px, abs=0.005)
    assert (behind.shape.a, behind.shape.c, behind.shape.order) == pytest.approx(
        (before.shape.a, before.shape.c, before.shape.order), rel=0.002
    )
