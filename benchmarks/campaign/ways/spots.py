"""Ways that disturb the laser's own light: reflections, lobes, tails, a beam that is cut or has changed."""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path

import cv2
import numpy as np

from benchmarks.campaign.detectability import Undetectable, near_on_both, near_on_one
from benchmarks.campaign.scene import Scene, SpotShape, blurred
from benchmarks.campaign.way import CAMERAS, Draw, Registry, Spoil
from hw_sim.image import Image

WAYS = Registry("spots")
BEAMS = Path(__file__).resolve().parents[4] / "shared/data/beams"


def _aside(draw: Draw, low_mm: float = 1.0, high_mm: float = 15.0) -> tuple[float, float, str]:
    """Draw a direction and a distance in mm, and describe both."""
    far_mm, angle = draw.log(low_mm, high_mm), draw.angle()
    return far_mm * math.cos(angle), far_mm * math.sin(angle), f"{far_mm:.1f} mm aside"


def _second_spot(scene: Scene, right_mm: float, down_mm: float, scale: float, share: float) -> Scene:
    ghost = scene.spot.moved(right_mm * scene.px_per_mm, down_mm * scene.px_per_mm).scaled(scale, share)
    return scene.beam_plus(ghost)


def _near(cameras: frozenset[str], share: float, far_mm: float) -> Undetectable:
    """Limit of a second spot beside the first on these targets."""
    return near_on_one(share, far_mm) if len(cameras) == 1 else near_on_both(far_mm)


@WAYS.add()
def reflection(draw: Draw) -> Spoil:
    """A second spot of the same shape; it moves with the first."""
    share, (right, down, words) = draw.log(0.03, 1.0), _aside(draw)
    return Spoil(
        f"{share:.0%} {words}",
        light=lambda scene, since: _second_spot(scene, right, down, 1.0, share),
        cameras=draw.one(),
        undetectable=near_on_one(share, math.hypot(right, down)),
    )


@WAYS.add()
def reflection_on_both(draw: Draw) -> Spoil:
    """The same second spot on both targets, such as a ghost beside the beam."""
    share, (right, down, words) = draw.log(0.03, 1.0), _aside(draw)
    return Spoil(
        f"{share:.0%} {words}",
        light=lambda scene, since: _second_spot(scene, right, down, 1.0, share),
        undetectable=near_on_both(math.hypot(right, down)),
    )


def _reflection_of(draw: Draw, most: float, scales: tuple[float, float], decimals: int) -> Spoil:
    """A second spot of up to ``most`` of the light, ``scales`` times as wide as the first."""
    share, scale, (right, down, words) = draw.log(0.03, most), draw.uniform(*scales), _aside(draw)
    return Spoil(
        f"{share:.0%} {words}, {scale:.{decimals}f} times as wide",
        light=lambda scene, since: _second_spot(scene, right, down, scale, share),
        cameras=draw.targets(),
    )


@WAYS.add()
def reflection_blurred(draw: Draw) -> Spoil:
    """A wider second spot."""
    return _reflection_of(draw, 1.0, (1.3, 3.0), 1)


@WAYS.add()
def reflection_sharper(draw: Draw) -> Spoil:
    """A narrower second spot."""
    return _reflection_of(draw, 0.6, (0.25, 0.8), 2)


@WAYS.add()
def reflection_ring(draw: Draw) -> Spoil:
    """A ring of light, as from a curved rim."""
    share, (right, down, words) = draw.log(0.03, 0.6), _aside(draw, 0.5)
    radius_mm, width_mm = draw.uniform(1.0, 8.0), draw.uniform(0.3, 1.5)

    def light(scene: Scene, since: int) -> Scene:
        u, v = scene.from_spot()
        mm = scene.px_per_mm
        far = np.hypot(u - np.float32(right * mm), v - np.float32(down * mm)) - np.float32(radius_mm * mm)
        ring = np.exp(-2.0 * (far / np.float32(width_mm * mm)) ** 2)
        area_px = 2 * math.pi * radius_mm * width_mm * math.sqrt(math.pi / 2) * mm * mm
        peak = share * scene.spot.peak * math.pi * scene.spot.radius_px**2 / 2 / area_px
        return scene.lit(np.float32(peak) * ring)

    return Spoil(f"{share:.0%} in a ring {words}", light=light, cameras=draw.targets())


