"""Frames of LEDs and a spot whose places are numbers in a test, drawn without altd and without hw_sim."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import cv2
import numpy as np

from altd.measuring.calibration import Calibration
from altd.records import Frame
from altd.selfcheck.records import LedView
from support import evidence
from support.frames import HEIGHT, WIDTH, Blob, light

LEDS = np.array([(120.3, 66.1), (372.4, 24.7), (645.2, 62.9), (121.8, 400.4), (375.1, 452.6), (648.9, 421.5)])
"""Six as a unit has them, nearly symmetric about the middle of the picture."""
RADIUS_PX = 9.0
LEVEL = 180.0
SPOT = Blob(340, 230)


@dataclass(frozen=True)
class Motion:
    """A similarity about the LEDs' centroid: position now from position then."""

    u_px: float = 0.0
    v_px: float = 0.0
    turn_deg: float = 0.0
    scale_ppm: float = 0.0

    def of(self, points: np.ndarray) -> np.ndarray:
        about = LEDS.mean(axis=0)
        turn = math.radians(self.turn_deg)
        turned = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
        scaled = (1 + 1e-6 * self.scale_ppm) * (points - about) @ turned.T
        return np.add(about, (self.u_px, self.v_px)) + scaled


def discs(places: np.ndarray, levels: Sequence[float], radius_px: float = RADIUS_PX) -> np.ndarray:
    """Evenly bright discs, each pixel by its covered share (8 × 8 samples), behind a lens's blur; counts."""
    image = np.zeros((HEIGHT, WIDTH), np.float32)
    for (u, v), level in zip(places, levels, strict=True):
        left, right = max(int(u) - 14, 0), min(int(u) + 15, WIDTH)
        top, bottom = max(int(v) - 14, 0), min(int(v) + 15, HEIGHT)
        if left >= right or top >= bottom:
            continue
        down = (np.arange(8 * (bottom - top)) + 0.5) / 8 - 0.5 + top
        across = (np.arange(8 * (right - left)) + 0.5) / 8 - 0.5 + left
        inside = np.hypot(across[None, :] - u, down[:, None] - v) <= radius_px
        covered = inside.reshape(bottom - top, 8, right - left, 8).mean(axis=(1, 3))
        image[top:bottom, left:right] += np.float32(level) * covered.astype(np.float32)
    return cv2.GaussianBlur(image, (0, 0), 0.8)


@dataclass(frozen=True)
class Scene:
    """One target in a check: how it moved, how bright each LED is, and what else shines."""

    motion: Motion = Motion()
    levels: tuple[float, ...] = (LEVEL,) * 6
    reflections: tuple[tuple[float, float], ...] = ()
    reflection_level: float = LEVEL
    spot: Blob | None = SPOT
    always_lit: tuple[float, ...] = (0.0,) * 6
    noise: float = 1.5

    def view(self, rng: np.random.Generator, pairs: int = 2) -> LedView:
        lit, steady = _counts(self)
        frames = [
            (self._frame(lit, 2 * number, True, rng), self._frame(steady, 2 * number + 1, False, rng))
            for number in range(pairs)
        ]
        return LedView(tuple(on for on, _ in frames), tuple(off for _, off in frames))

    def _frame(self, counts: np.ndarray, sequence: int, leds_on: bool, rng: np.random.Generator) -> Frame:
        noise = rng.standard_normal(counts.shape, dtype=np.float32)
        noisy = counts + np.float32(self.noise) * noise
        pixels = np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
        return Frame("camera", sequence, sequence * 50_000_000, pixels, 8, leds_on)


@cache
def _counts(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """With the LEDs on and with them off, without noise."""
    places = scene.motion.of(LEDS)
    steady = _spot(scene.spot) + 8 + discs(places, scene.always_lit)
    lit = steady + discs(places, scene.levels)
    if scene.reflections:
        lit = lit + discs(np.array(scene.reflections), (scene.reflection_level,) * len(scene.reflections))
    return lit.astype(np.float32), steady.astype(np.float32)


@cache
def _spot(spot: Blob | None) -> np.ndarray:
    return light(spot) if spot else light()


def unit() -> Calibration:
    """Front and rear 280 mm apart by straight maps, 4 px/mm, with these LEDs."""
    targets = (replace(evidence.target(name), leds_px=LEDS.copy()) for name in ("front", "rear"))
    return evidence.calibration(*targets)
