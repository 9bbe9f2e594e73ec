"""Ways that disturb surfaces in the light: dirt, water, scratches, hands and cables, lost print."""

from __future__ import annotations

import math

import cv2
import numpy as np

from benchmarks.campaign.detectability import by_a_step_of_the_print, merged_on_a_plate, on_a_plate
from benchmarks.campaign.scene import Scene, blurred
from benchmarks.campaign.way import CAMERAS, Draw, Registry, Spoil
from hw_sim.image import Image

WAYS = Registry("surfaces")


def _disc(scene: Scene, at: float, angle: float, width_mm: float, soft_px: float) -> Image:
    """1 inside a disc, ``at`` radii from the spot's centre in a direction, 0 outside."""
    u, v = scene.from_spot()
    right_px, down_px = (at * scene.spot.radius_px * f(angle) for f in (math.cos, math.sin))
    far = np.sqrt((u - np.float32(right_px)) ** 2 + (v - np.float32(down_px)) ** 2)
    radius_px = np.float32(width_mm * scene.px_per_mm / 2)
    disc: Image = np.clip(0.5 - (far - radius_px) / np.float32(max(soft_px, 0.5)), 0.0, 1.0)
    return disc


@WAYS.add()
def half_black(draw: Draw) -> Spoil:
    """A hand, sheet or tape with a sharp edge covers about half the spot."""
    at, angle, left = draw.uniform(-0.5, 0.9), draw.angle(), draw.uniform(0.0, 0.3)

    def light(scene: Scene, since: int) -> Scene:
        clear = scene.edge(angle, at * scene.spot.radius_px, 0.1 * scene.px_per_mm)
        return scene.all_times(left + (1 - left) * clear)

    return Spoil(f"from {at:.2f} radii on", light=light, cameras=draw.targets())


@WAYS.add()
def half_black_soft(draw: Draw) -> Spoil:
    """A shadow with a soft edge."""
    at, angle, soft_mm = draw.uniform(-0.5, 0.9), draw.angle(), draw.uniform(0.5, 6.0)

    def light(scene: Scene, since: int) -> Scene:
        return scene.all_times(scene.edge(angle, at * scene.spot.radius_px, soft_mm * scene.px_per_mm))

    return Spoil(f"from {at:.2f} radii on, edge of {soft_mm:.1f} mm", light=light, cameras=draw.targets())


@WAYS.add()
def quarter_black(draw: Draw) -> Spoil:
    """A corner covers a quarter of the spot."""
    angle, at_1, at_2 = draw.angle(), draw.uniform(-0.4, 0.6), draw.uniform(-0.4, 0.6)
    soft_mm = draw.log(0.1, 3.0)

    def light(scene: Scene, since: int) -> Scene:
        radius_px, soft_px = scene.spot.radius_px, soft_mm * scene.px_per_mm
        one = scene.edge(angle, at_1 * radius_px, soft_px)
        other = scene.edge(angle + math.pi / 2, at_2 * radius_px, soft_px)
        return scene.all_times(np.maximum(one, other))

    return Spoil(f"corner at {at_1:.2f}, {at_2:.2f} radii", light=light, cameras=draw.targets())


@WAYS.add()
def cable(draw: Draw) -> Spoil:
    """A dark line across the spot."""
    at, angle = draw.uniform(-1.0, 1.0), draw.angle()
    width_mm, left = draw.log(0.3, 6.0), draw.uniform(0.0, 0.5)

    def light(scene: Scene, since: int) -> Scene:
        return scene.all_times(1.0 - (1 - left) * scene.stripe(angle, at, width_mm, 1.0))

    return Spoil(f"{width_mm:.1f} mm wide, {at:.2f} radii aside", light=light, cameras=draw.targets())


@WAYS.add()
def grease(draw: Draw) -> Spoil:
    """A smear absorbs part of the light of about half the spot."""
    loss, at = draw.uniform(0.03, 0.3), draw.uniform(-0.6, 0.6)
    angle, soft_mm = draw.angle(), draw.log(0.2, 6.0)

    def light(scene: Scene, since: int) -> Scene:
        clear = scene.edge(angle, at * scene.spot.radius_px, soft_mm * scene.px_per_mm)
        return scene.all_times(1.0 - loss * (1.0 - clear))

    return Spoil(f"{loss:.0%} darker, edge of {soft_mm:.1f} mm", light=light, cameras=draw.targets())


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


@WAYS.add()
def particle(draw: Draw) -> Spoil:
    """A dark grain of dirt on the spot."""
    at, angle = draw.uniform(0.0, 1.1), draw.angle()
    width_mm, left = draw.log(0.4, 6.0), draw.uniform(0.0, 0.6)

    def light(scene: Scene, since: int) -> Scene:
        return scene.all_times(1.0 - (1 - left) * _disc(scene, at, angle, width_mm, 1.0))

    return Spoil(f"{width_mm:.1f} mm, {at:.2f} radii aside", light=light, cameras=draw.targets())


