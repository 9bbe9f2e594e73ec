"""The LEDs of a matte plate in a frame: discs with sub-pixel centres, and points of their rims."""

from __future__ import annotations

import cv2
import numpy as np

from altd.records import FloatArray, PixelArray
from altd.vision.image import Image
from altd.vision.led_discs import Disc, find_discs
from altd.vision.search import coarse_image, fit_background

MAX_LIGHTS = 100
"""Maximum number of lights: more are not a picture of a plate, and matching them would take seconds."""

_RAYS = 32
_STEPS_PER_PX = 4
_REACH = 1.8
"""Maximum distance from the centre at which the rim is searched, in radii."""


def led_image(pixels: PixelArray | Image) -> Image:
    """Subtract the smooth background from a frame or a mean of frames, counts."""
    background = fit_background(coarse_image(pixels))
    return np.asarray(pixels.astype(np.float32) - background.levels((0.0, 0.0), pixels.shape))


def find_leds(image: Image) -> tuple[Disc, ...]:
    """Find the discs in an image of ``led_image`` that the border does not cut; they are not identified yet.

    Returns at most the ``MAX_LIGHTS`` brightest.
    """
    whole = (disc for disc in find_discs(image).found if not disc.is_cut)
    return tuple(sorted(whole, key=lambda disc: -disc.level)[:MAX_LIGHTS])


def rim_points_px(image: Image, disc: Disc) -> FloatArray:
    """Points (n, 2) of a disc's rim: half its level on rays from its centre, linearly interpolated."""
    radius_px = np.sqrt(disc.area_px / np.pi)
    along = np.arange(0.0, _REACH * radius_px + 2.0, 1.0 / _STEPS_PER_PX)
    angle = 2.0 * np.pi * np.arange(_RAYS) / _RAYS
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    at = (disc.u_px, disc.v_px) + along[None, :, None] * direction[:, None, :]
    places = at.astype(np.float32)
    values = cv2.remap(
        image, places[..., 0], places[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    is_below = values < disc.level / 2.0
    is_below[:, 0] = False
    after = is_below.argmax(axis=1)
    rays = np.nonzero(after > 0)[0]
    after = after[rays]
    inner, outer = values[rays, after - 1], values[rays, after]
    share = (inner - disc.level / 2.0) / np.maximum(inner - outer, 1e-6)
    distance = along[after - 1] + share / _STEPS_PER_PX
    return np.asarray((disc.u_px, disc.v_px) + distance[:, None] * direction[rays])
