"""The simulated unit: one seed makes one unit, with its truth, its faults and its two cameras."""

import math
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from altd.records import Frame, PixelArray
from hw_sim.assembly import FIELD_HALF_MM, FRONT_FOCAL_MM, REAR_FOCAL_MM, make_dots, make_lens
from hw_sim.beam import BeamPose, Footprint, Laser, footprint, glass_shift_mm
from hw_sim.displacement import Displacement
from hw_sim.dust import SHADOW_SIGMA_MM, Dust, Shadow, make_dust
from hw_sim.faults import (
    ALL_PIXELS,
    BLINKING_LIGHT,
    CAMERA_MOVED,
    DROPPED_SHARE,
    OUT_OF_AREA_MM,
    OVERLOAD_RATIO,
    PUSHED_ASIDE_MM,
    SECOND_SPOT_MM,
    Fault,
)
from hw_sim.frame_leds import ALL_LIT, Stray
from hw_sim.hardness import Hardness
from hw_sim.imager import Imager, Settings
from hw_sim.lens import HEIGHT_PX, WIDTH_PX
from hw_sim.milky import MilkyGlass
from hw_sim.motion import Drive, Vibration, make_path, make_vibration
from hw_sim.row.glass import Glass, GlassConfig
from hw_sim.sensor import NoisePool, Sensor
from hw_sim.targets import WINDOW_TRANSMISSION, DotPattern
from hw_sim.view import PLATE_REFLECTANCE, make_view

FRONT, REAR = "front", "rear"
CAMERAS = (FRONT, REAR)

EXPOSURES_MS: Mapping[str, float] = {FRONT: 1.6, REAR: 1.6}
"""Exposure times that bring 3 mW in a spot of 12 × 11 mm to about three quarters of full scale."""

INK_SPECKLE_RATIO = 0.6
"""Speckle of the window's ink relative to the plate's: light that diffuses through ink loses contrast. With
it a scan's node scatters about the map as on the recorded unit (../shared/data/unit-a): 0.04 px."""

_MISSING = {FRONT: Fault.FRONT_SPOT_MISSING, REAR: Fault.REAR_SPOT_MISSING}
_SECOND = {FRONT: Fault.FRONT_SECOND_SPOT, REAR: Fault.REAR_SECOND_SPOT}
_SILENT = {FRONT: Fault.FRONT_SILENT, REAR: Fault.REAR_SILENT}


@dataclass(frozen=True, slots=True)
class UnitConfig:
    """A unit and its surroundings. The seed alone decides lenses, tilts, print, speckle and hot pixels.

    ``lux`` is ambient light after the interference filter, 0 to 1000 (App. A.1); ``bits`` 8 to 16. Without
    ``dots`` the front target is a plain plate like the rear one. The focal lengths are drawn from the ranges
    given, and the cameras are where their pictures hold ``field_half_mm`` to each side of the middle.
    ``expansion`` is by how much of its length the frame between the targets has grown since it was adjusted:
    the rear target is at (1 + expansion) times its distance. ``dust`` is what has settled on window and
    plate, 0 none to 1 heavy; ``Unit.set_dust`` changes it after the calibration. ``glass_mm`` is the
    thickness of the window's glass behind its print (z = 0), ``glass_index`` its refractive index; the
    camera's view through it belongs to its lens. ``hard`` turns on the effects of ``Hardness``. ``switched``:
    the front target is an electro-active glass without print, ``Unit.glass``, and opaque at first. ``milky``:
    the window is of milky glass without print; its view is that of a plain plate.
    """

    seed: int = 1
    laser: Laser = field(default_factory=Laser)
    lux: float = 200.0
    speckle_contrast: float = 0.16
    hot_pixels: int = 20
    bits: int = 8
    fps: float = 20.0
    target_distance_mm: float = 280.0
    glass_mm: float = 0.0
    glass_index: float = 1.52
    expansion: float = 0.0
    dust: float = 0.0
    dots: DotPattern | None = field(default_factory=DotPattern)
    front_focal_mm: tuple[float, float] = FRONT_FOCAL_MM
    rear_focal_mm: tuple[float, float] = REAR_FOCAL_MM
    field_half_mm: tuple[float, float] = FIELD_HALF_MM
    vibration: Vibration | None = None
    drive: Drive | None = None
    faults: frozenset[Fault] = frozenset()
    hard: Hardness | None = None
    switched: GlassConfig | None = None
    milky: MilkyGlass | None = None

    @property
    def serial(self) -> str:
        """Serial number of the unit."""
        return f"SIM-{self.seed}"

    @property
    def period_ns(self) -> int:
        """Time from one frame set to the next."""
        return round(1e9 / self.fps)


