"""Ways that disturb surfaces in the light: dirt, water, scratches, hands and cables, lost print."""

import math

import cv2
import numpy as np

from benchmarks.campaign.detectability import by_a_step_of_the_print, merged_on_a_plate, on_a_plate
from benchmarks.campaign.scene import Scene, blurred
from benchmarks.campaign.way import CAMERAS, Draw, Registry, Spoil, drawn, log, of, uniform

WAYS = Registry("surfaces")


@WAYS.on_light("from {at:.2f} radii on")
@drawn(uniform(-0.5, 0.9), Draw.angle, uniform(0.0, 0.3))
def half_black(scene: Scene, at: float, angle: float, left: float) -> Scene:
    """A hand, sheet or tape with a sharp edge covers about half the spot."""
    return scene.all_times(left + (1 - left) * scene.edge(angle, at, 0.1))


@WAYS.on_light("from {at:.2f} radii on, edge of {soft_mm:.1f} mm")
@drawn(uniform(-0.5, 0.9), Draw.angle, uniform(0.5, 6.0))
def half_black_soft(scene: Scene, at: float, angle: float, soft_mm: float) -> Scene:
    """A shadow with a soft edge."""
    return scene.all_times(scene.edge(angle, at, soft_mm))


@WAYS.on_light("corner at {at_1:.2f}, {at_2:.2f} radii")
@drawn(Draw.angle, uniform(-0.4, 0.6), uniform(-0.4, 0.6), log(0.1, 3.0))
def quarter_black(scene: Scene, angle: float, at_1: float, at_2: float, soft_mm: float) -> Scene:
    """A corner covers a quarter of the spot."""
    one, other = scene.edge(angle, at_1, soft_mm), scene.edge(angle + math.pi / 2, at_2, soft_mm)
    return scene.all_times(np.maximum(one, other))


@WAYS.on_light("{width_mm:.1f} mm wide, {at:.2f} radii aside")
@drawn(uniform(-1.0, 1.0), Draw.angle, log(0.3, 6.0), uniform(0.0, 0.5))
def cable(scene: Scene, at: float, angle: float, width_mm: float, left: float) -> Scene:
    """A dark line across the spot."""
    return scene.all_times(1.0 - (1 - left) * scene.stripe(angle, at, width_mm, 1.0))


@WAYS.on_light("{loss:.0%} darker, edge of {soft_mm:.1f} mm")
@drawn(uniform(0.03, 0.3), uniform(-0.6, 0.6), Draw.angle, log(0.2, 6.0))
def grease(scene: Scene, loss: float, at: float, angle: float, soft_mm: float) -> Scene:
    """A smear absorbs part of the light of about half the spot."""
    return scene.all_times(1.0 - loss * (1.0 - scene.edge(angle, at, soft_mm)))


@WAYS.add(
    invisible="a Gaussian times a ramp is, to first order, a shifted Gaussian: 2 to 30 % over a diameter, "
    "up to 0.3 mm on the target"
)
def smear_gradient(draw: Draw) -> Spoil:
    """A film that becomes steadily thicker across the spot, without an edge."""
    slope, angle = draw.uniform(0.02, 0.3), draw.angle()

    def light(scene: Scene, since: int) -> Scene:
        ramp = slope * scene.along(angle) / np.float32(2 * scene.spot.radius_px)
        return scene.all_times(np.clip(0.7 + ramp, 0.05, 1.0))

    return Spoil(f"{slope:.0%} over a diameter", light=light, cameras=draw.targets())


@WAYS.on_light("{width_mm:.1f} mm, {at:.2f} radii aside")
@drawn(uniform(0.0, 1.1), Draw.angle, log(0.4, 6.0), uniform(0.0, 0.6))
def particle(scene: Scene, at: float, angle: float, width_mm: float, left: float) -> Scene:
    """A dark grain of dirt on the spot."""
    return scene.all_times(1.0 - (1 - left) * scene.disc(angle, at, width_mm, 1.0))


@WAYS.on_light("{shape} of {width_mm:.1f} mm")
@drawn(uniform(0.0, 1.1), Draw.angle, log(1.0, 6.0), uniform(0.2, 0.9), of("ring", "focus"))
def water_drop(scene: Scene, at: float, angle: float, width_mm: float, dark: float, shape: str) -> Scene:
    """A drop: dark inside, with a bright ring or focus."""
    inner = scene.disc(angle, at, width_mm, 1.5)
    if shape == "ring":
        bright = scene.disc(angle, at, 1.25 * width_mm, 1.5) - inner
        return scene.all_times(1.0 - dark * inner + dark * bright / np.float32(1.25**2 - 1.0))
    focus = scene.disc(angle, at, 0.35 * width_mm, 1.0)
    return scene.all_times(1.0 - dark * inner + dark * focus / np.float32(0.35**2))


