"""A lens whose distortion depends on the angle of the ray, as the micro lens of f = 3.6 mm (Table 3.2)."""

from dataclasses import dataclass

import numpy as np

from altd.records import FloatArray
from hw_sim.lens import MAX_NEWTON_STEPS, NEWTON_TOLERANCE, Lens

_MIN_RADIUS = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class FisheyeLens(Lens):
    """Kannala and Brandt's model: r = θ (1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸), θ the angle to the axis.

    ``distortion`` holds (k1, k2, k3, k4, 0); all 0 is the equidistant lens. θ must be below 90°.
    """

    def _distort(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        slope = np.hypot(x, y)
        distorted = self._distorted_radius(np.arctan(slope))[0]
        share = np.where(slope > _MIN_RADIUS, distorted / np.maximum(slope, _MIN_RADIUS), 1.0)
        return x * share, y * share

    def _undistort(self, distorted_x: FloatArray, distorted_y: FloatArray) -> tuple[FloatArray, FloatArray]:
        distorted = np.hypot(distorted_x, distorted_y)
        angle = distorted
        for _ in range(MAX_NEWTON_STEPS):
            at, slope = self._distorted_radius(angle)
            angle = angle + (distorted - at) / slope
            if np.max(np.abs(distorted - at)) < NEWTON_TOLERANCE:
                break
        share = np.where(distorted > _MIN_RADIUS, np.tan(angle) / np.maximum(distorted, _MIN_RADIUS), 1.0)
        return distorted_x * share, distorted_y * share

    def _distorted_radius(self, angle_rad: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Distance from the axis for an angle, in focal lengths, and its derivative."""
        t2 = angle_rad * angle_rad
        k1, k2, k3, k4, _ = self.distortion
        distorted = angle_rad * (1.0 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))))
        slope = 1.0 + t2 * (3.0 * k1 + t2 * (5.0 * k2 + t2 * (7.0 * k3 + t2 * 9.0 * k4)))
        return distorted, slope
