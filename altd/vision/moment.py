"""The first-order moment of (I − T)₊ in the region of interest (thesis 2.1.2, Eq. 2.7), and its noise."""

from __future__ import annotations

import math

import cv2
import numpy as np

from altd.vision.background import Image
from altd.vision.centre import Centre, Noise
from altd.vision.patch import Patch
from altd.vision.settings import SpotSettings

_NOISE_BLOCK_PX = 4


def moment(patch: Patch, noise: Noise, settings: SpotSettings) -> Centre:
    """Eq. 2.7 with I replaced by (I − T)₊, and what the noise does to it."""
    over = np.maximum(patch.smooth - np.float32(settings.threshold * patch.peak), np.float32(0))
    over[patch.mask == 0] = 0
    weight = np.zeros_like(over)
    inside = over > 0  # the power of zero is what takes cv2.pow longest
    weight[inside] = np.asarray(cv2.pow(over[inside], settings.power)).ravel()
    columns = cv2.reduce(weight, 0, cv2.REDUCE_SUM, dtype=cv2.CV_64F).ravel()
    rows = cv2.reduce(weight, 1, cv2.REDUCE_SUM, dtype=cv2.CV_64F).ravel()
    total = float(columns.sum())
    u = float(columns @ np.arange(len(columns))) / total
    v = float(rows @ np.arange(len(rows))) / total
    sigma_px = _sigma_px(patch, over, weight / np.float32(total), (u, v), noise, settings)
    return Centre(patch.left + u, patch.top + v, sigma_px)


def _sigma_px(
    patch: Patch,
    over: Image,
    weight: Image,
    centre: tuple[float, float],
    noise: Noise,
    settings: SpotSettings,
) -> float:
    """Propagate read noise r and shot noise I/K through smoothing, threshold and moment.

    du = Σ h dI with h = Gauss ⊛ [(u − ū) p (S − T)₊^(p−1) / Σ w]; var u = Σ h² (r² + I/K). It is summed on
    blocks of 4 px, on which h and I hardly change. Returns the root mean square of both axes.
    """
    # At the contour the root's derivative diverges: nearer to it than the smoothed noise it means nothing.
    floor = noise.read_counts / max(1.0, 2 * math.sqrt(math.pi) * settings.smoothing_px)
    slope = np.where(over > floor, weight, weight.max() * np.float32((floor / over.max()) ** settings.power))
    slope *= settings.power
    slope /= np.maximum(over, np.float32(floor))
    slope[over == 0] = 0
    height, width = slope.shape
    lever_u = slope * (np.arange(width, dtype=np.float32) - np.float32(centre[0]))
    lever_v = slope * (np.arange(height, dtype=np.float32) - np.float32(centre[1]))[:, None]
    size = max(width // _NOISE_BLOCK_PX, 1), max(height // _NOISE_BLOCK_PX, 1)
    stacked = cv2.merge([lever_u, lever_v, np.maximum(patch.smooth, 0)])
    blocks = cv2.resize(stacked, size, interpolation=cv2.INTER_AREA)
    levers = blocks[:, :, :2]
    if settings.smoothing_px > 0:
        levers = cv2.GaussianBlur(levers, (0, 0), settings.smoothing_px / _NOISE_BLOCK_PX)
    variance = noise.read_counts**2 + blocks[:, :, 2] / np.float32(noise.electrons_per_count)
    pixels_per_block = width * height / (size[0] * size[1])
    per_axis = (np.square(levers) * variance[:, :, None]).sum(axis=(0, 1)) * pixels_per_block
    return math.sqrt(float(per_axis.mean()))
