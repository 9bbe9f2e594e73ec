"""The row: beam, places in the rock, glasses and cameras; it renders one camera frame at a time."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import cv2
import numpy as np

from altd.records import PixelArray
from hw_sim.beam import BeamPose
from hw_sim.image import Image
from hw_sim.lens import Lens, rotation
from hw_sim.row.glass import Glass, GlassConfig
from hw_sim.sensor import FULL_WELL_E, Sensor
from hw_sim.targets import speckle

WIDTH_PX, HEIGHT_PX = 320, 240
FPS = 20.0
PEAK_SHARE = 0.7
"""Peak signal as a share of the full well: each camera's exposure suits the light that reaches its target."""
AMBIENT_E = 250.0
SPECKLE_CONTRAST = 0.16
PSF_SIGMA_PX = 0.74
WAIST_MM = 5.0
"""1/e² radius of the beam at z = 0."""
RAYLEIGH_MM = math.pi * WAIST_MM**2 / 650e-6

Place = Callable[[float], tuple[float, float]]
"""Displacement (x, y) mm of a place in the rock at a time in seconds."""


def at_rest(_t_s: float) -> tuple[float, float]:
    """Displacement of a place that does not move."""
    return 0.0, 0.0


@dataclass(frozen=True, slots=True)
class RowConfig:
    """Targets ``t1``, ``t2``, … at the distances ``z_mm``; the seed draws cameras, speckle and glasses.

    ``places`` move targets by name, ``beam`` is the laser's pose at a time in seconds. ``stuck`` and ``slow``
    are faults of glasses, see ``GlassConfig``; ``lost_behind`` names the target behind which the beam is
    blocked, ``swapped`` two targets whose cameras' cables are exchanged. Glasses stick, the beam is lost
    and the laser has ``laser_share`` of its power from ``fault_s`` on.
    """

    seed: int = 1
    z_mm: tuple[float, ...] = (0.0, 15_000.0, 30_000.0, 45_000.0, 60_000.0)
    beam: Callable[[float], BeamPose] = field(default=lambda _t_s: BeamPose(0.0, 0.0))
    places: Mapping[str, Place] = field(default_factory=dict)
    stuck: Mapping[str, str] = field(default_factory=dict)
    slow: Mapping[str, float] = field(default_factory=dict)
    lost_behind: str = ""
    swapped: tuple[str, str] | None = None
    laser_share: float = 1.0
    fault_s: float = 0.0

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the targets in beam order."""
        return tuple(f"t{number}" for number in range(1, len(self.z_mm) + 1))

    @property
    def serial(self) -> str:
        """Serial number of the unit."""
        return f"SIM-CHAIN-{self.seed}"


@dataclass(frozen=True, slots=True, eq=False)
class _Camera:
    lens: Lens
    x_mm: Image
    y_mm: Image
    response: Image
    hot_e: Image


class Row:
    """A row as described by ``RowConfig``."""

    def __init__(self, config: RowConfig) -> None:
        self.config = config
        rng = np.random.default_rng([config.seed, 26])
        self._cameras = {name: _make_camera(rng) for name in config.names}
        self.glasses = {
            name: Glass(
                GlassConfig(
                    wedge_rad=tuple(rng.normal(0.0, 20e-6, 2).tolist()),
                    shift_mm=tuple(rng.normal(0.0, 0.2, 2).tolist()),
                    stuck=config.stuck.get(name, ""),
                    slow=config.slow.get(name, 1.0),
                    fault_s=config.fault_s,
                )
            )
            for name in config.names
        }
        self._noise = np.random.default_rng([config.seed, 27])
        self._sensor = Sensor(8)

    def switch(self, opaque: str, t_s: float) -> None:
        """Switch this glass opaque and all others clear; all clear if ``opaque`` is empty."""
        for name, glass in self.glasses.items():
            glass.switch(name == opaque, t_s)

    def spot_mm(self, name: str, t_s: float) -> tuple[float, float]:
        """Position of the beam on a target in the target's own frame, which moves with the rock."""
        config = self.config
        at_mm = config.z_mm[config.names.index(name)]
        x_mm, y_mm = config.beam(t_s).at(at_mm)
        for before, z_mm in zip(config.names, config.z_mm, strict=True):
            if z_mm >= at_mm:
                break
            glass = self.glasses[before].config
            x_mm += glass.shift_mm[0] + glass.wedge_rad[0] * (at_mm - z_mm)
            y_mm += glass.shift_mm[1] + glass.wedge_rad[1] * (at_mm - z_mm)
        dx_mm, dy_mm = config.places.get(name, at_rest)(t_s)
        return x_mm - dx_mm, y_mm - dy_mm

    def power(self, name: str, t_s: float) -> float:
        """Power that reaches a target, relative to the power through clear glasses."""
        share = self.config.laser_share if t_s >= self.config.fault_s else 1.0
        for before in self.config.names[: self.config.names.index(name)]:
            glass = self.glasses[before]
            share *= glass.transmission(t_s) / glass.config.transmission
            if before == self.config.lost_behind and t_s >= self.config.fault_s:
                return 0.0
        return share

    def expose(self, camera: str, t_s: float) -> PixelArray:
        """Frame of a target's camera."""
        name = camera
        if self.config.swapped and camera in self.config.swapped:
            name = next(other for other in self.config.swapped if other != camera)
        share = self.power(name, t_s) * self.glasses[name].brightness(t_s)
        return self.picture(name, self.spot_mm(name, t_s), share)

    def picture(self, name: str, spot_mm: tuple[float, float], share: float) -> PixelArray:
        """Frame with a spot at this position of the target, with ``share`` of the usual light."""
        camera = self._cameras[name]
        z_mm = self.config.z_mm[self.config.names.index(name)]
        radius_mm = WAIST_MM * math.hypot(1.0, z_mm / RAYLEIGH_MM)
        dx, dy = camera.x_mm - np.float32(spot_mm[0]), camera.y_mm - np.float32(spot_mm[1])
        light = np.exp(np.float32(-2.0 / radius_mm**2) * (dx * dx + dy * dy)) * camera.response
        electrons = light * np.float32(PEAK_SHARE * FULL_WELL_E * share) + np.float32(AMBIENT_E)
        electrons += camera.hot_e
        noise = self._noise.standard_normal(electrons.shape, dtype=np.float32)
        counts = self._sensor.mean_counts(electrons, 1.0) + self._sensor.noise_counts(electrons, 1.0) * noise
        pixels = self._sensor.quantise(counts)
        pixels.flags.writeable = False
        return pixels


