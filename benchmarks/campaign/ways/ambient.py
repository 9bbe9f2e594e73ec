"""Ways with other light: lamps, the sun, welding; with and without the laser."""

from __future__ import annotations

import math

import numpy as np

from benchmarks.campaign.detectability import always_detectable
from benchmarks.campaign.scene import Scene
from benchmarks.campaign.way import CAMERAS, Draw, Registry, Spoil
from hw_sim.image import Image
from hw_sim.sensor import FULL_WELL_E

WAYS = Registry("ambient")


def _lamp(scene: Scene, u_px: float, v_px: float, width_mm: float, shape: str) -> Image:
    """A patch of light of height 1: a disc with an edge, or a smooth hump."""
    far = np.hypot(
        np.arange(scene.beam.shape[1], dtype=np.float32)[None, :] - np.float32(u_px),
        np.arange(scene.beam.shape[0], dtype=np.float32)[:, None] - np.float32(v_px),
    )
    radius_px = width_mm * scene.px_per_mm / 2
    if shape == "disc":
        disc: Image = np.clip(0.5 - (far - np.float32(radius_px)) / np.float32(2.0), 0.0, 1.0)
        return disc
    hump: Image = np.exp(-2.0 * (far / np.float32(radius_px)) ** 2)
    return hump


def _lamp_only(scene: Scene, place: tuple[float, float], width_mm: float, shape: str, level: float) -> Scene:
    """A lamp at this distance right of and below the picture's centre, mm, and no laser."""
    rows, columns = scene.beam.shape
    u, v = columns / 2 + place[0] * scene.px_per_mm, rows / 2 + place[1] * scene.px_per_mm
    lamp = _lamp(scene, u, v, width_mm, shape)
    return scene.without_laser().lit(np.float32(level * scene.spot.peak) * lamp)


_LIKE_A_LASER = (
    "two lamps without an edge, 4 to 18 mm wide, at two places that one beam can hit, look like its spots"
)


def _lamp_alone(draw: Draw, shape: str) -> Spoil:
    """Lamps on both targets, at any position, and no laser."""
    widths = {camera: draw.log(3.0, 30.0) for camera in CAMERAS}
    places = {camera: (draw.uniform(-40, 40), draw.uniform(-30, 30)) for camera in CAMERAS}
    level = draw.log(0.05, 1.0)

    def light(scene: Scene, since: int) -> Scene:
        return _lamp_only(scene, places[scene.camera], widths[scene.camera], shape, level)

    words = " and ".join(f"{width:.0f}" for width in widths.values())
    like_a_laser = shape == "hump" and all(4 < width_mm < 18 for width_mm in widths.values())
    return Spoil(
        f"{words} mm, {level:.0%} as bright",
        light=light,
        no_beam=True,
        undetectable=(lambda subject: _LIKE_A_LASER) if like_a_laser else always_detectable,
    )


@WAYS.add()
def lamp_disc_alone(draw: Draw) -> Spoil:
    """Laser off; a disc of lamplight on each target."""
    return _lamp_alone(draw, "disc")


@WAYS.add()
def lamp_hump_alone(draw: Draw) -> Spoil:
    """Laser off; lamplight without an edge on each target."""
    return _lamp_alone(draw, "hump")


@WAYS.add()
def lamp_on_one(draw: Draw) -> Spoil:
    """A lamp instead of the laser on one target."""
    width_mm, shape, level = draw.log(3.0, 30.0), draw.of("disc", "hump"), draw.log(0.05, 1.0)
    place = draw.uniform(-40, 40), draw.uniform(-30, 30)
    return Spoil(
        f"{shape} of {width_mm:.0f} mm",
        light=lambda scene, since: _lamp_only(scene, place, width_mm, shape, level),
        cameras=draw.one(),
        no_beam=True,
    )


@WAYS.add()
def lamp_beside(draw: Draw) -> Spoil:
    """A lamp beside the spot or partly on it."""
    width_mm, shape, level = draw.log(3.0, 30.0), draw.of("disc", "hump"), draw.log(0.02, 1.0)
    far_mm, angle = draw.uniform(2.0, 35.0), draw.angle()

    def light(scene: Scene, since: int) -> Scene:
        far_px = far_mm * scene.px_per_mm
        u, v = scene.spot.u_px + far_px * math.cos(angle), scene.spot.v_px + far_px * math.sin(angle)
        return scene.lit(np.float32(level * scene.spot.peak) * _lamp(scene, u, v, width_mm, shape))

    return Spoil(
        f"{shape} of {width_mm:.0f} mm, {level:.0%}, {far_mm:.0f} mm aside",
        light=light,
        cameras=draw.targets(),
    )


