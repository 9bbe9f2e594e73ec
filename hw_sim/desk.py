"""``python -m hw_sim desk``: a unit of two webcams and tracing paper, its screen plates and beams with truth.

The front camera looks at the back of the first paper from beside the beam, the rear one at the front of the
second paper. Either picture holds about 120 × 90 mm.
"""

import argparse
import csv
import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import cv2
import numpy as np

from altd.errors import BadInputError
from altd.files.writing import write_file
from altd.records import PixelArray
from hw_sim.arguments import at_least_one, natural
from hw_sim.beam import BeamPose, Laser, footprint
from hw_sim.image import Image
from hw_sim.laser_speckle import GRAIN_SIGMA_PX, SHIFTS, LaserSpeckle
from hw_sim.lens import PIXEL_MM, Lens, rotation
from hw_sim.measure import random_poses
from hw_sim.recording import COLUMNS, STORED
from hw_sim.sensor import NoisePool
from hw_sim.unit import CAMERAS, FRONT, REAR
from hw_sim.webcam import Webcam

DISTANCE_MM = 280.0
FIELD_MM = 100.0
"""Height of a picture at the middle of its target."""
HALF_AREA_MM = (52.0, 37.0)
"""Half of the area in which both spots of a beam lie."""
MAX_SLOPES = (0.11, 0.15)

LASER = Laser(diameters_mm=(6.0, 5.0), angle_rad=0.3)
"""A laser pointer a metre or two away."""
PEAK = 0.7
"""Light in the middle of a spot, in parts of the full scale; the exposure is set for it."""
ROOM = 0.012
"""Light of the room on the paper, in parts of the full scale."""
BLUR_PX = 0.8
WAVELENGTH_MM, PUPIL_MM = 650e-6, 1.3
"""Pupil of F/2.2 at the 2.9 mm that pixels of 3 µm need."""
LENS_MM = 200.0
"""From the lens to its paper."""
SPECKLE_MM, SPECKLE_RAD = 0.5, PUPIL_MM / LENS_MM

SCREEN_LEVEL = 0.6
SCREEN_SUBSAMPLES = 6
APERTURE = (0.85, 0.75)
"""Share of a screen's pixel that shines, across and up."""

REST_S = 0.3
"""Time between two beams."""
STREAM = 31
"""Separate random stream, apart from those of other simulated units."""

FIBRE_MM, CLOUD_MM = 0.1, 1.0
"""Sigma of the Gaussian autocorrelation of a paper's fibres and of its formation."""


@dataclass(frozen=True, slots=True)
class Paper:
    """Contrast of the light that a paper scatters, and of its speckle, 1 as calculated.

    A sheet's mass varies by 5 % over 1 mm, and by twice as much over its fibres. Where the share T of the
    light passes, that light varies by 1 − T of it: 0.4 in tracing paper, 0.8 in writing paper.
    """

    fibres: float = 0.05
    clouds: float = 0.02
    speckle: float = 1.0


TRACING_PAPER = Paper()

Path_ = Callable[[float], BeamPose]
"""Pose of the beam at a time in s."""


@dataclass(frozen=True, slots=True)
class Screen:
    """Bright discs on a black screen that is held where a target is, centred on it.

    ``pitch_mm`` is what the user states; the true one is ``1 + scale_error`` times that. ``aside_mm`` moves
    the screen along x and y, ``turns_deg`` turns it about the target's y, x and z axes. ``stated`` has more
    keys of the plate's header, such as how well the pitch is known.
    """

    columns: int = 9
    rows: int = 7
    pitch_mm: float = 12.0
    disc_mm: float = 5.0
    pixel_mm: float = 0.2
    scale_error: float = 0.0
    aside_mm: tuple[float, float] = (0.0, 0.0)
    turns_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    stated: Mapping[str, object] = field(default_factory=dict)

    @property
    def header(self) -> dict[str, object]:
        """The plate in a recording's header, as ``altd record --plate`` writes it."""
        origin = [-(count - 1) / 2 * self.pitch_mm for count in (self.columns, self.rows)]
        grid = {"columns": self.columns, "rows": self.rows, "pitch_mm": self.pitch_mm, "origin_mm": origin}
        return grid | dict(self.stated)

    def shines(self, x_mm: Image, y_mm: Image) -> Image:
        """Whether points of the screen shine, 0 or 1: pixels whose middle lies in a disc."""
        scale = np.float32(1.0 + self.scale_error)
        shining: Image = np.ones_like(x_mm)
        square_mm2 = np.zeros_like(x_mm)
        counts = self.columns, self.rows
        for at_mm, aside_mm, count, share in zip((x_mm, y_mm), self.aside_mm, counts, APERTURE, strict=True):
            at = (at_mm - np.float32(aside_mm)) / np.float32(self.pixel_mm)
            pixel = np.floor(at)
            shining *= np.abs(at - pixel - np.float32(0.5)) < share / 2
            middle_mm = (pixel + np.float32(0.5)) * np.float32(self.pixel_mm) / scale
            from_first = middle_mm / np.float32(self.pitch_mm) + np.float32((count - 1) / 2)
            nearest = np.clip(np.rint(from_first), 0, count - 1)
            square_mm2 += np.square((from_first - nearest) * np.float32(self.pitch_mm))
        return np.asarray(shining * (square_mm2 < (self.disc_mm / 2) ** 2), dtype=np.float32)