@WAYS.add(moving=True)
def reflection_fixed(draw: Draw) -> Spoil:
    """A second spot that stays while the first moves."""
    share, (right, down, words) = draw.log(0.03, 1.0), _aside(draw)
    ghosts: dict[str, SpotShape] = {}

    def light(scene: Scene, since: int) -> Scene:
        mm = scene.px_per_mm
        ghost = ghosts.setdefault(scene.camera, scene.spot.moved(right * mm, down * mm).scaled(1.0, share))
        return scene.beam_plus(ghost)

    cameras = draw.targets()
    undetectable = _near(cameras, share, math.hypot(right, down))
    return Spoil(
        f"{share:.0%} {words}, at rest", light=light, cameras=cameras, varies=True, undetectable=undetectable
    )


@WAYS.add()
def twin_spots(draw: Draw) -> Spoil:
    """A second spot of the same brightness, 2 to 6 mm aside."""
    (right, down, words), share = _aside(draw, 2.0, 6.0), draw.uniform(0.9, 1.1)
    cameras = draw.targets()
    return Spoil(
        words,
        light=lambda scene, since: _second_spot(scene, right, down, 1.0, share),
        cameras=cameras,
        undetectable=_near(cameras, share, math.hypot(right, down)),
    )


@WAYS.add()
def comet_tail(draw: Draw) -> Spoil:
    """Light smeared to one side over some millimetres."""
    share, length_mm, angle = draw.log(0.02, 0.2), draw.uniform(1.5, 10.0), draw.angle()

    def light(scene: Scene, since: int) -> Scene:
        steps = np.linspace(0.2, 3.0, 8)
        weights = np.exp(-steps) / np.exp(-steps).sum()
        for step, weight in zip(steps * length_mm, weights, strict=True):
            scene = _second_spot(scene, step * math.cos(angle), step * math.sin(angle), 1.0, share * weight)
        return scene

    return Spoil(f"{share:.0%} over {length_mm:.1f} mm", light=light, cameras=draw.targets())


@WAYS.add()
def fringes(draw: Draw) -> Spoil:
    """Interference stripes of the window over the beam."""
    contrast, period_mm = draw.uniform(0.05, 0.3), draw.log(0.5, 5.0)
    angle, phase = draw.angle(), draw.angle()

    def light(scene: Scene, since: int) -> Scene:
        turns = scene.along(angle) / np.float32(period_mm * scene.px_per_mm)
        stripes = np.cos(np.float32(2 * math.pi) * turns + np.float32(phase))
        return scene.beam_times(1.0 + np.float32(contrast) * stripes)

    return Spoil(f"contrast {contrast:.0%}, period {period_mm:.1f} mm", light=light, cameras=draw.targets())


@WAYS.add()
def clipped_beam(draw: Draw) -> Spoil:
    """An aperture cuts the beam before the window, on the same side of both targets."""
    depth, angle, soft_mm = draw.uniform(-0.6, 0.95), draw.angle(), draw.uniform(0.1, 1.0)

    def light(scene: Scene, since: int) -> Scene:
        # the front picture is mirrored: its right is the rear's left
        direction = angle if scene.camera == "rear" else math.pi - angle
        passed = scene.edge(direction, depth * scene.spot.radius_px, soft_mm * scene.px_per_mm)
        return scene.beam_times(passed)

    return Spoil(f"from {depth:.2f} radii on", light=light)


@WAYS.add()
def speckle_changed(draw: Draw) -> Spoil:
    """Coarser or finer speckle than at the calibration."""
    contrast, grain_px, seed = draw.uniform(0.05, 0.3), draw.uniform(0.6, 6.0), draw.seed()

    def light(scene: Scene, since: int) -> Scene:
        rng = np.random.default_rng([seed, CAMERAS.index(scene.camera)])
        grain = blurred(rng.standard_normal(scene.beam.shape, dtype=np.float32), grain_px)
        depth = np.float32(contrast / max(float(grain.std()), 1e-6))
        return scene.beam_times(np.maximum(1.0 + depth * grain, 0.0))

    return Spoil(f"contrast {contrast:.0%}, grain {grain_px:.1f} px", light=light, cameras=draw.targets())


def _spot_of(draw: Draw, scales: tuple[float, float], decimals: int) -> Spoil:
    """The spot ``scales`` times as wide, with all of its light."""
    scale = draw.uniform(*scales)
    return Spoil(
        f"{scale:.{decimals}f} times as wide",
        light=lambda scene, since: scene.without_laser().beam_plus(scene.spot.scaled(scale, 1.0)),
        cameras=draw.targets(),
    )