@WAYS.on_light("{depth:.0%}, drops of {grain_mm:.1f} mm")
@drawn(uniform(0.1, 0.8), log(0.3, 4.0), Draw.seed)
def condensation(scene: Scene, depth: float, grain_mm: float, seed: int) -> Scene:
    """Many fine drops of varying transmission."""
    rng = np.random.default_rng([seed, CAMERAS.index(scene.camera)])
    rows, columns = scene.beam.shape
    grain_px = grain_mm * scene.px_per_mm
    shrunk = max(1, int(grain_px / 2))
    field = rng.standard_normal((rows // shrunk + 2, columns // shrunk + 2), dtype=np.float32)
    field = blurred(field, grain_px / shrunk / 2)
    field = np.asarray(cv2.resize(field, (columns, rows), interpolation=cv2.INTER_LINEAR), np.float32)
    field = np.clip(0.5 + field / np.float32(4 * max(float(field.std()), 1e-6)), 0.0, 1.0)
    return scene.all_times(1.0 - depth * field)


@WAYS.on_light("{share:.0%} in a halo {scale:.1f} times as wide, {side:.1f} radii aside", Draw.both)
@drawn(uniform(0.05, 0.7), uniform(2.0, 8.0), uniform(0.0, 1.5), Draw.angle)
def fog(scene: Scene, share: float, scale: float, side: float, angle: float) -> Scene:
    """Fog or dust in the air: a broad halo, even or one-sided."""
    far_px = side * scene.spot.radius_px
    halo = scene.spot.moved(far_px * math.cos(angle), far_px * math.sin(angle)).scaled(scale, share)
    return scene.beam_times(1.0 - share).beam_plus(halo)


def _dark_or_bright(draw: Draw) -> float:
    return draw.uniform(0.0, 0.5) if draw.sign() < 0 else draw.uniform(1.5, 6.0)


@WAYS.on_light("{width_mm:.1f} mm wide, {gain:.1f} times the light")
@drawn(uniform(-1.0, 1.0), Draw.angle, log(0.1, 0.8), _dark_or_bright)
def scratch(scene: Scene, at: float, angle: float, width_mm: float, gain: float) -> Scene:
    """A fine line across the spot, dark or bright."""
    return scene.all_times(1.0 + (gain - 1.0) * scene.stripe(angle, at, width_mm, 1.0))


@WAYS.on_light("{width_mm:.1f} mm, {left:.0%} left", Draw.one)
@drawn(uniform(0.2, 1.2), Draw.angle, log(1.0, 10.0), uniform(0.05, 0.5))
def print_lost(scene: Scene, at: float, angle: float, width_mm: float, left: float) -> Scene:
    """Ink missing in a patch of the window, or paint of the plate."""
    return scene.all_times(1.0 - (1.0 - left) * scene.disc(angle, at, width_mm, 2.0))


@WAYS.on_light("{width_mm:.1f} mm, {gain:.2f} times", lambda draw: frozenset(("rear",)))
@drawn(uniform(0.3, 1.2), Draw.angle, log(2.0, 15.0), uniform(1.05, 1.6), log(0.2, 5.0))
def bleached_patch(
    scene: Scene, at: float, angle: float, width_mm: float, gain: float, soft_mm: float
) -> Scene:
    """A brighter patch on the plate."""
    return scene.all_times(1.0 + (gain - 1.0) * scene.disc(angle, at, width_mm, soft_mm * scene.px_per_mm))


@WAYS.add()
def wet_window(draw: Draw) -> Spoil:
    """The whole picture doubled, as through water or a second pane."""
    share, far_px, angle = draw.log(0.03, 0.5), draw.log(1.0, 40.0), draw.angle()

    def light(scene: Scene, since: int) -> Scene:
        matrix = np.array([[1.0, 0.0, far_px * math.cos(angle)], [0.0, 1.0, far_px * math.sin(angle)]])
        rows, columns = scene.beam.shape
        ghost = cv2.warpAffine(scene.electrons, matrix, (columns, rows), borderMode=cv2.BORDER_REPLICATE)
        return scene.all_times(1.0 - share).veiled(np.float32(share) * np.asarray(ghost, np.float32))

    cameras = draw.targets()
    return Spoil(
        f"{share:.0%} {far_px:.0f} px aside",
        light=light,
        cameras=cameras,
        undetectable=merged_on_a_plate(cameras, far_px),
    )


@WAYS.on_light("{blur_px:.1f} px")
@drawn(uniform(2.0, 8.0))
def defocused(scene: Scene, blur_px: float) -> Scene:
    """Blurred by 2 to 8 px."""
    return scene.seen_as(blurred(scene.electrons, blur_px))


def _bent(draw: Draw, camera: str) -> Spoil:
    """The picture around the spot is distorted: by heat, by a drop on the lens, by a pane."""
    shift_px, angle, size_px = draw.log(0.5, 6.0), draw.angle(), draw.uniform(40.0, 200.0)

    def light(scene: Scene, since: int) -> Scene:
        u, v = scene.from_spot()
        hump = np.exp(-(u * u + v * v) / np.float32(2 * size_px**2)) * np.float32(shift_px)
        rows, columns = scene.beam.shape
        grid_u = np.arange(columns, dtype=np.float32)[None, :] - hump * np.float32(math.cos(angle))
        grid_v = np.arange(rows, dtype=np.float32)[:, None] - hump * np.float32(math.sin(angle))
        seen = cv2.remap(scene.electrons, grid_u, grid_v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return scene.seen_as(seen)

    cameras = frozenset((camera,))
    undetectable = by_a_step_of_the_print(shift_px) if camera == "front" else on_a_plate(cameras)
    note = f"by {shift_px:.1f} px within {size_px:.0f} px"
    return Spoil(note, light=light, cameras=cameras, undetectable=undetectable)


WAYS.row(
    "bent_view_of_window",
    "The picture of the front target is distorted, print and spot alike.",
    lambda draw: _bent(draw, "front"),
)
WAYS.row(
    "bent_view_of_plate", "The picture of the rear target is distorted.", lambda draw: _bent(draw, "rear")
)
