"""``python -m hw_sim plate``: record the plate of 7 × 5 LEDs (Sec. 3.3.4) at each target's place."""

import argparse
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from altd.errors import BadInputError
from hw_sim.arguments import add_common_arguments, at_least_one, terminal_progress
from hw_sim.assembly import at_framing_distance
from hw_sim.beam import BeamPose
from hw_sim.faults import Fault
from hw_sim.fisheye import FisheyeLens
from hw_sim.image import Image
from hw_sim.imager import Imager
from hw_sim.lens import HEIGHT_PX, WIDTH_PX, Lens, rotation
from hw_sim.recording import Progress, recording
from hw_sim.targets import soft_disc
from hw_sim.unit import CAMERAS, FRONT, Unit, UnitConfig
from hw_sim.view import LED_LEVEL_E_PER_MS, PSF_SIGMA_PX, View, make_view

COLUMNS, ROWS = 7, 5
LED_DIAMETER_MM = 5.0
PITCH_MM = 23.0
"""Pitch of the LEDs. The plate of App. A.3 has 25 mm, but its outer columns exceed the picture of an ordinary
unit's cameras, which are as close as the 140 × 110 mm target allows."""
WIDE_PITCH_MM = 25.0
"""Pitch for cameras made for the plate, tilted or with a fisheye lens."""
FISHEYE_FOCAL_MM = (3.5, 3.7)
LED_PLACE_SIGMA_MM = 0.005
"""Standard deviation of the LEDs' positions from the drawing, per axis."""
MIN_BRIGHTNESS = 0.8
SUBSAMPLES = 6
MAX_TILT_DEG = 35.0
PLATE_STREAM = 9
"""Separate random stream for the plate, apart from that of the frames."""

Led = tuple[int, int]
"""Column and row of an LED, counted from the smallest x and y."""


@dataclass(frozen=True, slots=True)
class Plate:
    """A plate: its pitch and its dark LEDs. ``tilt_deg`` and ``fisheye`` describe the cameras."""

    pitch_mm: float = PITCH_MM
    dark: tuple[Led, ...] = ()
    tilt_deg: float | None = None
    fisheye: bool = False

    @property
    def origin_mm(self) -> tuple[float, float]:
        """Position of the LED with the smallest x and y; the plate is centred on the target."""
        return -(COLUMNS - 1) / 2.0 * self.pitch_mm, -(ROWS - 1) / 2.0 * self.pitch_mm

    @property
    def half_mm(self) -> tuple[float, float]:
        """Half width and half height of the rectangle around its LEDs."""
        return (-self.origin_mm[0] + LED_DIAMETER_MM / 2.0, -self.origin_mm[1] + LED_DIAMETER_MM / 2.0)

    def lit_mm(self) -> list[tuple[float, float]]:
        """Positions of the lit LEDs in the drawing."""
        return [
            (self.origin_mm[0] + column * self.pitch_mm, self.origin_mm[1] + row * self.pitch_mm)
            for row in range(ROWS)
            for column in range(COLUMNS)
            if (column, row) not in self.dark
        ]


def with_plate(unit: Unit, plate: Plate) -> Unit:
    """The unit with its cameras directed at the plate instead of their targets, and without the laser."""
    rng = np.random.default_rng([unit.config.seed, PLATE_STREAM])
    imagers = {}
    for camera in CAMERAS:
        imager = unit.imagers[camera]
        view = imager.view
        if plate.tilt_deg is not None or plate.fisheye:
            focal_mm = unit.config.front_focal_mm if camera == FRONT else unit.config.rear_focal_mm
            lens = _plate_lens(view.lens, plate, focal_mm, rng)
            view = make_view(lens, None, unit.config.speckle_contrast, unit.config.hot_pixels, rng)
        imagers[camera] = Imager(
            replace(view, lamps=_lamps(view, plate.lit_mm(), rng)),
            imager.sensor,
            imager.settings,
            unit.config.lux,
        )
    unit.imagers = imagers
    unit.inject(Fault.NO_LASER)
    return unit


def record_plate(folder: Path, unit: Unit, plate: Plate, frame_sets: int, progress: Progress) -> None:
    """Write ``frame_sets`` pairs of the plate, LEDs off and on, into ``folder``."""
    header = {
        "plate": {
            "columns": COLUMNS,
            "rows": ROWS,
            "pitch_mm": plate.pitch_mm,
            "origin_mm": list(plate.origin_mm),
            "disc_mm": LED_DIAMETER_MM,
        },
        "note": f"hw_sim, seed {unit.config.seed}, plate",
    }
    with recording(folder, unit, "plate", 2 * frame_sets, progress, header) as recorder:
        for _ in range(frame_sets):
            for leds_on in (False, True):
                recorder.expose(BeamPose(0.0, 0.0), leds_on=leds_on)


