"""Light that one spot does not explain: what noise and grain make of the statistic, and what else does."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from support.frames import HEIGHT, WIDTH, Blob, frame, light

from altd.reasons import Reason
from altd.records import NoSpot, Spot
from altd.vision.localise import fitted_profile, locate
from altd.vision.misfit import excess_sigmas, misfit_of
from altd.vision.settings import SpotReference, SpotSettings

GRAIN = 0.1
USUAL = SpotReference(grain=GRAIN, misfit_ratio=1.0, pattern_px=0.017, noise_px=0.02, shape=None)
Picture = np.ndarray[tuple[int, int], np.dtype[np.float64]]


def grainy(image: Picture, rng: np.random.Generator) -> Picture:
    """Light on a surface whose pixels scatter it unequally."""
    return image * (1 + GRAIN * rng.standard_normal(image.shape))


def blob(rng: np.random.Generator) -> Blob:
    u, v = rng.uniform(100, WIDTH - 100), rng.uniform(100, HEIGHT - 100)
    return Blob(u, v, rng.uniform(45, 70), rng.uniform(45, 70), rng.uniform(0, 3))


def test_on_good_spots_it_is_distributed_as_chi_square() -> None:
    rng = np.random.default_rng(1)
    misfits = []
    for _ in range(150):
        profile = fitted_profile(frame(grainy(light(blob(rng)), rng), rng), SpotSettings(), None)
        assert profile is not None
        misfit = misfit_of(profile.residuals, GRAIN)
        assert misfit is not None
        misfits.append(misfit)
    ratio = np.array([misfit.chi2 / misfit.degrees_of_freedom for misfit in misfits])
    degrees_of_freedom = float(np.mean([misfit.degrees_of_freedom for misfit in misfits]))
    assert ratio.mean() == pytest.approx(1.0, abs=0.08)
    assert ratio.std() == pytest.approx(np.sqrt(2 / degrees_of_freedom), rel=0.25)
    assert max(excess_sigmas(misfit.chi2, misfit.degrees_of_freedom) for misfit in misfits) < 4


def test_sigmas_of_a_chi_square_are_those_of_its_quantiles() -> None:
    """Quantiles of chi-square with 26 degrees of freedom at 1, 2 and 3 sigma, from tables."""
    for quantile, sigmas in ((33.04, 1.0), (41.91, 2.0), (52.6, 3.0)):
        assert excess_sigmas(quantile, 26) == pytest.approx(sigmas, abs=0.1)


def beside(share: float, diameters: float) -> Callable[[Blob, Picture], Picture]:
    def spoil(spot: Blob, image: Picture) -> Picture:
        second = Blob(spot.u_px + diameters * spot.diameter_px, spot.v_px, 50, peak=share * spot.peak)
        return image + light(second)

    return spoil


def shadow(depth: float) -> Callable[[Blob, Picture], Picture]:
    def spoil(spot: Blob, image: Picture) -> Picture:
        darker = image.copy()
        darker[:, : int(spot.u_px)] *= 1 - depth
        return darker

    return spoil


def zeroed_rows(spot: Blob, image: Picture) -> Picture:
    torn = image.copy()
    torn[int(spot.v_px) + 4 : int(spot.v_px) + 14] = 0
    return torn


def torn_picture(spot: Blob, image: Picture) -> Picture:
    torn = image.copy()
    torn[int(spot.v_px) :] = np.roll(image[int(spot.v_px) :], 12, axis=1)
    return torn


@pytest.mark.parametrize(
    "spoil",
    [
        beside(0.1, 0.5),
        beside(0.2, 0.6),
        beside(0.25, 0.8),
        shadow(1.0),
        shadow(0.4),
        zeroed_rows,
        torn_picture,
    ],
    ids=["10% near", "20%", "25% far", "half black", "40% darker", "zeroed rows", "torn"],
)
def test_light_that_is_not_one_spot_is_distorted(spoil: Callable[[Blob, Picture], Picture]) -> None:
    rng = np.random.default_rng(2)
    for _ in range(6):
        spot = blob(rng)
        spoilt = frame(grainy(spoil(spot, light(spot)), rng), rng)
        assert not isinstance(unchecked := locate(spoilt), NoSpot) or unchecked.reason is Reason.AMBIGUOUS
        outcome = locate(spoilt, reference=USUAL)
        assert isinstance(outcome, NoSpot)
        assert outcome.reason in (Reason.DISTORTED, Reason.AMBIGUOUS)


@pytest.mark.parametrize("spoil", [shadow(0.1), beside(0.1, 0.28), beside(0.05, 0.5)])
def test_what_displaces_a_spot_less_adds_to_its_sigma(spoil: Callable[[Blob, Picture], Picture]) -> None:
    rng = np.random.default_rng(3)
    for _ in range(8):
        spot = blob(rng)
        outcome = locate(frame(grainy(spoil(spot, light(spot)), rng), rng), reference=USUAL)
        if isinstance(outcome, NoSpot):
            assert outcome.reason is Reason.DISTORTED
            continue
        error_px = np.hypot(outcome.u_px - spot.u_px, outcome.v_px - spot.v_px)
        sigma_px = np.sqrt(outcome.sigma_px**2 + outcome.excess_px**2 + USUAL.noise_px**2)
        assert error_px < 7 * sigma_px


def test_a_spot_of_too_few_blocks_tells_nothing() -> None:
    profile = fitted_profile(frame(light(Blob(300, 200, 60)), np.random.default_rng(1)), SpotSettings(), None)
    assert profile is not None
    for kept in (0, 1, 5):
        blocks, solution = profile.residuals.blocks, profile.residuals.solution
        few = replace(
            profile.residuals,
            blocks=replace(blocks, rows=blocks.rows[:, :kept]),
            solution=replace(solution, rows=solution.rows[:, :kept]),
        )
        assert misfit_of(few, GRAIN) is None


def test_dust_on_the_window_is_not_distorted() -> None:
    rng = np.random.default_rng(5)
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    for _ in range(12):
        spot = blob(rng)
        image = light(spot)
        for _ in range(6):
            at = spot.u_px + rng.uniform(-30, 30), spot.v_px + rng.uniform(-30, 30)
            image *= 1 - rng.uniform(0.3, 1) * np.exp(-((u - at[0]) ** 2 + (v - at[1]) ** 2) / (2 * 0.8**2))
        outcome = locate(frame(grainy(image, rng), rng), reference=USUAL)
        assert isinstance(outcome, Spot), outcome
        error_px = np.hypot(outcome.u_px - spot.u_px, outcome.v_px - spot.v_px)
        assert error_px < 5 * np.sqrt(outcome.sigma_px**2 + outcome.excess_px**2 + USUAL.noise_px**2)


def on_print(image: Picture) -> Picture:
    """Dots of 2.4 px, 4.2 px from each other: without a flat such a spot is localised by its moments."""
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    turned_u, turned_v = u + 0.05 * v, v - 0.05 * u
    beside = np.hypot((turned_u + 2.1) % 4.2 - 2.1, (turned_v + 2.1) % 4.2 - 2.1)
    return image * (np.clip(1.7 - beside, 0, 1) * 0.95 + 0.05)


def disc_in_half_shadow(rng: np.random.Generator, radius_px: float) -> Picture:
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    u_px, v_px = 370 + rng.uniform(-5, 5), 240 + rng.uniform(-5, 5)
    disc = 180.0 * (np.hypot(u - u_px, v - v_px) < radius_px)
    return np.where(u > u_px + 0.3 * radius_px, 0.02 * disc, disc)


@pytest.mark.parametrize("radius_px", [6.0, 12.0, 20.0])
def test_what_no_profile_fits_is_no_spot_on_print_either(radius_px: float) -> None:
    """Its moments are those of something; nothing would vouch for them."""
    rng = np.random.default_rng(11)
    for _ in range(8):
        outcome = locate(
            frame(on_print(disc_in_half_shadow(rng, radius_px)), rng), SpotSettings(), None, USUAL
        )
        assert isinstance(outcome, NoSpot) or outcome.shape is not None


def test_good_spots_on_print_have_a_profile() -> None:
    rng = np.random.default_rng(12)
    for _ in range(8):
        outcome = locate(frame(on_print(light(blob(rng))), rng), SpotSettings(), None, USUAL)
        assert isinstance(outcome, NoSpot) or outcome.shape is not None
        assert not isinstance(outcome, NoSpot) or outcome.reason is not Reason.WRONG_SHAPE, outcome