class DeskCamera:
    """A webcam fixed in front of its paper."""

    def __init__(self, name: str, unit: "Desk") -> None:
        rng = np.random.default_rng([unit.seed, STREAM, CAMERAS.index(name)])
        webcam, paper = unit.webcam, unit.paper
        self.name, self.webcam, self.blur_px = name, webcam, unit.blur_px
        self.z_mm = 0.0 if name == FRONT else DISTANCE_MM + unit.distance_error_mm
        self.lens = _lens(name == FRONT, webcam, rng)
        self._x_mm, self._y_mm = self._seen(self.lens)
        x_mm, y_mm = self._x_mm, self._y_mm
        self._falloff = self.lens.relative_illumination(x_mm, y_mm).astype(np.float32)
        shape = x_mm.shape
        pixel_mm = FIELD_MM / webcam.height_px
        sheet: Image = np.ones(shape, dtype=np.float32)
        for contrast, size_mm in ((paper.fibres, FIBRE_MM), (paper.clouds, CLOUD_MM)):
            sheet += np.float32(contrast) * _grain(rng, shape, size_mm / pixel_mm)
        self._response = cv2.GaussianBlur(sheet, (0, 0), self.blur_px) * self._falloff
        normals = rng.standard_normal((shape[0] + SHIFTS, shape[1] + SHIFTS), dtype=np.float32)
        grains: Image = np.asarray(cv2.GaussianBlur(normals, (0, 0), GRAIN_SIGMA_PX), dtype=np.float32)
        contrast = paper.speckle * speckle_contrast(pixel_mm)
        self._speckle = LaserSpeckle(grains / grains.std(), contrast, SPECKLE_MM, SPECKLE_RAD)
        self._room = np.float32(ROOM) * (1 + x_mm / 200 + y_mm / 400) * self._response
        self._noise = NoisePool(rng)
        self._frames = 0

    def _seen(self, lens: Lens) -> tuple[Image, Image]:
        """Point of the plane (x, y) in the middle of each pixel, mm."""
        u, v = np.meshgrid(np.arange(self.webcam.width_px), np.arange(self.webcam.height_px))
        x_mm, y_mm = lens.unproject(u, v)
        return x_mm.astype(np.float32), y_mm.astype(np.float32)

    def screen(self, screen: Screen) -> Image:
        """Light of a lit screen in the target's place."""
        turns = rotation(*(math.radians(turn) for turn in screen.turns_deg))
        lens = replace(self.lens, rotation=self.lens.rotation @ turns)
        x_mm, y_mm = self._seen(lens)
        (x_by_v, x_by_u), (y_by_v, y_by_u) = np.gradient(x_mm), np.gradient(y_mm)
        offsets = (np.arange(SCREEN_SUBSAMPLES, dtype=np.float32) + 0.5) / SCREEN_SUBSAMPLES - 0.5
        light = np.zeros_like(x_mm)
        for down in offsets:
            for across in offsets:
                light += screen.shines(
                    x_mm + across * x_by_u + down * x_by_v, y_mm + across * y_by_u + down * y_by_v
                )
        light *= np.float32(SCREEN_LEVEL / SCREEN_SUBSAMPLES**2 / math.prod(APERTURE))
        return cv2.GaussianBlur(light, (0, 0), self.blur_px) * self._falloff

    def spot(self, path: Path_, t_s: float) -> Image:
        """Light of the beam in a frame whose middle row is exposed at ``t_s``; each row at its own time."""
        light = np.zeros_like(self._x_mm)
        spot = footprint(LASER, path(t_s), self.z_mm)
        half_x, half_y = spot.half_box_mm
        corners = np.array([(-1, -1), (-1, 1), (1, -1), (1, 1)]) * (half_x, half_y) + (spot.x_mm, spot.y_mm)
        u, v = self.lens.project(corners[:, 0], corners[:, 1])
        rows = slice(max(int(v.min()) - 4, 0), max(int(v.max()) + 5, 0))
        region = rows, slice(max(int(u.min()) - 4, 0), max(int(u.max()) + 5, 0))
        x_mm, y_mm = self._x_mm[region], self._y_mm[region]
        if self.webcam.row_time_us and x_mm.size:
            delays_s = self.webcam.row_delay_s(np.arange(rows.start, rows.start + len(x_mm)))
            places = np.array([path(t_s + delay_s).at(self.z_mm) for delay_s in delays_s.tolist()])
            moved = (places - (spot.x_mm, spot.y_mm)).astype(np.float32)
            x_mm, y_mm = x_mm - moved[:, :1], y_mm - moved[:, 1:]
        if x_mm.size:
            ends = rows.start + x_mm.shape[0], region[1].start + x_mm.shape[1]
            inside = slice(rows.start, ends[0]), slice(region[1].start, ends[1])
            share = spot.irradiance(x_mm, y_mm) * np.float32(PEAK / LASER.peak_mw_per_mm2)
            light[inside] = share * self._response[inside] * self._speckle.factor(inside, spot)
            if self.blur_px > BLUR_PX:
                light[inside] = cv2.GaussianBlur(light[inside], (0, 0), self.blur_px)
        return light

    def frame(self, t_s: float, laser: Image | None = None, screen: Image | None = None) -> PixelArray:
        """A frame with the light of a beam, of a screen, or of neither; a screen shades its target."""
        self._frames += 1
        none = np.zeros_like(self._room)
        white = self._room if screen is None else screen + np.float32(ROOM / 10)
        gain = self.webcam.gain(t_s, laser is None and not white.max() > 10 * ROOM)
        noise = self._noise.stretch(self._frames, (self.webcam.height_px, self.webcam.width_px))
        return self.webcam.grey(none if laser is None else laser, white, noise, gain)


