"""Ways that disturb the laser's own light: reflections, lobes, tails, a beam that is cut or has changed."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np

from benchmarks.campaign.detectability import Undetectable, near_on_both, near_on_one
from benchmarks.campaign.scene import Scene, SpotShape, blurred
from benchmarks.campaign.way import CAMERAS, Draw, Registry, Spoil, drawn, log, uniform
from hw_sim.image import Image

WAYS = Registry("spots")
BEAMS = Path(__file__).resolve().parents[4] / "shared/data/beams"


@dataclass(frozen=True, slots=True)
class _Aside:
    """Distance of a second spot right of and below the first."""

    right_mm: float
    down_mm: float
    words: str = ""

    @classmethod
    def drawn(cls, draw: Draw, low_mm: float = 1.0, high_mm: float = 15.0) -> _Aside:
        far_mm, angle = draw.log(low_mm, high_mm), draw.angle()
        return cls(far_mm * math.cos(angle), far_mm * math.sin(angle), f"{far_mm:.1f} mm aside")

    def __str__(self) -> str:
        return self.words

    def spot(self, scene: Scene, share: float, scale: float = 1.0) -> SpotShape:
        mm = scene.px_per_mm
        return scene.spot.moved(self.right_mm * mm, self.down_mm * mm).scaled(scale, share)

    def limit(self, cameras: frozenset[str], share: float) -> Undetectable:
        """Limit of a second spot of the same shape on these targets."""
        far_mm = math.hypot(self.right_mm, self.down_mm)
        return near_on_one(share, far_mm) if len(cameras) == 1 else near_on_both(far_mm)


def _second_spot(note: str, aside: _Aside, share: float, cameras: frozenset[str]) -> Spoil:
    return Spoil(
        note,
        light=lambda scene, since: scene.beam_plus(aside.spot(scene, share)),
        cameras=cameras,
        undetectable=aside.limit(cameras, share),
    )


@WAYS.add()
def reflection(draw: Draw) -> Spoil:
    """A second spot of the same shape; it moves with the first."""
    share, aside = draw.log(0.03, 1.0), _Aside.drawn(draw)
    return _second_spot(f"{share:.0%} {aside}", aside, share, draw.one())


@WAYS.add()
def reflection_on_both(draw: Draw) -> Spoil:
    """The same second spot on both targets, such as a ghost beside the beam."""
    share, aside = draw.log(0.03, 1.0), _Aside.drawn(draw)
    return _second_spot(f"{share:.0%} {aside}", aside, share, frozenset(CAMERAS))


@WAYS.on_light("{share:.0%} {aside}, {scale:.1f} times as wide")
@drawn(log(0.03, 1.0), uniform(1.3, 3.0), _Aside.drawn)
def reflection_blurred(scene: Scene, share: float, scale: float, aside: _Aside) -> Scene:
    """A wider second spot."""
    return scene.beam_plus(aside.spot(scene, share, scale))


@WAYS.on_light("{share:.0%} {aside}, {scale:.2f} times as wide")
@drawn(log(0.03, 0.6), uniform(0.25, 0.8), _Aside.drawn)
def reflection_sharper(scene: Scene, share: float, scale: float, aside: _Aside) -> Scene:
    """A narrower second spot."""
    return scene.beam_plus(aside.spot(scene, share, scale))


@WAYS.on_light("{share:.0%} in a ring {aside}")
@drawn(log(0.03, 0.6), lambda draw: _Aside.drawn(draw, 0.5), uniform(1.0, 8.0), uniform(0.3, 1.5))
def reflection_ring(scene: Scene, share: float, aside: _Aside, radius_mm: float, width_mm: float) -> Scene:
    """A ring of light, as from a curved rim."""
    u, v = scene.from_spot()
    mm = scene.px_per_mm
    far = np.hypot(u - np.float32(aside.right_mm * mm), v - np.float32(aside.down_mm * mm))
    ring = np.exp(-2.0 * ((far - np.float32(radius_mm * mm)) / np.float32(width_mm * mm)) ** 2)
    area_px = 2 * math.pi * radius_mm * width_mm * math.sqrt(math.pi / 2) * mm * mm
    peak = share * scene.spot.peak * math.pi * scene.spot.radius_px**2 / 2 / area_px
    return scene.lit(np.float32(peak) * ring)


@WAYS.add(moving=True)
def reflection_fixed(draw: Draw) -> Spoil:
    """A second spot that stays while the first moves."""
    share, aside = draw.log(0.03, 1.0), _Aside.drawn(draw)
    ghosts: dict[str, SpotShape] = {}

    def light(scene: Scene, since: int) -> Scene:
        return scene.beam_plus(ghosts.setdefault(scene.camera, aside.spot(scene, share)))

    spoil = _second_spot(f"{share:.0%} {aside}, at rest", aside, share, draw.targets())
    return replace(spoil, light=light, varies=True)


@WAYS.add()
def twin_spots(draw: Draw) -> Spoil:
    """A second spot of the same brightness, 2 to 6 mm aside."""
    aside, share = _Aside.drawn(draw, 2.0, 6.0), draw.uniform(0.9, 1.1)
    return _second_spot(aside.words, aside, share, draw.targets())


@WAYS.on_light("{share:.0%} over {length_mm:.1f} mm")
@drawn(log(0.02, 0.2), uniform(1.5, 10.0), Draw.angle)
def comet_tail(scene: Scene, share: float, length_mm: float, angle: float) -> Scene:
    """Light smeared to one side over some millimetres."""
    steps = np.linspace(0.2, 3.0, 8)
    weights = np.exp(-steps) / np.exp(-steps).sum()
    for step_mm, weight in zip(steps * length_mm, weights, strict=True):
        aside = _Aside(step_mm * math.cos(angle), step_mm * math.sin(angle))
        scene = scene.beam_plus(aside.spot(scene, share * weight))
    return scene


@WAYS.on_light("contrast {contrast:.0%}, period {period_mm:.1f} mm")
@drawn(uniform(0.05, 0.3), log(0.5, 5.0), Draw.angle, Draw.angle)
def fringes(scene: Scene, contrast: float, period_mm: float, angle: float, phase: float) -> Scene:
    """Interference stripes of the window over the beam."""
    turns = scene.along(angle) / np.float32(period_mm * scene.px_per_mm)
    stripes = np.cos(np.float32(2 * math.pi) * turns + np.float32(phase))
    return scene.beam_times(1.0 + np.float32(contrast) * stripes)


@WAYS.on_light("from {depth:.2f} radii on", Draw.both)
@drawn(uniform(-0.6, 0.95), Draw.angle, uniform(0.1, 1.0))
def clipped_beam(scene: Scene, depth: float, angle: float, soft_mm: float) -> Scene:
    """An aperture cuts the beam before the window, on the same side of both targets."""
    # the front picture is mirrored: its right is the rear's left
    direction = angle if scene.camera == "rear" else math.pi - angle
    return scene.beam_times(scene.edge(direction, depth, soft_mm))


@WAYS.on_light("contrast {contrast:.0%}, grain {grain_px:.1f} px")
@drawn(uniform(0.05, 0.3), uniform(0.6, 6.0), Draw.seed)
def speckle_changed(scene: Scene, contrast: float, grain_px: float, seed: int) -> Scene:
    """Coarser or finer speckle than at the calibration."""
    rng = np.random.default_rng([seed, CAMERAS.index(scene.camera)])
    grain = blurred(rng.standard_normal(scene.beam.shape, dtype=np.float32), grain_px)
    depth = np.float32(contrast / max(float(grain.std()), 1e-6))
    return scene.beam_times(np.maximum(1.0 + depth * grain, 0.0))


@WAYS.on_light("{scale:.1f} times as wide")
@drawn(uniform(1.3, 3.0))
def spot_larger(scene: Scene, scale: float) -> Scene:
    """A wider spot than at the calibration."""
    return scene.with_laser(scene.spot.scaled(scale, 1.0))


@WAYS.on_light("{scale:.2f} times as wide")
@drawn(uniform(0.25, 0.75))
def spot_smaller(scene: Scene, scale: float) -> Scene:
    """A narrower spot than at the calibration."""
    return scene.with_laser(scene.spot.scaled(scale, 1.0))


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


@WAYS.on_light("{share:.1%} of the light")
@drawn(log(0.01, 0.5))
def dim_laser(scene: Scene, share: float) -> Scene:
    """1 to 50 % of the light."""
    return scene.beam_times(share)


@WAYS.on_light("{times:.1f} times the light")
@drawn(log(1.3, 30.0))
def dazzling_laser(scene: Scene, times: float) -> Scene:
    """Too much light for the exposure."""
    return scene.beam_times(times)


@WAYS.on_light("by up to {depth:.0%}", Draw.both, varies=True)
@drawn(uniform(0.3, 1.0), Draw.seed)
def flickering_laser(scene: Scene, since: int, depth: float, seed: int) -> Scene:
    """The power differs between exposures."""
    return scene.beam_times(1.0 - depth * float(np.random.default_rng([seed, since]).random()))


@WAYS.add(invisible="the laser is deflected before the window, as if the machine had moved: 0.1 to 20 mm")
def deflected_laser(draw: Draw) -> Spoil:
    """The whole beam is deflected."""
    aside = _Aside.drawn(draw, 0.1, 20.0)

    def light(scene: Scene, since: int) -> Scene:
        to_right_mm = aside.right_mm if scene.camera == "rear" else -aside.right_mm
        return scene.with_laser(replace(aside, right_mm=to_right_mm).spot(scene, 1.0))

    return Spoil(aside.words, light=light)