@WAYS.add()
def water_drop(draw: Draw) -> Spoil:
    """A drop: dark inside, with a bright ring or focus."""
    at, angle, width_mm = draw.uniform(0.0, 1.1), draw.angle(), draw.log(1.0, 6.0)
    dark, shape = draw.uniform(0.2, 0.9), draw.of("ring", "focus")

    def light(scene: Scene, since: int) -> Scene:
        inner = _disc(scene, at, angle, width_mm, 1.5)
        if shape == "ring":
            bright = _disc(scene, at, angle, 1.25 * width_mm, 1.5) - inner
            gain = 1.0 - dark * inner + dark * bright / np.float32(1.25**2 - 1.0)
        else:
            focus = _disc(scene, at, angle, 0.35 * width_mm, 1.0)
            gain = 1.0 - dark * inner + dark * focus / np.float32(0.35**2)
        return scene.all_times(gain)

    return Spoil(f"{shape} of {width_mm:.1f} mm", light=light, cameras=draw.targets())


@WAYS.add()
def condensation(draw: Draw) -> Spoil:
    """Many fine drops of varying transmission."""
    depth, grain_mm, seed = draw.uniform(0.1, 0.8), draw.log(0.3, 4.0), draw.seed()

    def light(scene: Scene, since: int) -> Scene:
        rng = np.random.default_rng([seed, CAMERAS.index(scene.camera)])
        rows, columns = scene.beam.shape
        grain_px = grain_mm * scene.px_per_mm
        shrunk = max(1, int(grain_px / 2))
        field = rng.standard_normal((rows // shrunk + 2, columns // shrunk + 2), dtype=np.float32)
        field = blurred(field, grain_px / shrunk / 2)
        field = np.asarray(cv2.resize(field, (columns, rows), interpolation=cv2.INTER_LINEAR), np.float32)
        field = np.clip(0.5 + field / np.float32(4 * max(float(field.std()), 1e-6)), 0.0, 1.0)
        return scene.all_times(1.0 - depth * field)

    return Spoil(f"{depth:.0%}, drops of {grain_mm:.1f} mm", light=light, cameras=draw.targets())


@WAYS.add()
def fog(draw: Draw) -> Spoil:
    """Fog or dust in the air: a broad halo, even or one-sided."""
    share, scale, side = draw.uniform(0.05, 0.7), draw.uniform(2.0, 8.0), draw.uniform(0.0, 1.5)
    angle = draw.angle()

    def light(scene: Scene, since: int) -> Scene:
        spot, far = scene.spot, side * scene.spot.radius_px
        halo = spot.moved(far * math.cos(angle), far * math.sin(angle)).scaled(scale, share)
        return scene.beam_times(1.0 - share).beam_plus(halo)

    return Spoil(f"{share:.0%} in a halo {scale:.1f} times as wide, {side:.1f} radii aside", light=light)


@WAYS.add()
def scratch(draw: Draw) -> Spoil:
    """A fine line across the spot, dark or bright."""
    at, angle, width_mm = draw.uniform(-1.0, 1.0), draw.angle(), draw.log(0.1, 0.8)
    gain = draw.uniform(0.0, 0.5) if draw.sign() < 0 else draw.uniform(1.5, 6.0)

    def light(scene: Scene, since: int) -> Scene:
        return scene.all_times(1.0 + (gain - 1.0) * scene.stripe(angle, at, width_mm, 1.0))

    return Spoil(f"{width_mm:.1f} mm wide, {gain:.1f} times the light", light=light, cameras=draw.targets())


@WAYS.add()
def print_lost(draw: Draw) -> Spoil:
    """Ink missing in a patch of the window, or paint of the plate."""
    at, angle = draw.uniform(0.2, 1.2), draw.angle()
    width_mm, left = draw.log(1.0, 10.0), draw.uniform(0.05, 0.5)

    def light(scene: Scene, since: int) -> Scene:
        return scene.all_times(1.0 - (1.0 - left) * _disc(scene, at, angle, width_mm, 2.0))

    return Spoil(f"{width_mm:.1f} mm, {left:.0%} left", light=light, cameras=draw.one())


@WAYS.add()
def bleached_patch(draw: Draw) -> Spoil:
    """A brighter patch on the plate."""
    at, angle = draw.uniform(0.3, 1.2), draw.angle()
    width_mm, gain, soft_mm = draw.log(2.0, 15.0), draw.uniform(1.05, 1.6), draw.log(0.2, 5.0)

    def light(scene: Scene, since: int) -> Scene:
        patch = _disc(scene, at, angle, width_mm, soft_mm * scene.px_per_mm)
        return scene.all_times(1.0 + (gain - 1.0) * patch)

    return Spoil(f"{width_mm:.1f} mm, {gain:.2f} times", light=light, cameras=frozenset(("rear",)))


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


@WAYS.add()
def defocused(draw: Draw) -> Spoil:
    """Blurred by 2 to 8 px."""
    blur_px = draw.uniform(2.0, 8.0)

    def light(scene: Scene, since: int) -> Scene:
        return scene.all_times(0.0).veiled(blurred(scene.electrons, blur_px))

    return Spoil(f"{blur_px:.1f} px", light=light, cameras=draw.targets())


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
        return scene.all_times(0.0).veiled(np.asarray(seen, np.float32))

    cameras = frozenset((camera,))
    undetectable = by_a_step_of_the_print(shift_px) if camera == "front" else on_a_plate(cameras)
    note = f"by {shift_px:.1f} px within {size_px:.0f} px"
    return Spoil(note, light=light, cameras=cameras, undetectable=undetectable)


@WAYS.add()
def bent_view_of_window(draw: Draw) -> Spoil:
    """The picture of the front target is distorted, print and spot alike."""
    return _bent(draw, "front")


@WAYS.add()
def bent_view_of_plate(draw: Draw) -> Spoil:
    """The picture of the rear target is distorted."""
    return _bent(draw, "rear")
