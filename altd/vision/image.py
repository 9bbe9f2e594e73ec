"""Images on their way from grey values to a spot: single precision, and the Gaussian that smooths them."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

Image = npt.NDArray[np.float32]
"""Counts, irradiance or weights, (rows, columns)."""

Mask = npt.NDArray[np.uint8]
"""0 and 1, (rows, columns)."""


def gaussian_blur(image: Image, sigma_px: float) -> Image:
    """The image smoothed by a Gaussian; itself where ``sigma_px`` is 0."""
    if sigma_px <= 0:
        return image
    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma_px), dtype=np.float32)
