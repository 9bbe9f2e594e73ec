import math

import numpy as np
import pytest

from hw_sim.sensor import FULL_WELL_E, READ_NOISE_E, NoisePool, Sensor


def uniform(electrons: float) -> np.ndarray:
    return np.full((200, 250), electrons, dtype=np.float32)


@pytest.mark.parametrize("electrons", [0.0, 300.0, 3_000.0, 12_000.0])
def test_the_variance_is_that_of_photons_and_read_out(electrons: float) -> None:
    """The photon transfer curve: variance in electrons = mean + read noise²."""
    pixels = Sensor(bits=16).expose(uniform(electrons), 1.0, np.random.default_rng(2)).astype(np.float64)
    counts_per_e = 65_535 / FULL_WELL_E
    variance_e = pixels.var() / counts_per_e**2
    assert variance_e == pytest.approx(electrons + READ_NOISE_E**2, rel=4.0 * math.sqrt(2.0 / pixels.size))


def test_pooled_noise_has_the_same_spread_as_drawn_photons() -> None:
    sensor, pool = Sensor(bits=12), NoisePool(np.random.default_rng(3))
    mean_e = uniform(5_000.0)
    drawn = sensor.expose(mean_e, 1.0, np.random.default_rng(4)).astype(np.float64)
    spread = sensor.noise_counts(mean_e, 1.0) * pool.stretch(9, mean_e.shape)
    pooled = sensor.quantise(sensor.mean_counts(mean_e, 1.0) + spread).astype(np.float64)
    assert pooled.mean() == pytest.approx(drawn.mean(), abs=0.5)
    assert pooled.std() == pytest.approx(drawn.std(), rel=0.02)


def test_stretches_of_the_pool_are_repeatable_and_do_not_resemble_each_other() -> None:
    pool = NoisePool(np.random.default_rng(5))
    first = pool.stretch(1, (480, 752))
    assert np.array_equal(first, pool.stretch(1, (480, 752)))
    for key in range(2, 12):
        assert abs(float(np.corrcoef(first.ravel(), pool.stretch(key, (480, 752)).ravel())[0, 1])) < 0.01


@pytest.mark.parametrize(
    ("bits", "dtype"), [(8, np.uint8), (10, np.uint16), (12, np.uint16), (16, np.uint16)]
)
def test_a_full_well_reads_full_scale_and_never_wraps(bits: int, dtype: type) -> None:
    pixels = Sensor(bits).expose(uniform(10.0 * FULL_WELL_E), 4.0, np.random.default_rng(6))
    assert pixels.dtype == dtype
    assert set(np.unique(pixels)) == {2**bits - 1}


def test_darkness_reads_the_black_level() -> None:
    pixels = Sensor(8).expose(uniform(0.0), 1.0, np.random.default_rng(7))
    assert pixels.mean() == pytest.approx(4.0, abs=0.1)


def test_gain_multiplies_the_signal() -> None:
    sensor = Sensor(16)
    dark, single, double = (
        float(sensor.mean_counts(uniform(e), gain)[0, 0])
        for e, gain in ((0.0, 1.0), (2_000.0, 1.0), (2_000.0, 2.0))
    )
    assert double - dark == pytest.approx(2.0 * (single - dark), rel=1e-4)
