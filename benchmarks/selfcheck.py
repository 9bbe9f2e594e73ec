"""``python -m benchmarks.selfcheck places``: false alarms of the self-check's tests, without pictures.

LEDs with Gaussian noise, unmoved since the calibration, go through fit and tests.
"""

import math

import numpy as np

from altd.selfcheck.drift import chi2_limit, fit_similarity
from altd.selfcheck.records import DriftLimits
from altd.selfcheck.verdict import SIGNIFICANT
from benchmarks.harness import Parser, end

LED_NOISE_PX = 0.0055
"""Noise of one pair of hw_sim at 1000 lux, per axis."""
MISFIT_SIGMAS = 4.5
MISFIT_MM = 0.25 * 0.03
MM_PER_PX = 0.28


def false_alarms_of_places(checks: int) -> None:
    """Run the fit and its tests alone, for positions with Gaussian noise; the sigma is known to 15 %."""
    rng = np.random.default_rng(3)
    references = np.array([(120, 66), (372, 24), (645, 62), (122, 400), (375, 453), (648, 422)], dtype=float)
    about = references.mean(axis=0)
    radius = float(np.sqrt(np.mean(np.sum((references - about) ** 2, axis=1))))
    sigma = LED_NOISE_PX * math.sqrt(0.5 + 0.5)
    significant = misfits = alarms = 0
    largest = 0.0
    for _ in range(checks):
        then = references + rng.normal(0, LED_NOISE_PX / math.sqrt(2), references.shape)
        now = references + rng.normal(0, LED_NOISE_PX / math.sqrt(2), references.shape)
        claimed = np.full(6, sigma * rng.normal(1.0, 0.15))
        fitted = fit_similarity(then, now, claimed, about, radius)
        vector = fitted.similarity.vector
        distance = math.sqrt(float(vector @ np.linalg.solve(fitted.similarity.covariance, vector)))
        largest = max(largest, distance)
        significant += distance > SIGNIFICANT
        is_misfit = fitted.chi2 > chi2_limit(fitted.degrees_of_freedom, MISFIT_SIGMAS)
        misfits += is_misfit
        moved = np.abs(fitted.similarity.now_px(references) - references).max() * MM_PER_PX
        left = np.hypot(*fitted.residuals_px.T).max() * MM_PER_PX
        alarms += (distance > SIGNIFICANT and moved > DriftLimits().suspect_mm) or (
            is_misfit and left > MISFIT_MM
        )
    print(
        f"nothing moved, {checks} checks by places: {significant} significant (largest {largest:.2f}), "
        f"{misfits} misfits, {alarms} that reach the limits in mm",
        flush=True,
    )


def main() -> int:
    """Run and print."""
    parser = Parser("benchmarks.selfcheck", __doc__)
    parser.add_argument("what", choices=("places",), help="LEDs by their positions")
    parser.count("--checks", 100_000, "of a unit that has not moved")
    false_alarms_of_places(parser.parse_args().checks)
    return 0


if __name__ == "__main__":
    end(main, "benchmarks.selfcheck")
