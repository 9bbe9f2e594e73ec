"""Movement of the unit relative to the beam: the drive's vibration and the machine's path.

Both are sums of sinusoids, so that the truth at any instant is a formula without memory: any thread can
evaluate it, and the result for a time is always the same.
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hw_sim.beam import BeamPose

RANDOM_LINES = 48
RANDOM_BAND_HZ = (0.5, 80.0)


@dataclass(frozen=True, slots=True)
class Vibration:
    """Vibration of the drive, rms in each of x, y (mm) and of yaw, pitch (mrad).

    ``random_share`` of its power is spread over a band, the rest is in lines at ``lines_hz``.
    """

    rms_mm: float = 0.05
    rms_mrad: float = 0.1
    lines_hz: tuple[float, ...] = (12.3, 24.6, 49.2)
    random_share: float = 0.3


@dataclass(frozen=True, slots=True)
class Drive:
    """Slow path of the machine: maximum offsets in x, y (mm) and yaw, pitch (mrad), and their time scale."""

    x_mm: float = 18.0
    y_mm: float = 12.0
    yaw_mrad: float = 50.0
    pitch_mrad: float = 60.0
    period_s: float = 60.0


SLOW_DRIVE = Drive(x_mm=24.0, y_mm=16.0, yaw_mrad=60.0, pitch_mrad=70.0, period_s=180.0)
"""A slow Lissajous figure, at most 41 × 36 mm from the middle on the rear target; the scan has 70 × 56 mm."""


@dataclass(frozen=True, slots=True, eq=False)
class Oscillation:
    """Σ amplitude · sin(2π frequency t + phase) in x, y (mm), yaw, pitch (mrad): arrays (lines, 4)."""

    amplitude: npt.NDArray[np.float64]
    frequency_hz: npt.NDArray[np.float64]
    phase_rad: npt.NDArray[np.float64]

    def moved(self, pose: BeamPose, t_ns: int) -> BeamPose:
        """Beam in the unit frame with the movement of the unit at ``t_ns``."""
        angle = 2.0 * math.pi * self.frequency_hz * (t_ns * 1e-9) + self.phase_rad
        x_mm, y_mm, yaw_mrad, pitch_mrad = (self.amplitude * np.sin(angle)).sum(axis=0)
        return BeamPose(
            pose.x_mm + float(x_mm),
            pose.y_mm + float(y_mm),
            pose.slope_x + 1e-3 * float(yaw_mrad),
            pose.slope_y + 1e-3 * float(pitch_mrad),
        )


def make_vibration(vibration: Vibration, rng: np.random.Generator) -> Oscillation:
    """Oscillation of a drive: its lines, and a random part of many small lines."""
    lines = len(vibration.lines_hz)
    rms = np.array([vibration.rms_mm, vibration.rms_mm, vibration.rms_mrad, vibration.rms_mrad])
    in_lines = np.full((lines, 4), math.sqrt(2.0 * (1.0 - vibration.random_share) / lines))
    in_band = np.full((RANDOM_LINES, 4), math.sqrt(2.0 * vibration.random_share / RANDOM_LINES))
    return Oscillation(
        np.vstack([in_lines, in_band]) * rms,
        np.vstack(
            [
                np.tile(np.array(vibration.lines_hz)[:, None], (1, 4)),
                rng.uniform(*RANDOM_BAND_HZ, size=(RANDOM_LINES, 4)),
            ]
        ),
        rng.uniform(0.0, 2.0 * math.pi, size=(lines + RANDOM_LINES, 4)),
    )


def make_path(drive: Drive, rng: np.random.Generator) -> Oscillation:
    """Oscillation of a machine on its path: one slow line for each axis, no two in a simple ratio."""
    return Oscillation(
        np.array([[drive.x_mm, drive.y_mm, drive.yaw_mrad, drive.pitch_mrad]]),
        np.array([[1.0, 1.31, 0.77, 1.13]]) / drive.period_s,
        rng.uniform(0.0, 2.0 * math.pi, size=(1, 4)),
    )
