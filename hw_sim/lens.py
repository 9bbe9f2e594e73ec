"""A tilted pinhole camera with Brown distortion, directed at a plane target."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from altd.records import FloatArray

WIDTH_PX, HEIGHT_PX = 752, 480
"""Size of the sensor of App. A.3."""

PIXEL_MM = 0.006
"""Pixel pitch of the sensor; 752 × 480 pixels of 6 µm make the 1/3 inch chip."""

MAX_NEWTON_STEPS = 20
NEWTON_TOLERANCE = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class Lens:
    """Projection of a point on the target to the sensor, and the inverse.

    The camera frame's plane coordinates are X right and Y down in its picture, Z away from it. So X = x and Y
    = −y for the camera that looks along the beam, and X = −x, Y = −y where ``mirrored``, for the camera that
    looks against it. ``rotation`` (3 × 3) and ``translation_mm`` (3) take plane coordinates into the camera
    frame; ``distortion`` is Brown's (k1, k2, p1, p2, k3).
    """

    focal_mm: float
    principal_px: tuple[float, float]
    distortion: tuple[float, float, float, float, float]
    rotation: FloatArray
    translation_mm: FloatArray
    mirrored: bool

    def project(self, x_mm: npt.ArrayLike, y_mm: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Pixel coordinates (u, v) of points of the target, any shape."""
        ray_x, ray_y, _ = self._rays(x_mm, y_mm)
        distorted_x, distorted_y = self._distort(ray_x, ray_y)
        focal_px = self.focal_mm / PIXEL_MM
        return self.principal_px[0] + focal_px * distorted_x, self.principal_px[1] + focal_px * distorted_y

    def unproject(self, u_px: npt.ArrayLike, v_px: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Target coordinates (x, y) in mm at the pixel coordinates, any shape."""
        focal_px = self.focal_mm / PIXEL_MM
        distorted_x = (np.asarray(u_px, dtype=np.float64) - self.principal_px[0]) / focal_px
        distorted_y = (np.asarray(v_px, dtype=np.float64) - self.principal_px[1]) / focal_px
        ray_x, ray_y = self._undistort(distorted_x, distorted_y)
        plane = np.column_stack([self.rotation[:, :2], self.translation_mm])
        back = np.linalg.inv(plane)
        scale = back[2, 0] * ray_x + back[2, 1] * ray_y + back[2, 2]
        face_x = (back[0, 0] * ray_x + back[0, 1] * ray_y + back[0, 2]) / scale
        face_y = (back[1, 0] * ray_x + back[1, 1] * ray_y + back[1, 2]) / scale
        return (-face_x if self.mirrored else face_x), -face_y

    def relative_illumination(self, x_mm: npt.ArrayLike, y_mm: npt.ArrayLike) -> FloatArray:
        """Natural fall-off cos⁴ of the angle between the ray and the lens axis, any shape."""
        ray_x, ray_y, _ = self._rays(x_mm, y_mm)
        return np.asarray((1.0 + ray_x**2 + ray_y**2) ** -2.0)

    def incidence_tangent(self, x_mm: npt.ArrayLike, y_mm: npt.ArrayLike, tilt_rad: float) -> FloatArray:
        """Tangent of the angle between the ray and a normal tilted towards the picture's right."""
        ray_x, ray_y, _ = self._rays(x_mm, y_mm)
        along = ray_x * np.sin(tilt_rad) + np.cos(tilt_rad)
        across = ray_x * np.cos(tilt_rad) - np.sin(tilt_rad)
        return np.asarray(np.hypot(across, ray_y) / along)

    def _rays(self, x_mm: npt.ArrayLike, y_mm: npt.ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Slopes of the rays in the camera frame, and their depth in mm."""
        face_x = np.asarray(x_mm, dtype=np.float64) * (-1.0 if self.mirrored else 1.0)
        face_y = -np.asarray(y_mm, dtype=np.float64)
        x, y, z = (
            row[0] * face_x + row[1] * face_y + shift
            for row, shift in zip(self.rotation, self.translation_mm, strict=True)
        )
        return x / z, y / z, z

    def _distort(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Brown's model: radial k1, k2, k3 and decentring p1, p2."""
        k1, k2, p1, p2, k3 = self.distortion
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        return (
            x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        )

    def _undistort(self, distorted_x: FloatArray, distorted_y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Inverse of Brown's model by Newton steps from the distorted ray itself."""
        k1, k2, p1, p2, k3 = self.distortion
        x, y = distorted_x, distorted_y
        for _ in range(MAX_NEWTON_STEPS):
            at_x, at_y = self._distort(x, y)
            residual_x, residual_y = distorted_x - at_x, distorted_y - at_y
            r2 = x * x + y * y
            radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
            slope = 2.0 * (k1 + r2 * (2.0 * k2 + 3.0 * k3 * r2))
            xx = radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x
            xy = slope * x * y + 2.0 * p1 * x + 2.0 * p2 * y
            yy = radial + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x
            determinant = xx * yy - xy * xy
            x = x + (yy * residual_x - xy * residual_y) / determinant
            y = y + (xx * residual_y - xy * residual_x) / determinant
            if max(np.max(np.abs(residual_x)), np.max(np.abs(residual_y))) < NEWTON_TOLERANCE:
                break
        return x, y


def rotation(yaw_rad: float, pitch_rad: float, roll_rad: float) -> FloatArray:
    """Rotation (3 × 3) about Y, then X, then Z of a camera that is turned away from the normal."""
    (cy, cp, cr), (sy, sp, sr) = (f(np.array([yaw_rad, pitch_rad, roll_rad])) for f in (np.cos, np.sin))
    about_y = np.array([[cy, 0.0, sy], [0.0, 1.0, 0.0], [-sy, 0.0, cy]])
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, cp, -sp], [0.0, sp, cp]])
    about_z = np.array([[cr, -sr, 0.0], [sr, cr, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(about_z @ about_x @ about_y)