def _plate_lens(
    lens: Lens, plate: Plate, focal_range_mm: tuple[float, float], rng: np.random.Generator
) -> Lens:
    """A lens tilted against the plate, at the distance at which its image holds the whole plate."""
    tilt, towards = math.radians(plate.tilt_deg or 0.0), rng.uniform(0.0, 2.0 * math.pi)
    turned = rotation(
        tilt * math.cos(towards), tilt * math.sin(towards), math.radians(rng.uniform(-2.0, 2.0))
    )
    focal_mm = rng.uniform(*(FISHEYE_FOCAL_MM if plate.fisheye else focal_range_mm))
    ahead_mm = np.array([0.0, 0.0, 40.0 * focal_mm])
    if plate.fisheye:
        k1, k2 = rng.uniform((-0.03, -0.01), (0.01, 0.01))
        tilted: Lens = FisheyeLens(
            float(focal_mm),
            lens.principal_px,
            (float(k1), float(k2), 0.0, 0.0, 0.0),
            turned,
            ahead_mm,
            lens.mirrored,
        )
    else:
        tilted = replace(lens, focal_mm=float(focal_mm), rotation=turned, translation_mm=ahead_mm)
    return at_framing_distance(tilted, plate.half_mm, (20.0, 120.0))


def _lamps(view: View, lit_mm: Sequence[tuple[float, float]], rng: np.random.Generator) -> Image:
    """Electrons per ms of the plate's LEDs, each with its own deviation in position and brightness."""
    lit = np.zeros_like(view.x_mm)
    for x_mm, y_mm in lit_mm:
        off_x, off_y = rng.normal(0.0, LED_PLACE_SIGMA_MM, size=2)
        place_mm, brightness = (x_mm + off_x, y_mm + off_y), float(rng.uniform(MIN_BRIGHTNESS, 1.0))
        add_disc(lit, view.lens, (view.x_mm, view.y_mm), place_mm, LED_DIAMETER_MM / 2.0, brightness)
    columns, rows = np.meshgrid(np.arange(WIDTH_PX, dtype=np.float64), np.arange(HEIGHT_PX, dtype=np.float64))
    falloff = view.lens.relative_illumination(*view.lens.unproject(columns, rows)).astype(np.float32)
    blurred = cv2.GaussianBlur(lit, (0, 0), PSF_SIGMA_PX).astype(np.float32)
    return np.asarray(blurred * falloff * np.float32(LED_LEVEL_E_PER_MS))


def add_disc(
    lit: Image,
    lens: Lens,
    plane_mm: tuple[Image, Image],
    place_mm: tuple[float, float],
    radius: float,
    brightness: float,
) -> None:
    """Add to ``lit`` the share of each pixel's area that a disc covers.

    ``plane_mm`` are the maps (x, y) of the point of the plane in each pixel.
    """
    around = np.linspace(0.0, 2.0 * math.pi, 32)
    u, v = lens.project(
        place_mm[0] + 1.2 * radius * np.cos(around), place_mm[1] + 1.2 * radius * np.sin(around)
    )
    height, width = lit.shape
    left, right = (int(np.clip(edge, 0, width)) for edge in (u.min() - 2, u.max() + 3))
    top, bottom = (int(np.clip(edge, 0, height)) for edge in (v.min() - 2, v.max() + 3))
    if right - left < 2 or bottom - top < 2:
        return
    here = slice(top, bottom), slice(left, right)
    x_mm, y_mm = plane_mm[0][here], plane_mm[1][here]
    (x_by_v, x_by_u), (y_by_v, y_by_u) = np.gradient(x_mm), np.gradient(y_mm)
    cell_mm = float(np.median(np.hypot(x_by_u, y_by_u))) / SUBSAMPLES
    offsets = (np.arange(SUBSAMPLES) + 0.5) / SUBSAMPLES - 0.5
    for down in offsets:
        for across in offsets:
            distance = np.hypot(
                x_mm + across * x_by_u + down * x_by_v - place_mm[0],
                y_mm + across * y_by_u + down * y_by_v - place_mm[1],
            )
            lit[here] += brightness / SUBSAMPLES**2 * soft_disc(distance, radius, cell_mm)


def _led(text: str) -> Led:
    """Parse an LED as COLUMN,ROW, counted from 0."""
    try:
        column, row = (int(part) for part in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not COLUMN,ROW") from None
    if not (0 <= column < COLUMNS and 0 <= row < ROWS):
        raise argparse.ArgumentTypeError(f"{text} is not on the plate of {COLUMNS} × {ROWS} LEDs")
    return column, row


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command-line arguments of the plate."""
    add_common_arguments(parser)
    parser.add_argument(
        "--exposures", type=at_least_one, default=4, help="pairs of exposures, LEDs off and on (default: 4)"
    )
    parser.add_argument(
        "--dark", type=_led, nargs="+", default=[], metavar="C,R", help="dark LEDs, counted from 0,0"
    )
    parser.add_argument("--tilt", type=float, metavar="DEG", help="use other cameras, tilted by this angle")
    parser.add_argument("--fisheye", action="store_true", help="use other cameras, with lenses of f = 3.6 mm")


def run(arguments: argparse.Namespace) -> int:
    """Record a plate; raises BadInputError."""
    if arguments.tilt is not None and not 0.0 <= arguments.tilt <= MAX_TILT_DEG:
        raise BadInputError("--tilt", f"{arguments.tilt:g} is not between 0 and {MAX_TILT_DEG:g} degrees")
    own_cameras = arguments.tilt is None and not arguments.fisheye
    plate = Plate(
        PITCH_MM if own_cameras else WIDE_PITCH_MM, tuple(arguments.dark), arguments.tilt, arguments.fisheye
    )
    unit = with_plate(Unit(UnitConfig(seed=arguments.seed, hard=arguments.hard)), plate)
    record_plate(arguments.output, unit, plate, arguments.exposures, terminal_progress("plate"))
    return 0