def speckle_contrast(pixel_mm: float) -> float:
    """Contrast of speckle from pixel to pixel, where a pixel sees a square of ``pixel_mm`` of the paper.

    A grain has the area λ² z² / pupil (Goodman, J. Opt. Soc. Am. 66, 1145, 1976). A pixel is the mean of
    1 + square / grain of them, and paper adds two polarisations.
    """
    grain_mm2 = (WAVELENGTH_MM * LENS_MM) ** 2 / (math.pi * PUPIL_MM**2 / 4)
    return 1 / math.sqrt(2 * (1 + pixel_mm**2 / grain_mm2))


def _grain(rng: np.random.Generator, shape: tuple[int, int], sigma_px: float) -> Image:
    """Means over pixels of a texture with variance 1 and the autocorrelation exp(−r²/2σ²)."""
    white = rng.standard_normal(shape, dtype=np.float32) * np.float32(math.sqrt(2 * math.pi) * sigma_px)
    return np.asarray(cv2.GaussianBlur(white, (0, 0), sigma_px / math.sqrt(2.0)), dtype=np.float32)


def _lens(is_front: bool, webcam: Webcam, rng: np.random.Generator) -> Lens:
    """A lens beside the beam, 200 mm before its target; the front camera looks against the beam."""
    distance_mm = float(rng.uniform(195.0, 205.0))
    tilt_deg = float(rng.uniform(15.0, 20.0)) * float(rng.choice([-1.0, 1.0]))
    turns = (math.radians(value) for value in (rng.uniform(-2.0, 2.0), tilt_deg, rng.uniform(-1.0, 1.0)))
    k1, k2, p1, p2 = rng.uniform((-0.10, 0.0, -6e-4, -6e-4), (0.02, 0.05, 6e-4, 6e-4)).tolist()
    off_u, off_v = rng.uniform(-8.0, 8.0, 2).tolist()
    return Lens(
        webcam.height_px * distance_mm / FIELD_MM * PIXEL_MM,
        ((webcam.width_px - 1) / 2 + off_u, (webcam.height_px - 1) / 2 + off_v),
        (k1, k2, p1, p2, 0.0),
        rotation(*turns),
        np.array([*rng.uniform(-1.0, 1.0, 2), distance_mm]),
        is_front,
    )


