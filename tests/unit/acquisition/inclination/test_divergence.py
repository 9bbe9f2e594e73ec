"""The slow change of the beam's inclination against gravity."""

import math
import random
from collections.abc import Callable

import pytest

from altd.acquisition.inclination.monitor import PitchDivergence

S = 1_000_000_000


def after(seconds: int, inclination_deg: Callable[[int], float], noise_deg: float = 0.0) -> float | None:
    source, found = random.Random(3), PitchDivergence()
    for t_s in range(seconds):
        found.add(t_s * S, inclination_deg(t_s) + source.gauss(0.0, noise_deg))
    return found.divergence_deg((seconds - 1) * S)


@pytest.mark.parametrize(
    ("seconds", "inclination_deg", "noise_deg", "expected"),
    [
        (600, lambda _: 1.0, 0.0, None),
        (602, lambda _: 1.0, 0.0, pytest.approx(0.0)),
        (6 * 3600, lambda _: -4.2, 0.3, pytest.approx(0.0, abs=0.05)),
        # 0.1° an hour: an exponential mean of ten minutes lags by ten minutes, the reference is of minute 5
        (6 * 3600, lambda t_s: t_s / 36_000, 0.0, pytest.approx((6 * 3600 - 600 - 300) / 36_000, abs=0.005)),
        (4200, lambda t_s: 0.0 if t_s < 3600 else 1.0, 0.0, pytest.approx(1.0 - math.exp(-1.0), abs=0.01)),
        (3 * 3600, lambda t_s: 2.0 * math.sin(t_s / 3), 0.0, pytest.approx(0.0, abs=0.05)),
    ],
    ids=["ten minutes", "longer", "at rest", "drifts", "was knocked", "shakes"],
)
def test_what_is_found_after_a_time(
    seconds: int, inclination_deg: Callable[[int], float], noise_deg: float, expected: object
) -> None:
    assert after(seconds, inclination_deg, noise_deg) == expected


def test_after_a_long_absence_of_the_beam_the_reference_is_a_new_one() -> None:
    found = PitchDivergence()
    for t_s in range(1000):
        found.add(t_s * S, 0.0)
    for t_s in range(2000, 3000):
        found.add(t_s * S, 5.0)
    assert found.divergence_deg(2999 * S) == pytest.approx(0.0)


def test_while_the_beam_is_away_for_long_nothing_is_known() -> None:
    found = PitchDivergence()
    for t_s in range(1000):
        found.add(t_s * S, 0.0)
    assert found.divergence_deg(1500 * S) == pytest.approx(0.0)
    assert found.divergence_deg(1601 * S) is None
