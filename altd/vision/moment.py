"""The first moment of (I − T)₊ in the region of interest (thesis 2.1.2, Eq. 2.7), and its sigma."""

from __future__ import annotations

import math

import cv2
import numpy as np

from altd.vision.image import Centre, Image, Noise
from altd.vision.patch import Patch
from altd.vision.settings import SpotSettings

_NOISE_BLOCK_PX = 4


def moment(patch: Patch, noise: Noise, settings: SpotSettings) -> Centre:
    """Eq. 2.7 with I replaced by (I − T)₊, and its standard deviation by read and shot noise."""
    above_threshold = np.maximum(patch.smooth - np.float32(settings.threshold * patch.peak), np.float32(0))
    above_threshold[patch.mask == 0] = 0
    weight = np.zeros_like(above_threshold)
    is_above = above_threshold > 0  # the power of zero is what takes cv2.pow longest
    weight[is_above] = np.asarray(cv2.pow(above_threshold[is_above], settings.power)).ravel()
    columns = cv2.reduce(weight, 0, cv2.REDUCE_SUM, dtype=cv2.CV_64F).ravel()
    rows = cv2.reduce(weight, 1, cv2.REDUCE_SUM, dtype=cv2.CV_64F).ravel()
    total = float(columns.sum())
    u = float(columns @ np.arange(len(columns))) / total
    v = float(rows @ np.arange(len(rows))) / total
    sigma_px = _sigma_px(patch, above_threshold, weight / np.float32(total), (u, v), noise, settings)
    return Centre(patch.left + u, patch.top + v, sigma_px)


def _sigma_px(
    patch: Patch,
    above_threshold: Image,
    weight: Image,
    centre: tuple[float, float],
    noise: Noise,
    settings: SpotSettings,
) -> float:
    """Propagate read noise r and shot noise I/K through smoothing, threshold and moment.

    du = Σ h dI with h = Gauss ⊛ [(u − ū) p (S − T)₊^(p−1) / Σ w]; var u = Σ h² (r² + I/K). It is summed on
    blocks of 4 px, on which h and I hardly change. Returns the root mean square of both axes.
    """
    # At the contour the root's derivative diverges; within the smoothed noise of it, it is limited.
    floor = noise.read_counts / max(1.0, 2 * math.sqrt(math.pi) * settings.smoothing_px)
    slope = np.where(
        above_threshold > floor,
        weight,
        weight.max() * np.float32((floor / above_threshold.max()) ** settings.power),
    )
    slope *= settings.power
    slope /= np.maximum(above_threshold, np.float32(floor))
    slope[above_threshold == 0] = 0
    height, width = slope.shape
    sensitivity_u = slope * (np.arange(width, dtype=np.float32) - np.float32(centre[0]))
    sensitivity_v = slope * (np.arange(height, dtype=np.float32) - np.float32(centre[1]))[:, None]
    size = max(width // _NOISE_BLOCK_PX, 1), max(height // _NOISE_BLOCK_PX, 1)
    stacked = cv2.merge([sensitivity_u, sensitivity_v, np.maximum(patch.smooth, 0)])
    blocks = cv2.resize(stacked, size, interpolation=cv2.INTER_AREA)
    sensitivities = blocks[:, :, :2]
    if settings.smoothing_px > 0:
        sensitivities = cv2.GaussianBlur(sensitivities, (0, 0), settings.smoothing_px / _NOISE_BLOCK_PX)
    variance = noise.read_counts**2 + blocks[:, :, 2] / np.float32(noise.electrons_per_count)
    pixels_per_block = width * height / (size[0] * size[1])
    per_axis = (np.square(sensitivities) * variance[:, :, None]).sum(axis=(0, 1)) * pixels_per_block
    return math.sqrt(float(per_axis.mean()))
