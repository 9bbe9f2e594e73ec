"""The sums that a series is fitted by, held against all pixels at a time in one matrix, by its SVD."""

import numpy as np
import pytest
from support.prints import steps

from altd.calibration.printed.find import Series
from altd.calibration.printed.lattice import Lattice
from altd.calibration.printed.sample import Sample

PX_PER_MM = 5.0
BLUR_PX = 0.5
RIDGE = 1e-6


def samples(lattice: Lattice, truth: np.ndarray, noise: float) -> list[Sample]:
    """Spots of 12 mm on a grid of 6 × 5 whose light follows a series; the scale falls over the picture."""
    rng = np.random.default_rng(3)
    disc = np.stack(np.meshgrid(*[np.arange(-6, 6, 1 / PX_PER_MM)] * 2), axis=-1).reshape(-1, 2)
    disc = disc[np.hypot(*disc.T) < 6]
    seen = []
    for x_mm in np.linspace(-70, 70, 6):
        for y_mm in np.linspace(-56, 56, 5):
            mm = np.array([x_mm, y_mm]) + disc * (1 + 1e-3 * x_mm) + rng.uniform(-0.1, 0.1, 2)
            metric = np.diag([(1 + 1e-3 * x_mm) ** 2, 1.0]) / PX_PER_MM**2
            ratio = design(lattice, mm, metric, BLUR_PX) @ truth + noise * rng.normal(size=len(mm))
            seen.append(Sample(mm, ratio, rng.uniform(10, 44, len(mm)), metric))
    return seen


def design(lattice: Lattice, mm: np.ndarray, metric: np.ndarray, blur_px: float) -> np.ndarray:
    """Columns 1, cos, −sin of each harmonic, as weak as a Gaussian blur of the picture makes it."""
    phases = mm @ lattice.vectors.T
    squared = np.minimum(np.einsum("hi,ij,hj->h", lattice.vectors, metric, lattice.vectors), 40.0)
    weaker = np.exp(-0.5 * blur_px**2 * squared)
    return np.column_stack([np.ones(len(mm)), weaker * np.cos(phases), -weaker * np.sin(phases)])


@pytest.mark.parametrize("pitch_mm", [0.6, 1.0, 3.0])
def test_it_is_the_least_squares_solution_of_all_pixels(pitch_mm: float) -> None:
    lattice = Lattice(2 * np.pi * np.linalg.inv(steps(pitch_mm, 60, 1.3)).T)
    size = 1 + 2 * len(lattice.vectors)
    truth = np.random.default_rng(1).normal(0, 0.1, size)
    truth[0] = 1.0
    seen = samples(lattice, truth, noise=0.05)
    series = Series.fit(lattice, iter(seen), (0.3, BLUR_PX, 0.9))
    assert series.blur_px == BLUR_PX

    whole = np.concatenate([design(lattice, s.mm, s.metric, BLUR_PX) for s in seen])
    root = np.sqrt(np.concatenate([s.weight for s in seen]))
    light = np.concatenate([s.ratio for s in seen])
    ridged = np.vstack([whole * root[:, None], np.sqrt(RIDGE) * np.eye(size)])
    expected = np.linalg.lstsq(ridged, np.concatenate([light * root, np.zeros(size)]), rcond=None)[0]

    found = np.concatenate([[series.mean], series.amplitudes.real, series.amplitudes.imag])
    # the part of a wave in the picture: the blur leaves almost nothing of some
    reaching = np.sqrt(np.square(whole).mean(axis=0))
    assert np.abs((found - expected) * reaching).max() < 1e-12


def test_large_spots_go_in_by_parts() -> None:
    """Of 100,000 pixels, as one of 35 mm before a camera of 10 px/mm has."""
    lattice = Lattice(2 * np.pi * np.linalg.inv(steps(1.0, 60, 1.3)).T)
    fundamental = np.abs(lattice.harmonics).sum(axis=1) == 1
    truth = np.concatenate([[1.0], 0.2 * fundamental, 0.1 * fundamental])
    mm = np.random.default_rng(2).uniform(-17, 17, (100_000, 2))
    metric = np.eye(2) / 100.0
    ratio = design(lattice, mm, metric, BLUR_PX) @ truth
    whole = Sample(mm, ratio, np.ones(len(mm)), metric)
    parts = list(whole.parts())
    assert len(parts) > 10
    assert np.array_equal(np.concatenate([part.ratio for part in parts]), ratio)
    series = Series.fit(lattice, [whole], (BLUR_PX,))
    found = np.concatenate([[series.mean], series.amplitudes.real, series.amplitudes.imag])
    assert found == pytest.approx(truth, abs=1e-7)
    shift_mm = np.array([0.003, -0.002])
    aside = Sample(mm - shift_mm, ratio, np.ones(len(mm)), metric)
    assert series.offset_mm(aside) == pytest.approx(shift_mm, abs=2e-5)
