"""Clean exposures of one episode, with their truth, from a simulated unit or the recorded one."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from functools import cache, cached_property

import cv2
import numpy as np

from altd.recording.reader import Recording, open_recording
from altd.records import FloatArray, PixelArray
from benchmarks.campaign.scene import MeanImage, Noise, Scene, SpotShape, mean_image, noisy_image
from benchmarks.campaign.units import RECORDED, RECORDINGS, SIMULATED, UnitSpec, calibrated
from benchmarks.campaign.way import CAMERAS, PERIOD_NS
from hw_sim.beam import BeamPose
from hw_sim.image import Image
from hw_sim.measure import random_poses
from hw_sim.motion import Vibration, make_vibration
from hw_sim.sensor import BLACK_LEVEL, FULL_WELL_E, Sensor
from hw_sim.unit import Unit

_DRIVING_MM_PER_S, _DRIVING_RAD_PER_S = 5.0, 0.01
"""Maximum speeds of a fast machine: four times as fast as hw_sim's drive."""
_VIBRATION = Vibration(rms_mm=0.02, rms_mrad=0.05)
"""Vibration of every driving machine: a perfectly steady path would hide a late camera."""


def place_of(pose: BeamPose) -> FloatArray:
    """Values of a pose: x mm, y mm, yaw °, pitch °."""
    return np.array([pose.x_mm, pose.y_mm, pose.yaw_deg, pose.pitch_deg])


class SimulatedRig:
    """A simulated unit of ``hw_sim``."""

    def __init__(self, spec: UnitSpec) -> None:
        self.name = spec.name
        self.bits = spec.config.bits
        self.calibration = calibrated(spec.name)
        self.spec = spec
        self.unit = Unit(spec.measuring)
        self.noise = Noise(spec.config.seed)
        self.sensor = Sensor(self.bits)
        for camera in CAMERAS:
            self.unit.set_camera(camera, exposure_ms=spec.exposure_ms)
        self.rest = {camera: self._rest(camera, spec.lux) for camera in CAMERAS}

    def _rest(self, camera: str, lux: float) -> Image:
        return self.unit.imagers[camera].view.background_e(self.spec.exposure_ms, lux, False)

    def clip(self, rng: np.random.Generator, length: int, moving: bool) -> SimulatedClip:
        """Clip at any pose that meets both targets within the scanned area; ``moving``: along a path."""
        distance_mm = self.spec.config.target_distance_mm
        (pose,) = random_poses(1, distance_mm, rng)
        speed = np.zeros(4)
        if moving or self.spec.drives:
            speed[:2] = rng.uniform(-1, 1, 2) * _DRIVING_MM_PER_S
            speed[2:] = rng.uniform(-1, 1, 2) * _DRIVING_RAD_PER_S
        late_ns = int(rng.integers(1_000_000_000_000))
        return SimulatedClip(self, pose, speed, late_ns, length, rng)

    def driving_clip(self, rng: np.random.Generator, length: int) -> SimulatedClip:
        """Clip of a machine that drives across the middle of the targets."""
        x_mm, y_mm = rng.uniform(-15, 15, 2)
        speed = rng.uniform(-1, 1, 4) * (4.0, 4.0, 0.006, 0.006) * min(1.0, 100 / length)
        return SimulatedClip(self, BeamPose(float(x_mm), float(y_mm)), speed, 0, length, rng)

    def scene(self, camera: str, t_ns: int, since_s: float) -> Scene:
        """Light of a frame at ``t_ns`` of the unit's motion, ``since_s`` after the clip's start."""
        imager, exposure_ms = self.unit.imagers[camera], self.spec.exposure_ms
        rest = self.rest[camera]
        if self.spec.lux_of is not None:
            rest = self._rest(camera, self.spec.lux_of(since_s))
        (spot,) = spots = self.unit.spots(camera, t_ns)
        region, beam_e = imager.view.beam_e(spots, exposure_ms)
        beam = np.zeros_like(rest)
        beam[region] = beam_e
        u, v = (float(value) for value in imager.view.lens.project(spot.x_mm, spot.y_mm))
        ends = np.array(
            [imager.view.lens.project(spot.x_mm + dx, spot.y_mm + dy) for dx, dy in ((1, 0), (0, 1))]
        )
        to_px = (ends - (u, v)).T
        to_mm = np.linalg.inv(to_px)
        xx, xy, yy = spot.form
        form = to_mm.T @ np.array([[xx, xy], [xy, yy]]) @ to_mm
        shape = SpotShape(u, v, _form(form), spot.order, spot.peak_mw_per_mm2 * exposure_ms)
        px_per_mm = math.sqrt(abs(float(np.linalg.det(to_px))))
        return Scene(camera, beam, rest, imager.view.response, shape, px_per_mm)


