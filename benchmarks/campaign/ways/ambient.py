"""Ways with other light: lamps, the sun, welding; with and without the laser."""

import math

import numpy as np

from benchmarks.campaign.detectability import always_detectable, two_lamps_like_a_laser
from benchmarks.campaign.scene import Scene
from benchmarks.campaign.way import CAMERAS, Draw, Registry, Spoil, drawn, log, names_of, of, uniform
from hw_sim.sensor import FULL_WELL_E

WAYS = Registry("ambient")


def _lamp(scene: Scene, u_px: float, v_px: float, width_mm: float, shape: str, level: float) -> Scene:
    """The scene with a lamp of ``level`` of the spot's peak: a disc with an edge, or a smooth hump."""
    rows, columns = scene.beam.shape
    far = np.hypot(
        np.arange(columns, dtype=np.float32)[None, :] - np.float32(u_px),
        np.arange(rows, dtype=np.float32)[:, None] - np.float32(v_px),
    )
    radius_px = np.float32(width_mm * scene.px_per_mm / 2)
    if shape == "disc":
        patch = np.clip(0.5 - (far - radius_px) / np.float32(2.0), 0.0, 1.0)
    else:
        patch = np.exp(-2.0 * (far / radius_px) ** 2)
    return scene.lit(np.float32(level * scene.spot.peak) * patch)


def _lamp_only(scene: Scene, place: tuple[float, float], width_mm: float, shape: str, level: float) -> Scene:
    """A lamp at this distance right of and below the picture's centre, mm, and no laser."""
    rows, columns = scene.beam.shape
    u, v = columns / 2 + place[0] * scene.px_per_mm, rows / 2 + place[1] * scene.px_per_mm
    return _lamp(scene.without_laser(), u, v, width_mm, shape, level)


def _lamp_alone(draw: Draw, shape: str) -> Spoil:
    """Lamps on both targets, at any position, and no laser."""
    widths = {camera: draw.log(3.0, 30.0) for camera in CAMERAS}
    places = {camera: (draw.uniform(-40, 40), draw.uniform(-30, 30)) for camera in CAMERAS}
    level = draw.log(0.05, 1.0)

    def light(scene: Scene, since: int) -> Scene:
        return _lamp_only(scene, places[scene.camera], widths[scene.camera], shape, level)

    words = " and ".join(f"{width:.0f}" for width in widths.values())
    return Spoil(
        f"{words} mm, {level:.0%} as bright",
        light=light,
        no_beam=True,
        undetectable=two_lamps_like_a_laser(widths.values()) if shape == "hump" else always_detectable,
    )


WAYS.row(
    "lamp_disc_alone",
    "Laser off; a disc of lamplight on each target.",
    lambda draw: _lamp_alone(draw, "disc"),
)
WAYS.row(
    "lamp_hump_alone",
    "Laser off; lamplight without an edge on each target.",
    lambda draw: _lamp_alone(draw, "hump"),
)


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


@WAYS.on_light("{shape} of {width_mm:.0f} mm, {level:.0%}, {far_mm:.0f} mm aside")
@drawn(log(3.0, 30.0), of("disc", "hump"), log(0.02, 1.0), uniform(2.0, 35.0), Draw.angle)
def lamp_beside(
    scene: Scene, width_mm: float, shape: str, level: float, far_mm: float, angle: float
) -> Scene:
    """A lamp beside the spot or partly on it."""
    far_px = far_mm * scene.px_per_mm
    u, v = scene.spot.u_px + far_px * math.cos(angle), scene.spot.v_px + far_px * math.sin(angle)
    return _lamp(scene, u, v, width_mm, shape, level)


