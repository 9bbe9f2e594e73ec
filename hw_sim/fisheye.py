"""A lens whose picture is bent by the angle of the ray, as the micro lens of f = 3.6 mm (Table 3.2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hw_sim.lens import NEWTON_END, NEWTON_STEPS, FloatArray, Lens

_ON_AXIS = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class FisheyeLens(Lens):
    """Kannala and Brandt's model: r = θ (1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸), θ the angle to the axis.

    ``distortion`` holds (k1, k2, k3, k4, 0); all 0 is the equidistant lens. θ must stay below 90°.
    """

    def _distort(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        slope = np.hypot(x, y)
        bent = self._bent(np.arctan(slope))[0]
        share = np.where(slope > _ON_AXIS, bent / np.maximum(slope, _ON_AXIS), 1.0)
        return x * share, y * share

    def _undistort(self, bent_x: FloatArray, bent_y: FloatArray) -> tuple[FloatArray, FloatArray]:
        bent = np.hypot(bent_x, bent_y)
        angle = bent
        for _ in range(NEWTON_STEPS):
            at, slope = self._bent(angle)
            angle = angle + (bent - at) / slope
            if np.max(np.abs(bent - at)) < NEWTON_END:
                break
        share = np.where(bent > _ON_AXIS, np.tan(angle) / np.maximum(bent, _ON_AXIS), 1.0)
        return bent_x * share, bent_y * share

    def _bent(self, angle_rad: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Distance from the axis for an angle, in focal lengths, and its derivative."""
        t2 = angle_rad * angle_rad
        k1, k2, k3, k4, _ = self.distortion
        bent = angle_rad * (1.0 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))))
        slope = 1.0 + t2 * (3.0 * k1 + t2 * (5.0 * k2 + t2 * (7.0 * k3 + t2 * 9.0 * k4)))
        return bent, slope