@dataclass(frozen=True, slots=True)
class Desk:
    """A desk unit. ``lag_s`` is the delay of the rear camera, which runs freely.

    ``distance_error_mm`` is the papers' distance minus the stated one, ``limits`` its stated uncertainty.
    ``states_row_time``: the headers of the recordings hold the row time, as a config that states it.
    """

    webcam: Webcam = field(default_factory=Webcam)
    seed: int = 1
    lag_s: float = 0.007
    blur_px: float = BLUR_PX
    paper: Paper = TRACING_PAPER
    distance_error_mm: float = 0.0
    limits: Mapping[str, float] = field(default_factory=dict)
    states_row_time: bool = True

    @property
    def serial(self) -> str:
        """Serial number of the unit."""
        return f"SIM-DESK-{self.seed}"

    def camera(self, name: str) -> DeskCamera:
        """One of its cameras."""
        return DeskCamera(name, self)

    def record_plate(self, folder: Path, name: str, screen: Screen, exposures: int = 4) -> None:
        """Write a plate recording of one target: ``exposures`` frames of a black screen, then as many lit."""
        camera, t_s = self.camera(name), 0.0
        lit = camera.screen(screen)
        frames = list[_Row]()
        for number in range(2 * exposures):
            on = number >= exposures
            frames.append(_Row(number, t_s, name, on, camera.frame(t_s, None, lit if on else 0 * lit)))
            t_s += self.webcam.period_s(not on)
        self._write(folder, "plate", (name,), frames, {"plate": screen.header, "limits": dict(self.limits)})

    def record_beams(self, folder: Path, beams: Sequence["Beam"], exposures: int) -> None:
        """Write ``exposures`` frame sets of each beam, one beam after the other."""
        self._write(folder, "measurement", CAMERAS, self._frames(beams, exposures))

    def _frames(self, beams: Sequence["Beam"], exposures: int) -> Iterable["_Row"]:
        cameras = {name: self.camera(name) for name in CAMERAS}
        rng = np.random.default_rng([self.seed, STREAM, 9])
        for number, beam in enumerate(beams):
            for exposure in range(exposures):
                sequence = number * exposures + exposure
                for name, camera in cameras.items():
                    t_s = beam.start_s + exposure / self.webcam.fps + (self.lag_s if name == REAR else 0.0)
                    late_s = (
                        1e-3 * float(rng.exponential(self.webcam.late_ms)) if self.webcam.late_ms else 0.0
                    )
                    pixels = camera.frame(t_s, camera.spot(beam.at, t_s))
                    yield _Row(sequence, t_s + late_s, name, False, pixels)

    def beams(self, count: int, exposures: int, speed_mm_per_s: float = 0.0) -> list["Beam"]:
        """Beams over the area, each moving with this speed in a direction of its own."""
        rng = np.random.default_rng([self.seed, STREAM, 8])
        poses = random_poses(count, DISTANCE_MM, rng, HALF_AREA_MM, MAX_SLOPES)
        angles = rng.uniform(0.0, 2.0 * math.pi, count).tolist()
        period_s = exposures / self.webcam.fps + REST_S
        return [
            Beam(pose, n * period_s, (speed_mm_per_s * math.cos(angle), speed_mm_per_s * math.sin(angle)))
            for n, (pose, angle) in enumerate(zip(poses, angles, strict=True))
        ]

    def _write(
        self,
        folder: Path,
        kind: str,
        cameras: Sequence[str],
        rows: Iterable["_Row"],
        more: Mapping[str, object] | None = None,
    ) -> None:
        webcam = self.webcam
        size: dict[str, object] = {"width": webcam.width_px, "height": webcam.height_px, "bits": 8}
        if self.states_row_time and webcam.row_time_us:
            size["row_time_us"] = webcam.row_time_us
        z_mm = {FRONT: 0.0, REAR: DISTANCE_MM}
        header = {
            "format": "altd-recording/1",
            "kind": kind,
            "fps": webcam.fps,
            "cameras": {name: size | {"origin": "simulated"} for name in cameras},
            "unit": {"serial": self.serial, "target_distance_mm": DISTANCE_MM},
            "targets": [{"name": name, "z_mm": z_mm[name], "camera": name} for name in cameras],
            "note": f"hw_sim desk, seed {self.seed}",
        }
        try:
            for name in cameras:
                (folder / name).mkdir(parents=True)
            with (folder / "frames.csv").open("w", newline="") as file:
                table = csv.writer(file, lineterminator="\n")
                table.writerow(COLUMNS)
                for row in rows:
                    picture = f"{row.camera}/{row.sequence:06d}.png"
                    (folder / picture).write_bytes(cv2.imencode(".png", row.pixels, STORED)[1].tobytes())
                    leds = "on" if row.is_lit else "off"
                    table.writerow((row.sequence, f"{row.t_s:.6f}", row.camera, picture, leds, "", ""))
            (folder / "recording.json").write_text(json.dumps(header | dict(more or {}), indent=1) + "\n")
        except OSError as error:
            raise BadInputError(folder, error.strerror or "cannot be written") from error