class SimulatedClip:
    """An episode of a simulated unit: at rest, or on a straight path with vibration."""

    def __init__(
        self,
        rig: SimulatedRig,
        pose: BeamPose,
        speed: FloatArray,
        late_ns: int,
        length: int,
        rng: np.random.Generator,
    ) -> None:
        self._rig = rig
        self._pose = pose
        self._speed = speed
        self._late_ns = late_ns
        self.length = length
        vibrates = bool(speed.any()) and rig.spec.vibration is None
        self._vibration = make_vibration(_VIBRATION, rng) if vibrates else None
        self.still = not speed.any() and rig.spec.vibration is None and rig.spec.lux_of is None
        self._kept: dict[str, Scene] = {}
        self._means: dict[str, tuple[Scene, MeanImage]] = {}
        rig.unit.follow(self._at)

    def _at(self, t_ns: int) -> BeamPose:
        middle_s = (t_ns - self._late_ns - self.length * PERIOD_NS / 2) * 1e-9
        x, y, slope_x, slope_y = self._speed * middle_s
        pose = self._pose
        moved = BeamPose(pose.x_mm + x, pose.y_mm + y, pose.slope_x + slope_x, pose.slope_y + slope_y)
        return moved if self._vibration is None else self._vibration.moved(moved, t_ns)

    def scene(self, camera: str, k: int) -> Scene:
        """Light of a camera's frame."""
        if self.still and camera in self._kept:
            return self._kept[camera]
        self._rig.unit.follow(self._at)
        scene = self._rig.scene(camera, self._late_ns + k * PERIOD_NS, k * PERIOD_NS * 1e-9)
        self._kept[camera] = scene
        return scene

    def snap(self, scene: Scene, k: int, rng: np.random.Generator) -> PixelArray:
        """Frame with independent noise."""
        kept = self._means.get(scene.camera)
        if kept is None or kept[0] is not scene:
            kept = self._means[scene.camera] = scene, mean_image(scene.electrons, self._rig.sensor)
        noise = self._rig.noise.picture(scene.beam.shape, rng)
        return noisy_image(kept[1], noise, self._rig.bits)

    def truth(self, k: int) -> FloatArray:
        """Truth from the unit's formulas, vibration included."""
        self._rig.unit.follow(self._at)
        return place_of(self._rig.unit.truth(self._late_ns + k * PERIOD_NS))


class RecordedRig:
    """Recorded unit unit-a: its recorded poses, four exposures each."""

    def __init__(self) -> None:
        self.name = RECORDED
        self.bits = 8
        self.calibration = calibrated(RECORDED)
        self.recording: Recording = open_recording(RECORDINGS / "poses")
        truth = json.loads((RECORDINGS / "poses.truth.json").read_text())
        self.window = int(truth["window"])
        self.poses = [
            BeamPose(*(pose[key] for key in ("x_mm", "y_mm", "slope_x", "slope_y")))
            for pose in truth["poses"]
        ]
        self.noise = Noise(0)
        self._frames = {
            (row.camera, row.sequence): self.recording.frame(row).pixels for row in self.recording.rows
        }

    def frame(self, camera: str, pose: int, k: int) -> PixelArray:
        """Pixels of frame set ``k`` of a pose."""
        return self._frames[camera, pose * self.window + k]

    def clip(self, rng: np.random.Generator, length: int, moving: bool) -> RecordedClip:
        """Clip of one of the recorded poses: it has four exposures and does not move."""
        return RecordedClip(self, int(rng.integers(len(self.poses))))

    @cached_property
    def responses(self) -> dict[str, Image]:
        """Response of the pixels, mean 1: the calibration's flat, or even without a flat."""
        shape = self.frame("front", 0, 0).shape
        return {
            target.name: np.ones(shape, np.float32) if target.flat is None else target.flat.response
            for target in self.calibration.targets
        }


