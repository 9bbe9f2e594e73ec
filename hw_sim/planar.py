"""``python -m hw_sim planar-recording``: a plate with seven LEDs that moves in its plane (Sec. 2.4)."""

import argparse
import csv
import json
import math
import os
import shutil
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path

import cv2
import numpy as np

from altd.errors import BadInputError
from altd.files.writing import check_replaceable, write_file
from altd.records import FloatArray, PixelArray
from hw_sim.arguments import at_least_one, natural, terminal_progress
from hw_sim.double_triangle import MachineFlaws, random_motion, source_machine
from hw_sim.image import Image
from hw_sim.lens import Lens, rotation
from hw_sim.plate import LED_DIAMETER_MM, MIN_BRIGHTNESS, add_disc
from hw_sim.recording import COLUMNS, STORED, Progress
from hw_sim.sensor import FULL_WELL_E, Sensor
from hw_sim.view import PSF_SIGMA_PX

WIDTH_PX, HEIGHT_PX = 1024, 768
"""Size of the picture of Sec. 2.4.4."""
LEDS_MM = (
    (-41.0, -40.0),
    (-7.0, -39.0),
    (31.0, -32.0),
    (44.0, 16.0),
    (11.0, 3.0),
    (-38.0, 23.0),
    (2.0, 39.0),
)
"""Positions of the LEDs, without rotational symmetry; the 21 distances differ by at least 1.4 mm."""
LED_PLACE_SIGMA_MM = 0.005
"""Standard deviation of the holes' positions from the drawing, per axis, as of a jig borer."""
KNOWN_SIGMA_MM, KNOWN_SIGMA_DEG = 0.005, 0.003
"""Standard deviations of the true poses from the stated ones, as of gauge blocks."""
MIDDLE_MM = (0.0, 700.0)
"""Pose in the middle of the workspace, as of the source's machine."""
HALF_RANGE = (45.0, 32.0, 40.0)
"""Half ranges of a, b (mm) and φ (°) about the middle."""
FOCAL_MM = (7.5, 9.0)
MAX_TILT_DEG = 15.0
K1 = (-0.12, -0.04)
"""Light barrel distortion: 2 to 6 px in the corners of the picture."""
LED_SHARE, AMBIENT_SHARE = 0.55, 0.03
"""Shares of the full well: a lit LED, and the matte plate in the room's light."""
FPS = 20.0
SHAKE_INSTANTS = 8
MAX_DRAWS = 10_000
MACHINE_FLAWS = MachineFlaws(place_mm=0.5, direction_deg=0.1, screw_ppm=200.0)

Pose = tuple[float, float, float]
"""Pose (a mm, b mm, φ °) of Eq. 2.59: position of the plate's origin in the fixed frame, and its turn."""


@dataclass(frozen=True, slots=True)
class Light:
    """A disc of light that is not an LED of the plate, in the fixed frame: a reflection or a lamp."""

    x_mm: float
    y_mm: float
    radius_mm: float = LED_DIAMETER_MM / 2.0
    brightness: float = 0.9


