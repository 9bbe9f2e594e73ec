from dataclasses import replace

import numpy as np
import pytest
from support import evidence
from support.frames import HEIGHT, WIDTH
from support.led_frames import LEDS, Motion

from altd.records import Frame
from altd.selfcheck import drift
from altd.selfcheck.drift import Fitted, chi2_limit, fit_similarity
from altd.selfcheck.lights import Lights
from altd.selfcheck.records import LedView, Limits, Similarity

ABOUT = LEDS.mean(axis=0)
RADIUS_PX = float(np.sqrt(np.mean(np.sum((LEDS - ABOUT) ** 2, axis=1))))


def fitted(then: np.ndarray, now: np.ndarray, sigma: np.ndarray) -> Fitted:
    return fit_similarity(then, now, sigma, ABOUT, RADIUS_PX)


@pytest.mark.parametrize("motion", [Motion(), Motion(0.3, -0.1, 0.05, -400), Motion(-9, 4, -3, 20_000)])
@pytest.mark.parametrize("used", [range(6), (0, 2, 5)])
def test_what_moved_is_found_about_the_centroid_of_all_references(motion: Motion, used: object) -> None:
    rows = list(used)  # type: ignore[call-overload]
    found = fitted(LEDS[rows], motion.of(LEDS)[rows], np.full(len(rows), 0.01)).similarity
    assert found.shift_px == pytest.approx((motion.u_px, motion.v_px), abs=1e-9)
    assert found.turn_deg == pytest.approx(motion.turn_deg, abs=1e-9)
    assert found.scale_ppm == pytest.approx(motion.scale_ppm, abs=1e-5)
    anywhere = np.array([[10.0, 20.0], [700.0, 100.0]])
    assert found.now_px(anywhere) == pytest.approx(motion.of(anywhere), abs=1e-9)
    assert found.then_px(found.now_px(anywhere)) == pytest.approx(anywhere, abs=1e-9)


def test_the_covariance_is_that_of_many_checks_with_noise_of_each_led() -> None:
    rng = np.random.default_rng(3)
    sigma = np.array([0.01, 0.03, 0.01, 0.05, 0.01])
    then = LEDS[:5]
    found = []
    chi2 = []
    place = np.array([[80.0, 300.0]])
    places = []
    for _ in range(4000):
        result = fitted(then, then + rng.normal(0, sigma[:, None], then.shape), sigma)
        found.append(result.similarity.vector)
        chi2.append(result.chi2)
        places.append(result.similarity.now_px(place)[0])
    example: Similarity = result.similarity
    assert np.std(found, axis=0) == pytest.approx(np.sqrt(np.diag(example.covariance)), rel=0.05)
    distances = np.einsum("ni,ij,nj->n", found, np.linalg.inv(example.covariance), found)
    assert np.mean(distances) == pytest.approx(4, rel=0.05)
    assert np.mean(chi2) == pytest.approx(2 * 5 - 4, rel=0.05)
    expected = example.covariance_at_px2(80.0, 300.0)
    assert np.cov(np.array(places).T) == pytest.approx(expected, rel=0.1, abs=5e-6)


@pytest.mark.parametrize("freedom", [2, 8, 20])
def test_the_chi2_limit_is_exceeded_as_rarely_as_three_sigmas(freedom: int) -> None:
    draws = np.random.default_rng(4).chisquare(freedom, 2_000_000)
    assert np.mean(draws > chi2_limit(freedom, 3.0)) == pytest.approx(1.35e-3, rel=0.15)


def test_without_freedom_nothing_can_disagree() -> None:
    assert chi2_limit(0, 4.5) == float("inf")


def test_three_leds_on_the_pixel_raster_do_not_feign_a_motion(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each LED's place is off by 0.0025 px rms, the same in all pairs: χ² (4) exceeds 18.5 in 0.1 %."""
    rng = np.random.default_rng(8)
    empty = Frame("camera", 0, 0, np.zeros((HEIGHT, WIDTH), np.uint8), 8)
    view = LedView((replace(empty, leds_on=True),) * 2, (empty,) * 2)
    calibrated = replace(evidence.target("front"), leds_px=LEDS[:3])
    squares = []
    for _ in range(30):
        off_px = rng.normal(0.0, 0.0025, (3, 2))

        def lights(*_: object, off_px: np.ndarray = off_px) -> Lights:
            places = LEDS[:3] + off_px + rng.normal(0.0, 0.001, (3, 2))
            return Lights(places, np.full(3, 0.001), np.full(3, 180.0), np.full(3, 18.0))

        monkeypatch.setattr(drift, "lights_of", lights)
        found = drift.drift_of("front", view, calibrated, Limits())
        assert found.significance is not None
        squares.append(found.significance**2)
    assert max(squares) < 18.5
    assert np.mean(squares) > 1.0
