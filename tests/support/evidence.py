"""Calibrations whose accuracy is known by formulas: straight maps with the errors that a test gives them."""

from dataclasses import replace
from datetime import UTC, datetime

import numpy as np

from altd.calibration.result import Candidate, TargetEvidence
from altd.mapping.grid import convex_hull_mm
from altd.mapping.tensor_map import TensorMap, fit_tensor_map
from altd.measuring.calibration import Calibration, TargetCalibration
from altd.measuring.cross_check import CrossCheck
from altd.records import FloatArray
from altd.vision.settings import SpotSettings
from support.recordings import PX_PER_MM

COLUMNS, ROWS, STEP_MM = 6, 5, 25.0
DISTANCE_MM = 280.0


def nodes_mm() -> FloatArray:
    x = STEP_MM * (np.arange(COLUMNS) - (COLUMNS - 1) / 2)
    y = STEP_MM * (np.arange(ROWS) - (ROWS - 1) / 2)
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


def straight_px(name: str, points_mm: FloatArray) -> FloatArray:
    """4 px/mm, v down; the front camera sees a mirrored picture."""
    mirror = -1 if name == "front" else 1
    return np.column_stack([375 + mirror * PX_PER_MM * points_mm[:, 0], 240 - PX_PER_MM * points_mm[:, 1]])


def straight_map(name: str, pattern_px: float = 0.03, shift_px: float = 0.01) -> TensorMap:
    """A map that is off by the same unknown shift everywhere, of ``shift_px`` along u and v."""
    places = nodes_mm()
    rng = np.random.default_rng(0)
    noisy_px = straight_px(name, places) + rng.normal(0, 1e-6, places.shape)
    fitted = fit_tensor_map(places, noisy_px, convex_hull_mm(places), (1, 1)).map
    spread = np.zeros((2, 4, 2))
    spread[0, 0, 0] = spread[1, 0, 1] = shift_px * np.sqrt(COLUMNS * ROWS)  # g₀ is 1/√m along each axis
    return replace(fitted, covariance_factor_px=spread, noise_px=pattern_px)


def target(name: str, scatter_px: float = 0.02, **of_map: float) -> TargetCalibration:
    return TargetCalibration(
        name=name,
        z_mm=0.0 if name == "front" else DISTANCE_MM,
        width=752,
        height=480,
        localiser=SpotSettings(),
        flat=None,
        map=straight_map(name, **of_map),
        leave_one_out_px=0.0321,
        residual_mean_mm=0.00987,
        residual_std_mm=0.00543,
        residual_max_mm=0.0234,
        repeatability_px=np.array([scatter_px, scatter_px]),
        cross_check=CrossCheck(
            straight_map(name), leave_one_out_px=0.0432, limit_px=0.16, max_difference_px=0.0543
        ),
        leds_px=np.array([[90.25, 60.5], [660.75, 40.0], [84.0, 445.0], [677.0, 441.0]]),
    )


def calibration(*targets: TargetCalibration) -> Calibration:
    return Calibration(
        unit_serial="TEST-1",
        created=datetime(2026, 11, 20, 8, 15, 30, tzinfo=UTC),
        recording_note="made up <by> a test & 5 $",
        recording_sha256="0123456789abcdef" * 4,
        targets=targets or (target("front"), target("rear")),
    )


def evidence(name: str, seed: int = 1) -> TargetEvidence:
    rng = np.random.default_rng(seed)
    places = nodes_mm()
    off_px = rng.normal(0, 0.03, places.shape)
    return TargetEvidence(
        name=name,
        nodes_mm=places,
        nodes_px=straight_px(name, places) + off_px,
        residuals_px=off_px,
        leave_one_out_residuals_px=1.2 * off_px,
        relative_sigma=np.ones(len(places)),
        scatter_px=np.abs(rng.normal(0, 0.02, places.shape)),
        exposures=(2,) * len(places),
        excluded=(),
        leds_dropped=(),
        candidates=(
            Candidate("tensor", (1, 1), 8, 1.9236, 2.0119, 0.0101),
            Candidate("tensor", (2, 2), 18, 0.3469, 0.4070, 0.0132),
            Candidate("tensor", (3, 3), 32, 0.0587, 0.0696, 0.0249),
            Candidate("lens", None, 13, 0.0400, 0.0378, 0.0144),
        ),
    )