class Unit:
    """Two targets, two cameras, one beam. Any method may be called from any thread."""

    def __init__(self, config: UnitConfig | None = None) -> None:
        self.config = config or UnitConfig()
        self._lit: frozenset[str] = frozenset()
        self._pattern = self.config.dots or DotPattern()
        self.even_mw_per_mm2 = 0.0
        """Even light on both targets, for a flat field; in recordings only."""
        self._pose_at: Callable[[int], BeamPose] = _constant_path(BeamPose(0.0, 0.0))
        self._faults: frozenset[Fault] = frozenset()
        self._lock = threading.RLock()
        streams = iter(np.random.SeedSequence(self.config.seed).spawn(8))
        rngs = (np.random.default_rng(stream) for stream in streams)
        hard = self.config.hard or Hardness()
        self._instants = hard.instants
        self.glass = None if self.config.switched is None else Glass(self.config.switched)
        if self.glass is not None:
            self.glass.switch(True, 0.0)
        dots = make_dots(self._pattern, next(rngs), hard.jitter_mm, hard.bleed_mm)
        lenses = {
            FRONT: make_lens(self.config.front_focal_mm, True, next(rngs), self.config.field_half_mm),
            REAR: make_lens(self.config.rear_focal_mm, False, next(rngs), self.config.field_half_mm),
        }
        self._views = {
            name: partial(
                make_view,
                lens,
                dots if name == FRONT and self._has_print else None,
                self.config.speckle_contrast * (INK_SPECKLE_RATIO if name == FRONT else 1.0),
                self.config.hot_pixels,
                hard=self.config.hard,
            )
            for name, lens in lenses.items()
        }
        self._view_streams = dict(zip(CAMERAS, streams, strict=False))
        self.imagers: Mapping[str, Imager] = {
            name: Imager(
                view(np.random.default_rng(self._view_streams[name])),
                Sensor(self.config.bits),
                Settings(EXPOSURES_MS[name]),
                self.config.lux,
            )
            for name, view in self._views.items()
        }
        self._pool = NoisePool(next(rngs))
        self._motion_rng = next(rngs)
        drive = self.config.drive
        self._drive = make_path(drive, self._motion_rng) if drive else None
        self.vibrate(self.config.vibration)
        self._dust_seeds = next(streams).spawn(len(CAMERAS))
        self._window_dust: Dust | None = None
        if self.config.dust:
            self.set_dust(self.config.dust)
        self.inject(*self.config.faults)

    @property
    def _has_print(self) -> bool:
        config = self.config
        return config.dots is not None and config.switched is None and config.milky is None

    @property
    def faults(self) -> frozenset[Fault]:
        """Faults that are currently present."""
        return self._faults

    @property
    def leds_on(self) -> bool:
        """Whether the LEDs around any target are lit; setting it switches the LEDs of all targets."""
        return bool(self._lit)

    @leds_on.setter
    def leds_on(self, on: bool) -> None:
        self._lit = frozenset(CAMERAS if on else ())

    @property
    def serial(self) -> str:
        """Serial number of the unit."""
        return self.config.serial

    def switch_leds(self, camera: str, on: bool) -> None:
        """Switch the LEDs around one camera's target on or off, from its next frame on."""
        if on != (camera in self._lit):
            with self._lock:
                self._lit = self._lit | {camera} if on else self._lit - {camera}

    def inject(self, *faults: Fault) -> None:
        """Add these faults from the next frame set on."""
        with self._lock:
            self._have(self._faults | set(faults))

    def clear(self, *faults: Fault) -> None:
        """Remove these faults; without an argument, all."""
        with self._lock:
            self._have(self._faults - set(faults) if faults else frozenset())

    def _have(self, faults: frozenset[Fault]) -> None:
        """Replace the faults; lights or view are reset if one of their faults changes."""
        changed = faults ^ self._faults
        if (blinks := Fault.FRONT_BLINKING_LIGHT) in changed:
            self.set_lights(FRONT, strays=(BLINKING_LIGHT,) if blinks in faults else ())
        if (moved := Fault.REAR_CAMERA_MOVED) in changed:
            self.displace(REAR, CAMERA_MOVED if moved in faults else Displacement())
        self._faults = faults

    def place(self, pose: BeamPose) -> None:
        """Point the reference laser; drive and vibration are added to it."""
        self._pose_at = _constant_path(pose)

    def vibrate(self, vibration: Vibration | None) -> None:
        """Replace the vibration by another one, with new phases; None: by none."""
        self._vibration = make_vibration(vibration, self._motion_rng) if vibration else None

    def follow(self, path: Callable[[int], BeamPose]) -> None:
        """Let the reference laser follow a path, given as its pose at ``t_ns``."""
        self._pose_at = path

    def set_camera(
        self,
        camera: str,
        *,
        exposure_ms: float | None = None,
        gain: float | None = None,
        bits: int | None = None,
    ) -> None:
        """Set exposure time, gain or bits per pixel of one camera, from its next frame on."""
        imager = self.imagers[camera]
        if exposure_ms is not None:
            imager.settings = replace(imager.settings, exposure_ms=exposure_ms)
        if gain is not None:
            imager.settings = replace(imager.settings, gain=gain)
        if bits is not None:
            imager.sensor = Sensor(bits)

    def set_dust(self, amount: float) -> None:
        """Set dust of 0 (none) to 1 (heavy) on window and plate, from the next frame set on.

        The positions of the specks belong to the unit; a larger amount adds to a smaller one. Raises
        ValueError.
        """
        dust = {
            camera: make_dust(amount, np.random.default_rng(seed))
            for camera, seed in zip(CAMERAS, self._dust_seeds, strict=True)
        }
        with self._lock:
            for camera, imager in self.imagers.items():
                imager.set_dust(dust[camera] if amount else None)
            self._window_dust = dust[FRONT].blurred(SHADOW_SIGMA_MM) if amount else None

    def displace(self, camera: str, displacement: Displacement) -> None:
        """Displace a camera from the next exposure on, relative to its original position."""
        view = self._views[camera](np.random.default_rng(self._view_streams[camera]), displacement)
        with self._lock:
            self.imagers[camera].set_view(view)

    def set_lights(
        self, camera: str, levels: tuple[float, ...] = ALL_LIT, strays: tuple[Stray, ...] = ()
    ) -> None:
        """Set the brightness of lit LEDs around a camera's target, and replace its stray lights.

        ``levels`` has a number for each LED: 1 as usual, 0 dark. Raises ValueError for another length.
        """
        with self._lock:
            self.imagers[camera].set_lights(levels, strays)

    def truth(self, t_ns: int, *, vibration: bool = True) -> BeamPose:
        """Pose of the beam at ``t_ns``, even while it is switched off."""
        pose = self._nominal_pose(t_ns)
        if self._drive is not None:
            pose = self._drive.moved(pose, t_ns)
        if vibration and self._vibration is not None:
            pose = self._vibration.moved(pose, t_ns)
        return pose

    def spots(self, camera: str, t_ns: int) -> list[Footprint]:
        """Light of the beam on a camera's target at ``t_ns``."""
        return self._spots(camera, self.truth(t_ns), self._faults, t_ns)

    def exposed_spots(self, camera: str, t_ns: int) -> list[Footprint]:
        """Light on a camera's target over an exposure with its middle at ``t_ns``.

        If the beam moves meanwhile, there is a spot for each of ``Hardness.instants``.
        """
        instants = self._instants
        step_ns = self.imagers[camera].settings.exposure_ms * 1e6 / instants
        poses = [self.truth(round(t_ns + step_ns * (k + 0.5 - 0.5 * instants))) for k in range(instants)]
        if len(set(poses)) == 1:
            return self._spots(camera, poses[0], self._faults, t_ns)
        spots = [spot for pose in poses for spot in self._spots(camera, pose, self._faults, t_ns)]
        return [replace(spot, peak_mw_per_mm2=spot.peak_mw_per_mm2 / instants) for spot in spots]

    def is_silent(self, camera: str) -> bool:
        """Whether a camera delivers nothing at all."""
        return _SILENT[camera] in self._faults

    def drops(self, camera: str, sequence: int) -> bool:
        """Whether this frame is lost on its way to the host."""
        return (
            Fault.DROPPED_FRAMES in self._faults and self._rng(camera, sequence, 1).random() < DROPPED_SHARE
        )

    def lag_ns(self, camera: str) -> int:
        """Delay of a camera's exposure relative to the schedule."""
        out_of_step = camera == REAR and Fault.OUT_OF_STEP in self._faults
        return self.config.period_ns // 2 if out_of_step else 0

    def expose(self, camera: str, sequence: int, t_ns: int, *, exact: bool = False) -> Frame:
        """The frame of one camera whose exposure's middle is ``t_ns``.

        ``exact`` draws every photon (a recording, 20 times slower); otherwise noise comes from a pool.
        The same unit, beam, sequence and time give the same frame, bit for bit.
        """
        faults, leds_on, imager = self._faults, camera in self._lit, self.imagers[camera]
        settings = imager.settings
        if faults & ALL_PIXELS:
            pixels = self._faulty_pixels(faults, camera, sequence)
        else:
            spots = self.exposed_spots(camera, t_ns)
            lit = (leds_on and Fault.LEDS_DARK not in faults) or Fault.LEDS_ON in faults
            if imager.blinks:
                imager.blink_on = bool(self._rng(camera, sequence, 3).random() < 0.5)
            if exact:
                pixels = imager.expose(spots, lit, self._rng(camera, sequence, 0), self.even_mw_per_mm2)
            else:
                key = sequence * len(CAMERAS) + CAMERAS.index(camera)
                pixels = imager.expose_from_pool(spots, lit, self._pool.stretch(key, (HEIGHT_PX, WIDTH_PX)))
        pixels.flags.writeable = False
        return Frame(
            camera,
            sequence,
            t_ns,
            pixels,
            imager.sensor.bits,
            leds_on,
            exposure_ms=settings.exposure_ms,
            gain_db=20.0 * math.log10(settings.gain),
        )

    def _nominal_pose(self, t_ns: int) -> BeamPose:
        """Beam of the laser, unless a fault moves it."""
        if Fault.CUT_BY_EDGE in self._faults:
            x_mm, y_mm = self.imagers[FRONT].view.lens.unproject(WIDTH_PX / 2.0, -0.5)
            return BeamPose(float(x_mm), float(y_mm))
        if Fault.OUT_OF_AREA in self._faults:
            return BeamPose(*OUT_OF_AREA_MM)
        pose = self._pose_at(t_ns)
        if Fault.PUSHED_ASIDE in self._faults:
            return replace(pose, x_mm=pose.x_mm + PUSHED_ASIDE_MM)
        return pose

    def _spots(self, camera: str, pose: BeamPose, faults: frozenset[Fault], t_ns: int) -> list[Footprint]:
        """Spots on one target; a switched glass is in its state at ``t_ns``."""
        if faults & {Fault.NO_LASER, _MISSING[camera]}:
            return []
        share = OVERLOAD_RATIO if Fault.SATURATED in faults else 1.0
        z_mm, aside_mm, glass, milky = 0.0, (0.0, 0.0), self.glass, self.config.milky
        if glass is not None and camera == FRONT:
            share *= glass.brightness(t_ns * 1e-9)
        if camera == REAR:
            window = WINDOW_TRANSMISSION * (1.0 if milky else 1.0 - self._pattern.coverage)
            share *= window if glass is None else glass.transmission(t_ns * 1e-9)
            z_mm = self.config.target_distance_mm * (1.0 + self.config.expansion)
            aside_mm = glass_shift_mm(pose, self.config.glass_mm, self.config.glass_index)
        laser, hard = self.config.laser, self.config.hard
        if hard is not None and hard.beam is not None:
            laser = replace(laser, flaws=hard.beam)
        spot = footprint(laser, pose, z_mm, share)
        if aside_mm != (0.0, 0.0):
            spot = replace(spot, x_mm=spot.x_mm + aside_mm[0], y_mm=spot.y_mm + aside_mm[1])
        if milky is not None and camera == FRONT:
            spot = replace(spot, peak_mw_per_mm2=WINDOW_TRANSMISSION * spot.peak_mw_per_mm2)
            return milky.front(spot, PLATE_REFLECTANCE, self.imagers[FRONT].view.lens)
        if milky is not None:
            return milky.rear(spot, pose, z_mm)
        if camera == REAR and self._window_dust is not None:
            shift_mm = (pose.slope_x * z_mm + aside_mm[0], pose.slope_y * z_mm + aside_mm[1])
            spot = replace(spot, shadow=Shadow(self._window_dust, shift_mm))
        if _SECOND[camera] not in faults:
            return [spot]
        aside = -SECOND_SPOT_MM if spot.x_mm > 0.0 else SECOND_SPOT_MM
        return [spot, replace(spot, x_mm=spot.x_mm + aside)]

    def _faulty_pixels(self, faults: frozenset[Fault], camera: str, sequence: int) -> PixelArray:
        sensor = self.imagers[camera].sensor
        counts = np.zeros((HEIGHT_PX, WIDTH_PX), dtype=np.float32)
        if Fault.WHITE in faults:
            counts += sensor.full_scale
        elif Fault.NOISE_ONLY in faults:
            noise = self._rng(camera, sequence, 2).standard_normal(counts.shape, dtype=np.float32)
            counts += sensor.full_scale * (np.float32(0.25) + np.float32(0.0625) * noise)
        return sensor.quantise(counts)

    def _rng(self, camera: str, sequence: int, purpose: int) -> np.random.Generator:
        """Random numbers that are specific to one frame of one unit."""
        return np.random.default_rng([self.config.seed, CAMERAS.index(camera), sequence, purpose])


def _constant_path(pose: BeamPose) -> Callable[[int], BeamPose]:
    """Path of a beam that does not move."""

    def path(_t_ns: int) -> BeamPose:
        return pose

    return path