@WAYS.add()
def ambient_gradient(draw: Draw) -> Spoil:
    """Daylight that decreases across the picture."""
    level, angle, bend = draw.log(0.02, 0.5), draw.angle(), draw.uniform(-1.0, 1.0)

    def light(scene: Scene, since: int) -> Scene:
        rows, columns = scene.beam.shape
        u = np.linspace(-1, 1, columns, dtype=np.float32)[None, :]
        v = np.linspace(-1, 1, rows, dtype=np.float32)[:, None]
        along = u * np.float32(math.cos(angle)) + v * np.float32(math.sin(angle))
        ramp = np.maximum(0.5 + 0.4 * along + 0.3 * np.float32(bend) * along * along, 0.0)
        return scene.veiled(np.float32(level * FULL_WELL_E) * ramp)

    return Spoil(f"{level:.0%} of full scale", light=light, cameras=draw.targets())


@WAYS.add()
def sun_stripe(draw: Draw) -> Spoil:
    """A stripe of sunlight over or beside the spot."""
    level, angle = draw.log(0.02, 0.6), draw.angle()
    width_mm, soft_mm, at = draw.log(2.0, 40.0), draw.log(0.2, 8.0), draw.uniform(-2.0, 2.0)

    def light(scene: Scene, since: int) -> Scene:
        stripe = scene.stripe(angle, at, width_mm, soft_mm * scene.px_per_mm)
        return scene.veiled(np.float32(level * FULL_WELL_E) * np.maximum(stripe, 0.0))

    return Spoil(
        f"{level:.0%}, {width_mm:.0f} mm wide, edge of {soft_mm:.1f} mm", light=light, cameras=draw.targets()
    )


@WAYS.add()
def sun_edge(draw: Draw) -> Spoil:
    """A border of sun and shade through the spot."""
    level, angle = draw.log(0.02, 0.5), draw.angle()
    soft_mm, at = draw.log(0.2, 10.0), draw.uniform(-1.0, 1.0)

    def light(scene: Scene, since: int) -> Scene:
        shade = scene.edge(angle, at * scene.spot.radius_px, soft_mm * scene.px_per_mm)
        return scene.veiled(np.float32(level * FULL_WELL_E) * (1.0 - shade))

    return Spoil(f"{level:.0%}, edge of {soft_mm:.1f} mm", light=light, cameras=draw.targets())


@WAYS.add()
def welding_flash(draw: Draw) -> Spoil:
    """A flash on some rows of some exposures."""
    level, seed = draw.log(0.05, 2.0), draw.seed()

    def light(scene: Scene, since: int) -> Scene:
        rng = np.random.default_rng([seed, since, CAMERAS.index(scene.camera)])
        rows = scene.beam.shape[0]
        lit = np.zeros((rows, 1), np.float32)
        first = int(rng.integers(-rows // 2, rows))
        lit[max(first, 0) : max(first + rows // 2, 0)] = rng.random()
        return scene.veiled(np.float32(level * FULL_WELL_E) * lit)

    return Spoil(f"up to {level:.0%} of full scale", light=light, cameras=draw.targets(), varies=True)


@WAYS.add()
def ambient_step(draw: Draw) -> Spoil:
    """The lights are switched on."""
    level = draw.log(0.02, 0.9)
    return Spoil(
        f"{level:.0%} of full scale",
        light=lambda scene, since: scene.veiled(level * FULL_WELL_E),
        cameras=draw.targets(),
    )


@WAYS.add()
def other_laser(draw: Draw) -> Spoil:
    """Another laser on one target, far from the spot, brighter or dimmer."""
    share, width = draw.log(0.1, 3.0), draw.uniform(0.5, 1.5)
    far_mm, angle = draw.uniform(15.0, 60.0), draw.angle()

    def light(scene: Scene, since: int) -> Scene:
        far_px = far_mm * scene.px_per_mm
        other = scene.spot.moved(far_px * math.cos(angle), far_px * math.sin(angle)).scaled(width, share)
        return scene.beam_plus(other)

    return Spoil(f"{share:.0%}, {far_mm:.0f} mm aside", light=light, cameras=draw.targets())


@WAYS.add()
def laser_off(draw: Draw) -> Spoil:
    """The laser is off or blocked; ambient light stays."""
    cameras = draw.targets()
    words = " and ".join(sorted(cameras))
    return Spoil(words, light=lambda scene, since: scene.without_laser(), cameras=cameras, no_beam=True)


@WAYS.add()
def lamp_flicker(draw: Draw) -> Spoil:
    """Ambient light that beats with the exposures, as of lamps on the mains."""
    level, depth, turns = draw.log(0.01, 0.4), draw.uniform(0.2, 1.0), draw.uniform(0.0, 0.5)

    def light(scene: Scene, since: int) -> Scene:
        now = 1.0 + depth * math.sin(2.0 * math.pi * turns * since)
        return scene.veiled(level * FULL_WELL_E * now)

    return Spoil(f"{level:.0%} of full scale, {depth:.0%} deep", light=light, varies=True)