@dataclass(slots=True)
class PlanarScene:
    """A plate in front of a camera; ``seed`` selects lens, tilt, holes and brightness.

    ``size_px`` is the size of the picture, whose view is always the same. ``shake_px`` is one sigma, along
    each axis, of the picture's displacement in the middle of an exposure, and of its travel meanwhile.
    """

    seed: int
    leds_mm: FloatArray = field(default_factory=lambda: np.array(LEDS_MM))
    size_px: tuple[int, int] = (WIDTH_PX, HEIGHT_PX)
    shake_px: float = 0.0
    lens: Lens = field(init=False)
    _plane_mm: tuple[Image, Image] = field(init=False)
    _fall_off: Image = field(init=False)
    true_leds_mm: FloatArray = field(init=False)
    _brightness: FloatArray = field(init=False)
    _rng: np.random.Generator = field(init=False)

    def __post_init__(self) -> None:
        rng = np.random.default_rng([self.seed, 24])
        tilt, towards = math.radians(rng.uniform(3.0, MAX_TILT_DEG)), rng.uniform(0.0, 2.0 * math.pi)
        turned = rotation(
            tilt * math.cos(towards), tilt * math.sin(towards), math.radians(rng.uniform(-4, 4))
        )
        focal_mm = float(rng.uniform(*FOCAL_MM))
        middle = turned[:, :2] @ np.array([MIDDLE_MM[0], -MIDDLE_MM[1]])
        (width, height), finer = self.size_px, self.size_px[0] / WIDTH_PX
        k1, k2 = float(rng.uniform(*K1)), float(rng.uniform(-0.01, 0.01))
        p1, p2 = (float(p) for p in rng.uniform(-3e-4, 3e-4, size=2))
        self.lens = Lens(
            focal_mm * finer,  # as if the pixels were smaller
            (
                (width - 1) / 2.0 + finer * float(rng.uniform(-12, 12)),
                (height - 1) / 2.0 + finer * float(rng.uniform(-12, 12)),
            ),
            (k1, k2, p1, p2, 0.0),
            turned,
            np.array([0.0, 0.0, 58.0 * focal_mm]) - middle,
            mirrored=False,
        )
        u, v = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))
        x_mm, y_mm = self.lens.unproject(u, v)
        self._plane_mm = x_mm.astype(np.float32), y_mm.astype(np.float32)
        self._fall_off = self.lens.relative_illumination(x_mm, y_mm).astype(np.float32)
        self.true_leds_mm = self.leds_mm + rng.normal(0.0, LED_PLACE_SIGMA_MM, size=self.leds_mm.shape)
        self._brightness = rng.uniform(MIN_BRIGHTNESS, 1.0, size=len(self.leds_mm))
        self._rng = rng

    def poses(self, count: int) -> list[Pose]:
        """Draw poses with all LEDs well inside the picture; raises ValueError if there is none."""
        poses: list[Pose] = []
        for _ in range(MAX_DRAWS):
            if len(poses) == count:
                return poses
            a, b, phi = (float(x) for x in self._rng.uniform(-1.0, 1.0, size=3) * HALF_RANGE)
            pose = (MIDDLE_MM[0] + a, MIDDLE_MM[1] + b, phi)
            u, v = self.lens.project(*places_mm(self.leds_mm, pose).T)
            right, lower = self.size_px[0] - 1 - u.max(), self.size_px[1] - 1 - v.max()
            if min(u.min(), v.min(), right, lower) > 20.0 * self.size_px[0] / WIDTH_PX:
                poses.append(pose)
        raise ValueError("the picture does not hold the plate")

    def shuffled_leds(self) -> list[int]:
        """LEDs, counted from 0, in random order."""
        return [int(led) for led in self._rng.permutation(len(self.leds_mm))]

    def near(self, pose: Pose) -> Pose:
        """True pose of a plate that was set to ``pose``."""
        sigmas = (KNOWN_SIGMA_MM, KNOWN_SIGMA_MM, KNOWN_SIGMA_DEG)
        a, b, phi = (float(x) for x in np.array(pose) + self._rng.normal(0.0, sigmas))
        return a, b, phi

    def mean_electrons(self, pose: Pose, lit: Collection[int], lights: Sequence[Light] = ()) -> Image:
        """Mean electrons of each pixel without noise; ``lit`` are the lit LEDs, counted from 0."""
        covered = np.zeros_like(self._fall_off)
        radius_mm = LED_DIAMETER_MM / 2.0
        for led, (x_mm, y_mm) in enumerate(places_mm(self.true_leds_mm, pose).tolist()):
            if led in lit:
                brightness = float(self._brightness[led])
                add_disc(covered, self.lens, self._plane_mm, (x_mm, y_mm), radius_mm, brightness)
        for light in lights:
            at = light.x_mm, light.y_mm
            add_disc(covered, self.lens, self._plane_mm, at, light.radius_mm, light.brightness)
        blurred = cv2.GaussianBlur(covered, (0, 0), PSF_SIGMA_PX)
        slope = np.linspace(0.8, 1.2, self.size_px[0], dtype=np.float32)
        share = np.float32(LED_SHARE) * blurred + np.float32(AMBIENT_SHARE) * slope
        return np.asarray(share * self._fall_off * np.float32(FULL_WELL_E))

    def expose(self, mean_electrons: Image) -> PixelArray:
        """One frame of 8 bits with shot noise and read noise."""
        if self.shake_px:
            mean_electrons = self._shaken(mean_electrons)
        return Sensor().expose(mean_electrons, 1.0, self._rng)

    def _shaken(self, electrons: Image) -> Image:
        """The picture displaced and blurred by a straight path of a camera that shakes."""
        middle, travel = self._rng.normal(0.0, self.shake_px, size=(2, 2))
        total = np.zeros_like(electrons)
        for share in np.linspace(-0.5, 0.5, SHAKE_INSTANTS):
            u, v = middle + share * travel
            moved = np.array([[1.0, 0.0, u], [0.0, 1.0, v]])
            total += cv2.warpAffine(
                electrons, moved, self.size_px, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE
            )
        return total / np.float32(SHAKE_INSTANTS)


