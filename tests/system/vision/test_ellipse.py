"""The ellipse's error on many frames, against its own sigma and the Cramér-Rao bound."""

import numpy as np
import pytest
from support.cramer_rao import cramer_rao
from support.frames import Blob, light
from support.photographs import ELECTRONS_PER_COUNT, SIZE, found, photographed

from altd.records import Frame
from altd.vision.ellipse import ellipse
from altd.vision.flat import Flat
from altd.vision.frame_analysis import Patch, patch_around
from altd.vision.image import Centre, Noise
from altd.vision.search import search
from altd.vision.settings import SpotSettings

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
        centre = seen(photographed(expected, read, rng), read)
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
    flat = Flat.of(response, "recording")
    with_flat, without, sigmas = [], [], []
    for _ in range(250):
        at_u, at_v = rng.uniform(74, 94, 2)
        diameters = rng.uniform(36, 50, 2)
        blob = Blob(at_u, at_v, *diameters, rng.uniform(0, np.pi), 90.0)
        picture = photographed(response * light(blob, width=SIZE, height=SIZE), 0.7, rng)
        centre, bare = seen(picture, 0.7, flat), seen(picture, 0.7)
        with_flat.append((centre.u_px - at_u, centre.v_px - at_v))
        without.append((bare.u_px - at_u, bare.v_px - at_v))
        sigmas.append(centre.sigma_px)
    rms_px, bare_px, sigma_px = (float(np.sqrt(np.mean(np.square(x)))) for x in (with_flat, without, sigmas))
    assert 0.85 < rms_px / sigma_px < 1.15
    if surface == "grain":  # the smoothing alone evens out so fine a print
        assert bare_px > 3 * rms_px
