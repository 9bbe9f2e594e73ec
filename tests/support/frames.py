"""Frames whose truth is a formula: Gaussian spots with noise, independent of altd and of hw_sim."""

import math
from dataclasses import dataclass

import numpy as np

from altd.records import Frame

WIDTH, HEIGHT = 752, 480
_REACH = 2.5
"""1/e² diameters from its centre a Gaussian is 2·10⁻²² of its peak: nothing is lost there."""


@dataclass(frozen=True)
class Blob:
    """A Gaussian: centre px, 1/e² diameters px along its axes, turned by ``angle_rad``, peak in counts."""

    u_px: float
    v_px: float
    diameter_px: float = 44.0
    second_diameter_px: float | None = None
    angle_rad: float = 0.0
    peak: float = 150.0


def light(*blobs: Blob, width: int = WIDTH, height: int = HEIGHT) -> np.ndarray:
    """The sum of blobs on a grid of pixel centres, counts as float."""
    image = np.zeros((height, width))
    for b in blobs:
        first, second = b.diameter_px, b.second_diameter_px or b.diameter_px
        reach_px = math.ceil(_REACH * max(first, second))
        left, right = (min(max(round(b.u_px) + side * reach_px, 0), width) for side in (-1, 1))
        top, bottom = (min(max(round(b.v_px) + side * reach_px, 0), height) for side in (-1, 1))
        v, u = np.mgrid[top:bottom, left:right].astype(float)
        along = (u - b.u_px) * np.cos(b.angle_rad) + (v - b.v_px) * np.sin(b.angle_rad)
        across = -(u - b.u_px) * np.sin(b.angle_rad) + (v - b.v_px) * np.cos(b.angle_rad)
        image[top:bottom, left:right] += b.peak * np.exp(-8 * ((along / first) ** 2 + (across / second) ** 2))
    return image


def frame(
    image: np.ndarray,
    rng: np.random.Generator | None = None,
    noise: float = 2.0,
    background: float = 8.0,
    bits: int = 8,
    camera: str = "front",
    sequence: int = 0,
    t_ns: int = 0,
    leds_on: bool = False,
) -> Frame:
    """A frame of light plus background, with Gaussian noise when a generator is given, quantised."""
    counts = image + background
    if rng is not None:
        counts = counts + rng.normal(0, noise, image.shape)
    pixels = np.clip(np.rint(counts), 0, (1 << bits) - 1).astype(np.uint8 if bits == 8 else np.uint16)
    return Frame(camera, sequence, t_ns, pixels, bits, leds_on)
