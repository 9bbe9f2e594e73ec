"""Differences between units: lenses, tilts and print, drawn from the unit's seed."""

import math
from dataclasses import replace

import numpy as np

from hw_sim.lens import HEIGHT_PX, PIXEL_MM, WIDTH_PX, Lens, rotation
from hw_sim.targets import DotPattern, DotPrint, PrintFlaws

FIELD_HALF_MM = (77.5, 62.5)
"""Half the field of view: a spot of 15 mm anywhere on the 140 × 110 mm (App. A.1) covers 155 × 125 mm of the
plate's 160 × 130 mm (App. A.3). The thesis' lens of 5.7 mm has this field from 250 mm (Sec. 3.3.2): 126 mm
across the 480 rows of 6 µm."""

MARGIN_PX = 3.0

FLAWED_DOTS = 256
"""Rows and columns after which the flaws of a print repeat; a window has fewer dots than that."""

FRONT_FOCAL_MM = (7.7, 8.2)
REAR_FOCAL_MM = (5.6, 6.0)
"""Focal lengths of the micro lenses of App. A.3, f = 8 and 5.7 mm, with their tolerances."""


def make_dots(
    pattern: DotPattern, rng: np.random.Generator, jitter_mm: float = 0.0, bleed_mm: float = 0.0
) -> DotPrint:
    """Draw a print at a random position on the window, turned by up to 2°, with its flaws if it has any."""
    phase_x, phase_y = rng.uniform(0.0, pattern.pitch_mm, size=2)
    turn_rad = math.radians(rng.uniform(-2.0, 2.0))
    flaws = None
    if jitter_mm or bleed_mm:
        size = (2, FLAWED_DOTS, FLAWED_DOTS, 3)
        flaws = PrintFlaws(jitter_mm, bleed_mm, rng.standard_normal(size, dtype=np.float32))
    return DotPrint((float(phase_x), float(phase_y)), turn_rad, pattern, flaws)


def make_lens(
    focal_range_mm: tuple[float, float],
    mirrored: bool,
    rng: np.random.Generator,
    field_half_mm: tuple[float, float] = FIELD_HALF_MM,
) -> Lens:
    """Draw a barrel lens beside the beam, as close to its target as the field of view allows."""
    side = rng.choice([-1.0, 1.0])
    turned = rotation(
        math.radians(side * rng.uniform(8.0, 13.0)),
        math.radians(rng.uniform(-3.0, 3.0)),
        math.radians(rng.uniform(-1.0, 1.0)),
    )
    aim_x, aim_y = rng.uniform(-0.5, 0.5, size=2)
    k1, k2, k3 = rng.uniform((-0.28, 0.03, -0.02), (-0.18, 0.09, 0.0))
    p1, p2 = rng.uniform(-6e-4, 6e-4, size=2)
    lens = Lens(
        focal_mm=float(rng.uniform(*focal_range_mm)),
        principal_px=(
            (WIDTH_PX - 1) / 2.0 + float(rng.uniform(-3.0, 3.0)),
            (HEIGHT_PX - 1) / 2.0 + float(rng.uniform(-3.0, 3.0)),
        ),
        distortion=(float(k1), float(k2), float(p1), float(p2), float(k3)),
        rotation=turned,
        translation_mm=np.array([aim_x, aim_y, 0.0]),
        mirrored=mirrored,
    )
    return at_framing_distance(lens, field_half_mm, (30.0, 60.0))


def at_framing_distance(lens: Lens, half_mm: tuple[float, float], focal_lengths: tuple[float, float]) -> Lens:
    """The lens at the smallest distance at which its image holds the whole rectangle, in focal lengths."""
    lower_mm, upper_mm = (lengths * lens.focal_mm for lengths in focal_lengths)
    while upper_mm - lower_mm > PIXEL_MM:
        middle = 0.5 * (lower_mm + upper_mm)
        if _holds(_at_distance(lens, middle), half_mm):
            upper_mm = middle
        else:
            lower_mm = middle
    return _at_distance(lens, upper_mm)


def _at_distance(lens: Lens, distance_mm: float) -> Lens:
    return replace(lens, translation_mm=np.array([*lens.translation_mm[:2], distance_mm]))


def _holds(lens: Lens, half_mm: tuple[float, float]) -> bool:
    along = np.linspace(-1.0, 1.0, 17)
    border = np.concatenate(
        [np.stack([along, np.full_like(along, end)]) for end in (-1.0, 1.0)]
        + [np.stack([np.full_like(along, end), along]) for end in (-1.0, 1.0)],
        axis=1,
    )
    u, v = lens.project(border[0] * half_mm[0], border[1] * half_mm[1])
    within_u = (u >= MARGIN_PX) & (u <= WIDTH_PX - 1 - MARGIN_PX)
    within_v = (v >= MARGIN_PX) & (v <= HEIGHT_PX - 1 - MARGIN_PX)
    return bool(np.all(within_u & within_v))