def _make_camera(rng: np.random.Generator) -> _Camera:
    """Draw a camera that views about 90 × 68 mm from one side, with its target's texture and hot pixels."""
    yaw, pitch, roll = np.radians(rng.uniform((7.0, -3.0, -1.0), (12.0, 3.0, 1.0))).tolist()
    k1, k2 = rng.uniform((-0.25, 0.03), (-0.15, 0.08)).tolist()
    lens = Lens(
        focal_mm=4.0,
        principal_px=tuple((np.array([159.5, 119.5]) + rng.uniform(-3.0, 3.0, 2)).tolist()),
        distortion=(k1, k2, 0.0, 0.0, 0.0),
        rotation=rotation(yaw, pitch, roll),
        translation_mm=np.array([*rng.uniform(-0.5, 0.5, 2), rng.uniform(185.0, 200.0)]),
        mirrored=False,
    )
    columns, rows = np.meshgrid(np.arange(WIDTH_PX, dtype=float), np.arange(HEIGHT_PX, dtype=float))
    x_mm, y_mm = lens.unproject(columns, rows)
    texture = speckle(rng, (HEIGHT_PX, WIDTH_PX), SPECKLE_CONTRAST)
    falloff = lens.relative_illumination(x_mm, y_mm).astype(np.float32)
    hot_e = np.zeros((HEIGHT_PX, WIDTH_PX), np.float32)
    hot_e.ravel()[rng.choice(hot_e.size, 6, replace=False)] = rng.uniform(1500.0, 9000.0, 6)
    response = cv2.GaussianBlur(texture * falloff, (0, 0), PSF_SIGMA_PX).astype(np.float32)
    return _Camera(lens, x_mm.astype(np.float32), y_mm.astype(np.float32), response, hot_e)
