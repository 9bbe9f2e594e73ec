"""Basic types of localisation: images in single precision, the noise of their pixels, and the centre."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

Image = npt.NDArray[np.float32]
"""Counts, irradiance or weights, (rows, columns)."""

Mask = npt.NDArray[np.uint8]
"""0 and 1, (rows, columns)."""


def gaussian_blur(image: Image, sigma_px: float) -> Image:
    """Return the image smoothed by a Gaussian; itself if ``sigma_px`` is 0."""
    if sigma_px <= 0:
        return image
    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma_px), dtype=np.float32)


@dataclass(frozen=True, slots=True)
class Noise:
    """Noise of a pixel: ``read_counts`` of the dark camera, shot noise at ``electrons_per_count``."""

    read_counts: float
    electrons_per_count: float


@dataclass(frozen=True, slots=True)
class Centre:
    """Centre of a spot and its sigma by read and shot noise, root mean square of both axes, px."""

    u_px: float
    v_px: float
    sigma_px: float
