"""Lens of a camera that has moved relative to its target."""

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np

from hw_sim.image import Image
from hw_sim.lens import HEIGHT_PX, WIDTH_PX, Lens, rotation


@dataclass(frozen=True, slots=True)
class Displacement:
    """Movement of a camera's picture about its principal point: shift, turn from u to v, scale.

    The sensor shifts in its plane, the camera rolls about its axis, the lens gets longer (as if the camera
    moved closer, but without the change of perspective).
    """

    shift_px: tuple[float, float] = (0.0, 0.0)
    turn_deg: float = 0.0
    scale_ppm: float = 0.0

    def of(self, lens: Lens) -> Lens:
        """Lens of a camera with this displacement."""
        roll = rotation(0.0, 0.0, math.radians(self.turn_deg))
        return replace(
            lens,
            focal_mm=lens.focal_mm * (1.0 + 1e-6 * self.scale_ppm),
            principal_px=(
                lens.principal_px[0] + self.shift_px[0],
                lens.principal_px[1] + self.shift_px[1],
            ),
            rotation=roll @ lens.rotation,
            translation_mm=roll @ lens.translation_mm,
        )


def carried(texture: Image, before: Lens, after: Lens) -> Image:
    """Surface texture, (rows, columns), in the displaced camera's picture: it moves with the target."""
    columns, rows = np.meshgrid(np.arange(WIDTH_PX, dtype=np.float64), np.arange(HEIGHT_PX, dtype=np.float64))
    u, v = before.project(*after.unproject(columns, rows))
    return cv2.remap(
        texture,
        u.astype(np.float32),
        v.astype(np.float32),
        cv2.INTER_LANCZOS4,
        borderMode=cv2.BORDER_REFLECT,
    ).astype(np.float32)