def places_mm(leds_mm: FloatArray, pose: Pose) -> FloatArray:
    """Coordinates (n, 2) of the plate's points in the fixed frame, Eq. 2.59."""
    a, b, phi_deg = pose
    cosine, sine = math.cos(math.radians(phi_deg)), math.sin(math.radians(phi_deg))
    return np.asarray(leds_mm @ np.array([[cosine, sine], [-sine, cosine]]) + (a, b))


@dataclass(frozen=True, slots=True)
class Stay:
    """A pose of the plate with its lit LEDs; ``stated`` and ``joints_mm`` are stated in the recording."""

    pose: Pose
    lit: tuple[int, ...]
    stated: Pose | None = None
    joints_mm: tuple[float, ...] = ()
    lights: tuple[Light, ...] = ()


def record(
    folder: Path, scene: PlanarScene, stays: Sequence[Stay], exposures: int, progress: Progress
) -> None:
    """Write ``exposures`` frames of each stay into a new ``folder``, or nothing; raises BadInputError."""
    folder = folder.resolve()
    if folder.exists() and not (folder.is_dir() and not any(folder.iterdir())):
        raise BadInputError(folder, "exists and is not an empty folder")
    draft = folder.with_name(f".{folder.name}.{os.getpid()}.draft")
    header = {
        "format": "altd-recording/1",
        "kind": "planar",
        "fps": FPS,
        "cameras": {
            "plate": {
                "width": scene.size_px[0],
                "height": scene.size_px[1],
                "bits": 8,
                "origin": "simulated",
            }
        },
        "unit": {"serial": f"SIM-PLANAR-{scene.seed}"},
        "note": f"hw_sim, seed {scene.seed}, planar",
        "plate": {"leds_mm": scene.leds_mm.tolist(), "disc_mm": LED_DIAMETER_MM},
    }
    try:
        (draft / "plate").mkdir(parents=True)
        with (draft / "frames.csv").open("w", newline="") as file:
            table = csv.writer(file, lineterminator="\n")
            of_machine = ("joint_1_mm", "joint_2_mm", "joint_3_mm") if any(s.joints_mm for s in stays) else ()
            table.writerow((*COLUMNS, "a_mm", "b_mm", "phi_deg", *of_machine))
            sequence = 0
            for stay in stays:
                mean = scene.mean_electrons(stay.pose, stay.lit, stay.lights)
                stated = ("", "", "") if stay.stated is None else tuple(f"{x:.4f}" for x in stay.stated)
                joints = tuple(f"{x:.4f}" for x in stay.joints_mm) or ("",) * len(of_machine)
                for _ in range(exposures):
                    name = f"plate/{sequence:06d}.png"
                    (draft / name).write_bytes(cv2.imencode(".png", scene.expose(mean), STORED)[1].tobytes())
                    row = sequence, f"{sequence / FPS:.6f}", "plate", name, "on", "", "", *stated, *joints
                    table.writerow(row)
                    sequence += 1
                    progress(sequence, len(stays) * exposures)
        (draft / "recording.json").write_text(json.dumps(header, indent=1) + "\n")
        draft.replace(folder)
    except OSError as error:
        raise BadInputError(folder, f"cannot be written: {error.strerror or error}") from error
    finally:
        shutil.rmtree(draft, ignore_errors=True)