@dataclass(frozen=True, slots=True)
class _Row:
    """A frame of a recording."""

    sequence: int
    t_s: float
    camera: str
    is_lit: bool
    pixels: PixelArray


@dataclass(frozen=True, slots=True)
class Beam:
    """The truth of a beam: its pose at ``start_s``, and its steady motion."""

    pose: BeamPose
    start_s: float
    mm_per_s: tuple[float, float]

    def at(self, t_s: float) -> BeamPose:
        """Pose at a time."""
        gone_s = t_s - self.start_s
        x_mm, y_mm = self.pose.at(0.0)
        return replace(
            self.pose, x_mm=x_mm + gone_s * self.mm_per_s[0], y_mm=y_mm + gone_s * self.mm_per_s[1]
        )

    @property
    def truth(self) -> dict[str, object]:
        """For JSON."""
        of = self.pose
        pose = {"x_mm": of.x_mm, "y_mm": of.y_mm, "slope_x": of.slope_x, "slope_y": of.slope_y}
        return {"t_s": self.start_s, **pose, "mm_per_s": self.mm_per_s}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command-line arguments of the desk unit."""
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="DIR", help="new or empty folder")
    parser.add_argument("--seed", type=natural, default=1, help="selects the unit (default: 1)")
    parser.add_argument("--beams", type=at_least_one, default=40, help="number of beams (default: 40)")
    parser.add_argument("--exposures", type=at_least_one, default=20, help="frame sets a beam (default: 20)")
    parser.add_argument("--speed", type=float, default=0.0, metavar="MM/S", help="speed of the beams")
    parser.add_argument(
        "--size", choices=("640x480", "1280x720"), default="640x480", help="pixels of a picture"
    )
    parser.add_argument("--jpeg", type=int, choices=range(1, 101), metavar="Q", help="MJPG of this quality")
    parser.add_argument("--gamma", type=float, default=1.0, help="of the pictures (default: 1)")
    parser.add_argument("--row-time", type=float, default=0.0, metavar="US", help="rolling shutter, µs a row")
    parser.add_argument("--hunting", type=float, default=0.0, metavar="SHARE", help="swing of automatic gain")
    parser.add_argument("--late", type=float, default=0.0, metavar="MS", help="mean delay of the stamps")
    parser.add_argument(
        "--scale", type=float, default=0.0, metavar="SHARE", help="error of the screen's pitch"
    )
    parser.add_argument("--tilt", type=float, default=0.0, metavar="DEG", help="tilt of the screen")


def run(arguments: argparse.Namespace) -> int:
    """Write both plates, the beams and their truth; raises BadInputError."""
    folder: Path = arguments.output
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise BadInputError(folder, "exists and is not an empty folder")
    width, height = (int(text) for text in arguments.size.split("x"))
    webcam = Webcam(
        width,
        height,
        row_time_us=arguments.row_time,
        gamma=arguments.gamma,
        jpeg_quality=arguments.jpeg,
        hunting=arguments.hunting,
        late_ms=arguments.late,
    )
    desk = Desk(webcam, arguments.seed)
    screen = Screen(scale_error=arguments.scale, turns_deg=(0.0, arguments.tilt, 0.0))
    for name in CAMERAS:
        desk.record_plate(folder / f"plate-{name}", name, screen)
    beams = desk.beams(arguments.beams, arguments.exposures, arguments.speed)
    desk.record_beams(folder / "beams", beams, arguments.exposures)
    truth = {"exposures": arguments.exposures, "beams": [beam.truth for beam in beams]}
    write_file(folder / "truth.json", (json.dumps(truth, indent=1) + "\n").encode())
    return 0