@WAYS.on_light("{level:.0%} of full scale")
@drawn(log(0.02, 0.5), Draw.angle, uniform(-1.0, 1.0))
def ambient_gradient(scene: Scene, level: float, angle: float, bend: float) -> Scene:
    """Daylight that decreases across the picture."""
    rows, columns = scene.beam.shape
    u = np.linspace(-1, 1, columns, dtype=np.float32)[None, :]
    v = np.linspace(-1, 1, rows, dtype=np.float32)[:, None]
    along = u * np.float32(math.cos(angle)) + v * np.float32(math.sin(angle))
    ramp = np.maximum(0.5 + 0.4 * along + 0.3 * np.float32(bend) * along * along, 0.0)
    return scene.veiled(np.float32(level * FULL_WELL_E) * ramp)


@WAYS.on_light("{level:.0%}, {width_mm:.0f} mm wide, edge of {soft_mm:.1f} mm")
@drawn(log(0.02, 0.6), Draw.angle, log(2.0, 40.0), log(0.2, 8.0), uniform(-2.0, 2.0))
def sun_stripe(scene: Scene, level: float, angle: float, width_mm: float, soft_mm: float, at: float) -> Scene:
    """A stripe of sunlight over or beside the spot."""
    stripe = scene.stripe(angle, at, width_mm, soft_mm * scene.px_per_mm)
    return scene.veiled(np.float32(level * FULL_WELL_E) * np.maximum(stripe, 0.0))


@WAYS.on_light("{level:.0%}, edge of {soft_mm:.1f} mm")
@drawn(log(0.02, 0.5), Draw.angle, log(0.2, 10.0), uniform(-1.0, 1.0))
def sun_edge(scene: Scene, level: float, angle: float, soft_mm: float, at: float) -> Scene:
    """A border of sun and shade through the spot."""
    return scene.veiled(np.float32(level * FULL_WELL_E) * (1.0 - scene.edge(angle, at, soft_mm)))


@WAYS.on_light("up to {level:.0%} of full scale", varies=True)
@drawn(log(0.05, 2.0), Draw.seed)
def welding_flash(scene: Scene, since: int, level: float, seed: int) -> Scene:
    """A flash on some rows of some exposures."""
    rng = np.random.default_rng([seed, since, CAMERAS.index(scene.camera)])
    rows = scene.beam.shape[0]
    lit = np.zeros((rows, 1), np.float32)
    first = int(rng.integers(-rows // 2, rows))
    lit[max(first, 0) : max(first + rows // 2, 0)] = rng.random()
    return scene.veiled(np.float32(level * FULL_WELL_E) * lit)


@WAYS.on_light("{level:.0%} of full scale")
@drawn(log(0.02, 0.9))
def ambient_step(scene: Scene, level: float) -> Scene:
    """The lights are switched on."""
    return scene.veiled(level * FULL_WELL_E)


@WAYS.on_light("{share:.0%}, {far_mm:.0f} mm aside")
@drawn(log(0.1, 3.0), uniform(0.5, 1.5), uniform(15.0, 60.0), Draw.angle)
def other_laser(scene: Scene, share: float, width: float, far_mm: float, angle: float) -> Scene:
    """Another laser on one target, far from the spot, brighter or dimmer."""
    far_px = far_mm * scene.px_per_mm
    other = scene.spot.moved(far_px * math.cos(angle), far_px * math.sin(angle)).scaled(width, share)
    return scene.beam_plus(other)


@WAYS.add()
def laser_off(draw: Draw) -> Spoil:
    """The laser is off or blocked; ambient light stays."""
    cameras = draw.targets()
    return Spoil(
        names_of(cameras), light=lambda scene, since: scene.without_laser(), cameras=cameras, no_beam=True
    )


@WAYS.on_light("{level:.0%} of full scale, {depth:.0%} deep", Draw.both, varies=True)
@drawn(log(0.01, 0.4), uniform(0.2, 1.0), uniform(0.0, 0.5))
def lamp_flicker(scene: Scene, since: int, level: float, depth: float, turns: float) -> Scene:
    """Ambient light that beats with the exposures, as of lamps on the mains."""
    return scene.veiled(level * FULL_WELL_E * (1.0 + depth * math.sin(2.0 * math.pi * turns * since)))
