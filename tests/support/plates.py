"""Pictures of an LED plate, drawn with OpenCV's own projections; independent of altd and of hw_sim."""

import json
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from hw_sim.recording import STORED
from support.frames import HEIGHT, WIDTH
from support.recordings import header

COLUMNS, ROWS, PITCH_MM, DISC_MM = 7, 5, 25.0, 5.0
_WITHIN_MM = np.stack(np.meshgrid(np.linspace(-70, 70, 11), np.linspace(-46, 46, 8)), axis=-1).reshape(-1, 2)
FINE = 16
"""Cells per pixel and axis in which a disc's outline is filled."""


@dataclass(frozen=True)
class View:
    """A camera in front of the plate: ``turn`` is Rodrigues' vector, ``f_px`` the focal length.

    ``fisheye`` takes OpenCV's fisheye model (k1 … k4), else ``distortion`` is Brown's (k1, k2, p1, p2, k3).
    """

    f_px: float
    distance_mm: float
    turn: tuple[float, float, float] = (0.0, 0.0, 0.0)
    distortion: tuple[float, ...] = (-0.22, 0.05, 2e-4, -3e-4, 0.0)
    fisheye: bool = False
    mirrored: bool = False
    middle_px: tuple[float, float] = ((WIDTH - 1) / 2, (HEIGHT - 1) / 2)
    scale: float = 1.0
    askew_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Turn of the plate against the target, Rodrigues' vector; x right, y up, z away from the camera."""
    aside_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """The plate's middle on the target; z is its depth behind it."""

    def to_px(self, points_mm: np.ndarray) -> np.ndarray:
        """Points (n, 2) of the plate in px."""
        points = np.asarray(points_mm, dtype=float).reshape(-1, 2)
        side = -1.0 if self.mirrored else 1.0
        turned, _ = cv2.Rodrigues(np.radians(np.array(self.askew_deg)))
        x, y, z = turned[:, :2] @ (self.scale * points.T) + np.array(self.aside_mm)[:, None]
        face = np.column_stack([side * x, -y, z])[:, None, :]
        matrix = np.array([[self.f_px, 0, self.middle_px[0]], [0, self.f_px, self.middle_px[1]], [0, 0, 1]])
        turn, move = np.array(self.turn), np.array([0.0, 0.0, self.distance_mm])
        if self.fisheye:
            px, _ = cv2.fisheye.projectPoints(face, turn, move, matrix, np.array(self.distortion[:4]))
        else:
            px, _ = cv2.projectPoints(face, turn, move, matrix, np.array(self.distortion))
        return np.asarray(px).reshape(-1, 2)

    def misses_mm(self, to_mm: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        """The errors of a map from px (n, 2) to mm (n, 2) at points of the plate."""
        return np.linalg.norm(to_mm(self.to_px(_WITHIN_MM)) - _WITHIN_MM, axis=1)


def tilted(degrees: float, towards: float, roll: float = 0.0) -> tuple[float, float, float]:
    """Rodrigues' vector of a camera tilted about an axis in the plate's plane, then rolled; degrees."""
    axis = np.array([np.cos(towards), np.sin(towards), 0.0])
    first, _ = cv2.Rodrigues(np.radians(degrees) * axis)
    second, _ = cv2.Rodrigues(np.radians(roll) * np.array([0.0, 0.0, 1.0]))
    return tuple(float(part) for part in cv2.Rodrigues(second @ first)[0].ravel())


FRONT = View(1333.0, 420.0, tilted(12.0, 1.0, 2.0), mirrored=True)
REAR = View(950.0, 340.0, tilted(30.0, 2.5, -3.0))


def grid_mm() -> np.ndarray:
    """The LEDs (rows, columns, 2), from the smallest x and y."""
    x = PITCH_MM * (np.arange(COLUMNS) - (COLUMNS - 1) / 2)
    y = PITCH_MM * (np.arange(ROWS) - (ROWS - 1) / 2)
    return np.stack(np.meshgrid(x, y), axis=-1)


def add_disc(image: np.ndarray, view: View, place_mm: np.ndarray, diameter_mm: float, peak: float) -> None:
    """Add an evenly bright disc: its outline is projected point by point, and filled on a fine raster."""
    around = np.linspace(0, 2 * np.pi, 720, endpoint=False)
    outline = view.to_px(place_mm + diameter_mm / 2 * np.column_stack([np.cos(around), np.sin(around)]))
    left, top = (int(edge) for edge in np.floor(outline.min(axis=0)) - 1)
    right, bottom = (int(edge) for edge in np.ceil(outline.max(axis=0)) + 2)
    fine = np.zeros(((bottom - top) * FINE, (right - left) * FINE), np.uint8)
    # Pixel (0, 0) has its middle at 0; its cells have theirs at (k + 0.5) / FINE − 0.5.
    corners = (outline - (left, top) + 0.5) * FINE - 0.5
    cv2.fillPoly(fine, [np.rint(corners * 256).astype(np.int32)], 255, shift=8)
    share = fine.reshape(bottom - top, FINE, right - left, FINE).mean(axis=(1, 3)) / 255
    u0, v0, u1, v1 = max(left, 0), max(top, 0), min(right, image.shape[1]), min(bottom, image.shape[0])
    if u0 < u1 and v0 < v1:
        image[v0:v1, u0:u1] += peak * share[v0 - top : v1 - top, u0 - left : u1 - left]


def add_screen_disc(
    image: np.ndarray, view: View, place_mm: np.ndarray, diameter_mm: float, peak: float, pixel_mm: float
) -> None:
    """Add a disc of a screen's pixels, each lit in an upright third and three quarters of its height."""
    reach = int(diameter_mm / 2 / pixel_mm) + 1
    steps = (np.arange(-reach, reach) + 0.5) * pixel_mm
    cells = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    cells = cells[np.hypot(*cells.T) < diameter_mm / 2]
    corners = np.array([(-1, -2.25), (1, -2.25), (1, 2.25), (-1, 2.25)]) * pixel_mm / 6
    outlines = view.to_px((place_mm + cells[:, None] + corners).reshape(-1, 2)).reshape(-1, 4, 2)
    (left, top), (right, bottom) = (
        (np.floor(outlines.min((0, 1))) - 1).astype(int),
        np.ceil(outlines.max((0, 1))).astype(int) + 2,
    )
    fine = np.zeros(((bottom - top) * FINE, (right - left) * FINE), np.uint8)
    drawn = np.rint(((outlines - (left, top) + 0.5) * FINE - 0.5) * 256).astype(np.int32)
    for outline in drawn:
        cv2.fillConvexPoly(fine, outline, 255, shift=8)
    share = fine.reshape(bottom - top, FINE, right - left, FINE).mean(axis=(1, 3)) / 255
    image[top:bottom, left:right] += peak * share / share[share > share.max() / 4].mean()


def plate_light(
    view: View,
    dark: Collection[tuple[int, int]] = (),
    disc_mm: float = DISC_MM,
    peak: float = 170.0,
    blur_px: float = 0.7,
    pixel_mm: float = 0.0,
) -> np.ndarray:
    """Counts of the lit plate behind a lens that blurs a little; ``dark`` are (column, row).

    With ``pixel_mm`` it is a screen with such pixels.
    """
    image = np.zeros((HEIGHT, WIDTH))
    places = grid_mm()
    for row in range(ROWS):
        for column in range(COLUMNS):
            if (column, row) not in dark:
                shade = 1 - 0.04 * ((3 * column + row) % 5)
                if pixel_mm:
                    add_screen_disc(image, view, places[row, column], disc_mm, peak, pixel_mm)
                else:
                    add_disc(image, view, places[row, column], disc_mm, peak * shade)
    return cv2.GaussianBlur(image, (0, 0), blur_px)


def write_plate(
    path: Path, front: np.ndarray, rear: np.ndarray, pairs: int = 2, noise: float = 1.5, **more: object
) -> Path:
    """A recording of a plate whose light is ``front`` and ``rear``, LEDs off and on in turn."""
    return write_plates(path, {"front": front, "rear": rear}, pairs, noise, **more)


def write_plates(
    path: Path, lights: Mapping[str, np.ndarray], pairs: int = 2, noise: float = 1.5, **more: object
) -> Path:
    """The same of any cameras, by their names; ``more`` replaces keys of the header."""
    rng = np.random.default_rng(0)
    path.mkdir(parents=True)
    plate = {"columns": COLUMNS, "rows": ROWS, "pitch_mm": PITCH_MM, "origin_mm": grid_mm()[0, 0].tolist()}
    about = header("plate", plate=plate | {"colour": "black", "beam_mm": 0.0})
    (path / "recording.json").write_text(json.dumps(about | more))
    rows = ["sequence,t_s,camera,file,leds,x_mm,y_mm"]
    for sequence in range(2 * pairs):
        for camera, light in lights.items():
            name = f"{camera}{sequence:04d}.png"
            on = sequence % 2
            counts = on * light + 8 + rng.normal(0, noise, light.shape)
            pixels = np.clip(np.rint(counts), 0, 255).astype(np.uint8)
            cv2.imwrite(str(path / name), pixels, STORED)
            rows.append(f"{sequence},{sequence / 20:.6f},{camera},{name},{'on' if on else 'off'},,")
    (path / "frames.csv").write_text("\n".join(rows) + "\n")
    return path