def known_and_unknown(
    scene: PlanarScene, known: Sequence[Pose], unknown: Sequence[Pose], lit: int | None
) -> list[Stay]:
    """Stays at known poses with all LEDs, then at poses to be measured.

    ``lit`` LEDs shine at the latter; None: each pose is shown with 7, 6 … 2 of them, lost at random.
    """
    everything = tuple(range(len(scene.leds_mm)))
    stays = [Stay(scene.near(pose), everything, pose) for pose in known]
    for pose in unknown:
        order = scene.shuffled_leds()
        counts = range(len(everything), 1, -1) if lit is None else (lit,)
        stays += [Stay(pose, tuple(sorted(order[:count]))) for count in counts]
    return stays


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command-line arguments of the recording."""
    output = "new or empty folder for the recording"
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="DIR", help=output)
    parser.add_argument("--truth", type=Path, metavar="FILE", help="JSON file for the true poses")
    parser.add_argument("--seed", type=natural, default=1, help="selects camera and plate (default: 1)")
    parser.add_argument("--known", type=natural, default=12, help="poses that it states (default: 12)")
    parser.add_argument("--unknown", type=natural, default=0, help="poses to be measured (default: 0)")
    parser.add_argument("--lit", type=at_least_one, help="LEDs lit at those (default: lost from 7 to 2)")
    parser.add_argument("--exposures", type=at_least_one, default=4, help="frames per pose (default: 4)")
    machine = "let the 3-PRP machine move the plate to the unknown poses, with --lit 7; and state its joints"
    parser.add_argument("--machine", action="store_true", help=machine)


def run(arguments: argparse.Namespace) -> int:
    """Record the plate; raises BadInputError."""
    if arguments.known + arguments.unknown == 0:
        raise BadInputError("--known", "and --unknown are both 0: there is no pose to record")
    if arguments.truth is not None:
        check_replaceable(arguments.truth)
    scene = PlanarScene(arguments.seed)
    known, lit = scene.poses(arguments.known), arguments.lit
    if arguments.machine:
        unknown, joints = _driven(arguments.seed, arguments.unknown)
        lit = lit or len(scene.leds_mm)
    else:
        unknown, joints = scene.poses(arguments.unknown), []
    stays = known_and_unknown(scene, known, unknown, lit)
    for at, of_pose in enumerate(joints, start=len(known)):
        stays[at] = replace(stays[at], joints_mm=tuple(of_pose))
    record(arguments.output, scene, stays, arguments.exposures, terminal_progress("planar-recording"))
    if arguments.truth is not None:
        keys = ("a_mm", "b_mm", "phi_deg")
        poses = [dict(zip(keys, stay.pose, strict=True)) | {"lit": list(stay.lit)} for stay in stays]
        truth = {"window": arguments.exposures, "poses": poses, "joints_mm": joints}
        write_file(arguments.truth, (json.dumps(truth, indent=1) + "\n").encode())
    return 0


def _driven(seed: int, count: int) -> tuple[list[Pose], list[list[float]]]:
    """Poses of a machine with errors, driven to random joints, and these joints in mm."""
    machine = source_machine(MACHINE_FLAWS, seed)
    poses: list[Pose] = []
    joints: list[list[float]] = []
    for a_mm, b_mm, phi_deg in islice(random_motion(machine, HALF_RANGE), count):
        poses.append((float(a_mm), float(b_mm), float(phi_deg)))
        joints.append(machine.joints_mm.tolist())
    return poses, joints
