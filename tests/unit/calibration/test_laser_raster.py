"""The laser's power in each exposure and its spot, from light whose formula is written here."""

import numpy as np
import pytest

from altd.calibration.laser_raster import Shot, SpotSums, true_excess

DIAMETER_MM, STEP_MM, SIZE_MM, BINS = 6.0, 3.0, 30, 49


def spot(x_mm: np.ndarray, y_mm: np.ndarray) -> np.ndarray:
    """A Gaussian beam's irradiance, 1 at its middle, exp(−2) at half its diameter."""
    return np.exp(-8.0 * (x_mm**2 + y_mm**2) / DIAMETER_MM**2)


def test_the_power_of_each_exposure_is_found_where_spots_overlap() -> None:
    """A response solved for constant power takes on a part of each exposure's excess, which seems smaller."""
    rng = np.random.default_rng(1)
    y_mm, x_mm = np.mgrid[:SIZE_MM, :SIZE_MM].astype(float)
    steps = np.arange(3.0, SIZE_MM - 2.0, STEP_MM)
    positions = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    lit = np.array([spot(x_mm - x, y_mm - y) for x, y in positions]).reshape(len(positions), -1)
    response = rng.uniform(0.7, 1.3, SIZE_MM**2)
    excess = 0.05 * np.prod(np.sin(2.0 * np.pi * positions / 9.0 + (0.0, 1.0)), axis=1)
    seen = (1.0 + excess)[:, None] * lit * response
    weights = 1.0 / (lit + 0.1)
    solved = (weights * lit * seen).sum(axis=0) / np.maximum((weights * lit * lit).sum(axis=0), 1e-9)
    expected = lit * solved
    seems = (weights * expected * seen).sum(axis=1) / (weights * expected**2).sum(axis=1) - 1.0
    offset = np.linspace(-DIAMETER_MM, DIAMETER_MM, BINS)
    profile = spot(*np.meshgrid(offset, offset))
    found = true_excess(
        positions,
        seems,
        np.full(len(positions), 1e-4),
        (profile**2 / (profile + 0.1)).astype(np.float32),
        DIAMETER_MM,
    )
    assert np.std(found - excess) < 0.15 * np.std(excess)
    assert np.polyfit(excess, seems, 1)[0] < 0.85
    assert np.polyfit(excess, found, 1)[0] == pytest.approx(1.0, abs=0.1)


def test_the_table_of_a_spot_is_its_profile_about_the_stage() -> None:
    """Light of 90 counts at any position of the stage: the table has its form, its peak the counts."""
    sums, per_mm, middle = SpotSums(), (BINS - 1) / 2 / DIAMETER_MM, (BINS - 1) / 2
    y_mm, x_mm = np.mgrid[:200, :200] * 0.1
    for x, y in ((9.0, 10.0), (10.03, 9.97), (11.0, 10.5)):
        along_x, along_y = ((mm * per_mm + middle).astype(np.float32) for mm in (x_mm - x, y_mm - y))
        counts = (90.0 * spot(x_mm - x, y_mm - y)).astype(np.float32)
        shot = Shot((x, y), counts, (slice(0, 200), slice(0, 200)), True, along_x, along_y)
        sums.add(shot)
    table, peak = sums.spot
    offset = (np.arange(BINS) - middle) / per_mm
    assert peak == pytest.approx(90.0, rel=0.02)
    assert table == pytest.approx(spot(*np.meshgrid(offset, offset)), abs=0.02)
    assert shot.irradiance(table) == pytest.approx(counts / 90.0, abs=0.02)