@WAYS.add()
def spot_larger(draw: Draw) -> Spoil:
    """A wider spot than at the calibration."""
    return _spot_of(draw, (1.3, 3.0), 1)


@WAYS.add()
def spot_smaller(draw: Draw) -> Spoil:
    """A narrower spot than at the calibration."""
    return _spot_of(draw, (0.25, 0.75), 2)


@WAYS.add()
def two_lobes(draw: Draw) -> Spoil:
    """Laser mode TEM01 or TEM10, lobes of equal or up to double brightness."""
    angle, uneven = draw.angle(), draw.of("even", "uneven")
    slope = 0.0 if uneven == "even" else draw.uniform(0.1, 0.33)

    def light(scene: Scene, since: int) -> Scene:
        along = scene.along(angle) / np.float32(scene.spot.radius_px)
        return scene.beam_times(4.0 * along * along * (1.0 + np.float32(slope) * np.sign(along)))

    return Spoil(f"{uneven} lobes", light=light, cameras=draw.targets())


@cache
def _photographs() -> tuple[Image, ...]:
    """Photographs of beams less their background, each with its brightest pixel at 1."""
    pictures = []
    for path in sorted(BEAMS.glob("*.p[gn][mg]")):
        picture = np.asarray(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE), np.float32)
        picture = blurred(picture, 1.0)
        picture -= np.median(np.concatenate([picture[0], picture[-1], picture[:, 0], picture[:, -1]]))
        picture[picture < 0.02 * picture.max()] = 0.0
        pictures.append(picture / picture.max())
    return tuple(pictures)


def photographed_beam(draw: Draw) -> Spoil:
    """A photograph of a real beam instead of the spot, placed by its centroid (ISO 11146)."""
    pictures = _photographs()
    number, width_mm, turn = draw.whole(0, len(pictures) - 1), draw.uniform(6.0, 15.0), draw.uniform(0, 360)
    picture = pictures[number]

    def light(scene: Scene, since: int) -> Scene:
        moments = cv2.moments(picture)
        u, v = moments["m10"] / moments["m00"], moments["m01"] / moments["m00"]
        diameter_px = 2.0 * math.sqrt(2.0 * (moments["mu20"] + moments["mu02"]) / moments["m00"])
        matrix = cv2.getRotationMatrix2D((u, v), turn, width_mm * scene.px_per_mm / diameter_px)
        matrix[:, 2] += np.array([scene.spot.u_px - u, scene.spot.v_px - v])
        rows, columns = scene.beam.shape
        pasted = cv2.warpAffine(picture, matrix, (columns, rows), flags=cv2.INTER_AREA)
        return scene.without_laser().lit(np.float32(scene.spot.peak) * np.asarray(pasted, np.float32))

    return Spoil(f"photograph {number}, {width_mm:.0f} mm", light=light, cameras=draw.targets())


if BEAMS.is_dir():
    WAYS.add()(photographed_beam)


def _times_the_light(draw: Draw, times: float, words: str) -> Spoil:
    return Spoil(words, light=lambda scene, since: scene.beam_times(times), cameras=draw.targets())


@WAYS.add()
def dim_laser(draw: Draw) -> Spoil:
    """1 to 50 % of the light."""
    share = draw.log(0.01, 0.5)
    return _times_the_light(draw, share, f"{share:.1%} of the light")


@WAYS.add()
def dazzling_laser(draw: Draw) -> Spoil:
    """Too much light for the exposure."""
    times = draw.log(1.3, 30.0)
    return _times_the_light(draw, times, f"{times:.1f} times the light")


@WAYS.add()
def flickering_laser(draw: Draw) -> Spoil:
    """The power differs between exposures."""
    depth, seed = draw.uniform(0.3, 1.0), draw.seed()

    def light(scene: Scene, since: int) -> Scene:
        return scene.beam_times(1.0 - depth * float(np.random.default_rng([seed, since]).random()))

    return Spoil(f"by up to {depth:.0%}", light=light, varies=True)


@WAYS.add(invisible="the laser is deflected before the window, as if the machine had moved: 0.1 to 20 mm")
def deflected_laser(draw: Draw) -> Spoil:
    """The whole beam is deflected."""
    right, down, words = _aside(draw, 0.1, 20.0)

    def light(scene: Scene, since: int) -> Scene:
        to_right = right if scene.camera == "rear" else -right
        moved = scene.spot.moved(to_right * scene.px_per_mm, down * scene.px_per_mm)
        return scene.without_laser().beam_plus(moved)

    return Spoil(words, light=light)
