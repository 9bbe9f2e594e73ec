"""Lenses by OpenCV's projection, which shares no code with altd: those of Table 3.2, on its sensor."""

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

SIZE = (752, 480)
PIXEL_MM = 0.006
NOISE_PX = 0.05

Projection = Callable[[np.ndarray], np.ndarray]
"""Points (n, 2) mm of the target, y up, to (n, 2) px, v down."""


@dataclass(frozen=True)
class LensKind:
    """Focal length, how far from the target it was used, Brown's k1; None for a fisheye."""

    focal_mm: float
    distance_mm: float
    k1: float | None

    def __str__(self) -> str:
        return f"f = {self.focal_mm:g}"


TABLE_3_2 = (
    LensKind(12.0, 450.0, -0.08),
    LensKind(8.0, 330.0, -0.2),
    LensKind(5.7, 250.0, -0.25),
    LensKind(3.6, 180.0, None),
)
"""The distances are those of Fig. 3.13 to 3.15; that of f = 8 is not told and lies between."""


def make_lens(kind: LensKind, rng: np.random.Generator) -> Projection:
    """One lens of its kind: tilted up to 11°, not quite in the middle, with its own distortion."""
    focal_px = kind.focal_mm / PIXEL_MM
    u, v = (SIZE[0] - 1) / 2 + rng.normal(0, 5), (SIZE[1] - 1) / 2 + rng.normal(0, 5)
    matrix = np.array([[focal_px, 0, u], [0, focal_px, v], [0, 0, 1]])
    tilt = np.array(
        [rng.uniform(-0.05, 0.05), rng.choice([-1, 1]) * rng.uniform(0, 0.2), rng.uniform(-0.02, 0.02)]
    )
    shift = np.array([rng.uniform(-3, 3), rng.uniform(-3, 3), kind.distance_mm])
    if kind.k1 is None:
        fisheye = np.array([rng.uniform(-0.03, 0.03), rng.uniform(-0.01, 0.01), 0.0, 0.0])
        return lambda points: cv2.fisheye.projectPoints(
            _plane(points)[:, None], tilt, shift, matrix, fisheye
        )[0][:, 0]
    brown = np.array(
        [
            kind.k1 * rng.uniform(0.8, 1.2),
            rng.uniform(0.03, 0.09),
            *rng.uniform(-6e-4, 6e-4, 2),
            rng.uniform(-0.02, 0),
        ]
    )
    return lambda points: cv2.projectPoints(_plane(points), tilt, shift, matrix, brown)[0][:, 0]


def grid(columns: int = 6, rows: int = 5, pitch_mm: float = 25.0) -> np.ndarray:
    """Nodes (n, 2) mm around the middle, row by row."""
    x = (np.arange(columns) - (columns - 1) / 2) * pitch_mm
    y = (np.arange(rows) - (rows - 1) / 2) * pitch_mm
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


def seen(
    lens: Projection, points_mm: np.ndarray, rng: np.random.Generator, noise_px: float = NOISE_PX
) -> np.ndarray:
    """The places of the points in the picture."""
    return lens(points_mm) + rng.normal(0, noise_px, points_mm.shape)


def _plane(points_mm: np.ndarray) -> np.ndarray:
    return np.column_stack([points_mm[:, 0], -points_mm[:, 1], np.zeros(len(points_mm))])