class RecordedClip:
    """Exposures of one pose of unit-a; only added light gets added noise, the frames contain their own."""

    still = False

    def __init__(self, rig: RecordedRig, pose: int) -> None:
        self._rig = rig
        self._pose = pose
        self.length = rig.window
        self._sensor = Sensor(rig.bits)
        self._kept: dict[tuple[str, int], Scene] = {}
        self._electrons: dict[tuple[str, int], Image] = {}
        """Recorded electrons, including their noise."""

    def scene(self, camera: str, k: int) -> Scene:
        """Content of the frame, in electrons of a full well of 15 000."""
        if (camera, k) not in self._kept:
            black = np.float32(BLACK_LEVEL * self._sensor.full_scale)
            electrons = self._rig.frame(camera, self._pose, k).astype(np.float32) - black
            electrons /= np.float32(self._sensor.counts_per_electron(1.0))
            self._electrons[camera, k] = electrons
            self._kept[camera, k] = self._scene_of(camera, electrons)
        return self._kept[camera, k]

    def _scene_of(self, camera: str, electrons: Image) -> Scene:
        response = self._rig.responses[camera]
        shape, near = _spot_of(electrons)
        here = float(response[near].mean())
        level = np.float32(np.median(electrons))
        beam = np.where(near, electrons - level, np.float32(0))
        point = next(t for t in self._rig.calibration.targets if t.name == camera).point(
            shape.u_px, shape.v_px
        )
        assert point is not None  # noqa: S101  all poses are within the scan
        px_per_mm = abs(float(np.linalg.det(point.jacobian_mm_per_px))) ** -0.5
        spot = replace(shape, peak=shape.peak / here)
        return Scene(camera, beam, electrons - beam, response, spot, px_per_mm)

    def snap(self, scene: Scene, k: int, rng: np.random.Generator) -> PixelArray:
        """The recorded frame, with the changes of the way."""
        if scene is self._kept[scene.camera, k]:
            return self._rig.frame(scene.camera, self._pose, k)
        mean = scene.electrons
        added = np.maximum(np.minimum(mean, FULL_WELL_E) - self._electrons[scene.camera, k], 0.0)
        slope = self._sensor.counts_per_electron(1.0)
        spoilt = MeanImage(self._sensor.mean_counts(mean, 1.0), np.float32(slope) * np.sqrt(added))
        return noisy_image(spoilt, self._rig.noise.picture(mean.shape, rng), self._rig.bits)

    def truth(self, k: int) -> FloatArray:
        """Truth stated in the recording."""
        return place_of(self._rig.poses[self._pose])


Clip = SimulatedClip | RecordedClip
"""Exposures of one episode, counted from 0. ``still``: all show the same light."""
Rig = SimulatedRig | RecordedRig
"""A calibrated unit that makes clips."""


@cache
def rig_of(name: str) -> Rig:
    """Unit of this name, with its calibration."""
    return RecordedRig() if name == RECORDED else SimulatedRig(SIMULATED[name])


def _form(matrix: np.ndarray) -> tuple[float, float, float]:
    return float(matrix[0, 0]), float(matrix[0, 1]), float(matrix[1, 1])


def _spot_of(electrons: Image) -> tuple[SpotShape, np.ndarray]:
    """Gaussian with a spot's moments above a tenth of its peak, and the pixels around it."""
    smooth = cv2.GaussianBlur(electrons - np.median(electrons), (0, 0), 4.0)
    _, peak, _, (u_peak, v_peak) = cv2.minMaxLoc(smooth)
    _, labels = cv2.connectedComponents((smooth > 0.1 * peak).astype(np.uint8))
    weights = np.where(labels == labels[v_peak, u_peak], smooth, np.float32(0))
    m = cv2.moments(weights)
    u, v = m["m10"] / m["m00"], m["m01"] / m["m00"]
    cut = 1.0 - 0.1 * math.log(10.0) / 0.9  # share of a Gaussian's variance above a tenth
    moments = np.array([[m["mu20"], m["mu11"]], [m["mu11"], m["mu02"]]]) / m["m00"] / cut
    blur = np.eye(2) * 16.0
    form = np.linalg.inv(4.0 * (moments - blur))
    lowered = math.sqrt(np.linalg.det(moments) / np.linalg.det(moments - blur))
    shape = SpotShape(u, v, _form(form), 1.0, peak * lowered)
    rows, columns = shape.window(electrons.shape)
    near = np.zeros(electrons.shape, bool)
    near[rows, columns] = True
    return shape, near
