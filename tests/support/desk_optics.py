"""A unit of two webcams and paper, drawn from optics alone; independent of altd and of hw_sim.

OpenCV projects; speckle is a field of random phases through the lens' pupil; each pixel of a Bayer mosaic is
the mean of parts. Lengths are in mm, light in parts of the full scale.
"""

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import cv2
import numpy as np

Array = np.ndarray[Any, np.dtype[Any]]

WIDTH, HEIGHT, PARTS = 640, 480, 5
DISTANCE_MM, LENS_MM, FOCAL_PX, PUPIL_MM = 280.0, 200.0, 950.0, 1.3
WAVELENGTH_MM = 650e-6
BEAM_MM = (6.0, 5.0)
STEP_MM, STEPS = 0.03, 800
"""Raster of a spot's light on the paper, ±12 mm; the pupil passes 5 periods per mm."""
PITCH_MM, COLUMNS, ROWS, DISC_MM, SCREEN_PX_MM = 12.0, 9, 7, 5.0, 0.18
FILTERS = np.array([[1, 0.05, 0.01], [0.15, 1, 0.2], [0.01, 0.12, 1]])
"""Red, green and blue light behind the mosaic's red, green and blue filters."""
FULL_WELL_E, READ_E, FPS, LAG_S = 8000.0, 4.0, 30.0, 0.007
REACH_MM, MAX_SLOPES = (50.0, 35.0), (0.11, 0.15)


@dataclass(frozen=True)
class Ghost:
    """A second spot of the same form beside that of the beam on the rear paper."""

    share: float
    aside_mm: float


class Webcam:
    """A camera tilted by 14° to 21° before its paper; the front one sees it from behind."""

    def __init__(self, name: str, seed: int) -> None:
        rng = np.random.default_rng([seed, name == "front"])
        self.name, self._side = name, -1.0 if name == "front" else 1.0
        middle_px = np.array([WIDTH - 1, HEIGHT - 1]) / 2 + rng.uniform(-10, 10, 2)
        matrix = np.array([[FOCAL_PX, 0, middle_px[0]], [0, FOCAL_PX, middle_px[1]], [0, 0, 1]])
        brown = np.array([rng.uniform(-0.12, 0.03), rng.uniform(0, 0.05), *rng.uniform(-5e-4, 5e-4, 2), 0.0])
        tilt = np.radians([rng.uniform(-2, 2), rng.uniform(14, 21) * rng.choice([-1, 1]), rng.uniform(-2, 2)])
        turn = cv2.Rodrigues(np.array([0, 0, tilt[2]]))[0] @ cv2.Rodrigues(np.array([*tilt[:2], 0]))[0]
        from_mm = -turn.T @ np.array([*rng.uniform(-1, 1, 2), LENS_MM + rng.uniform(-4, 6)])
        parts_px = [(np.arange(count * PARTS) + 0.5) / PARTS - 0.5 for count in (WIDTH, HEIGHT)]
        seen = np.stack(np.meshgrid(*parts_px), axis=-1).reshape(-1, 1, 2)
        rays = np.insert(cv2.undistortPoints(seen, matrix, brown)[:, 0], 2, 1.0, axis=1) @ turn
        at_mm = from_mm - rays * (from_mm[2] / rays[:, 2:])
        shape = HEIGHT * PARTS, WIDTH * PARTS
        self.x_mm: Array = (self._side * at_mm[:, 0]).reshape(shape).astype(np.float32)
        self.y_mm: Array = (-at_mm[:, 1]).reshape(shape).astype(np.float32)
        # 3 % each over 0.2 mm (fibres) and 2 mm (formation)
        sheet = 1 + sum(0.03 * _cloudy(rng, size_mm / 0.1) for size_mm in (0.2, 2.0))
        places = ((of + 70) / np.float32(0.1) for of in (self.x_mm, self.y_mm))
        self._paper = cv2.remap(sheet, *places, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
        self._pixels = 1 + 0.006 * rng.standard_normal((HEIGHT, WIDTH))

    @cached_property
    def screen(self) -> list[Array]:
        """The discs' red, green and blue light, each a stripe of the screen's pixels."""
        across, up = self.x_mm / SCREEN_PX_MM, self.y_mm / SCREEN_PX_MM
        in_disc = np.zeros(across.shape)
        for at, count in ((across, COLUMNS), (up, ROWS)):
            place = (np.floor(at) + 0.5) * SCREEN_PX_MM / PITCH_MM + (count - 1) / 2
            in_disc += np.square((place - np.clip(np.rint(place), 0, count - 1)) * PITCH_MM)
        shines = (in_disc < (DISC_MM / 2) ** 2) & (np.abs(up % 1 - 0.5) < 0.4)
        stripes = [_pixels(shines & (np.abs(across % 1 - (n + 0.5) / 3) < 0.13)) for n in range(3)]
        return [0.6 * stripe / max(each.max() for each in stripes) for stripe in stripes]

    def spot(self, at_mm: Sequence[float], slopes: Sequence[float], rng: np.random.Generator) -> Array:
        """A laser spot's light; its middle is where the beam's axis meets the paper, by symmetry."""
        raster = (np.arange(STEPS) - STEPS / 2) * STEP_MM
        x, y = np.meshgrid(raster, raster)
        axis = np.array([*slopes, 1.0]) / np.linalg.norm([*slopes, 1.0])
        first = np.array([0.9, 0.4, 0.0]) - np.array([0.9, 0.4, 0.0]) @ axis * axis
        first /= np.linalg.norm(first)
        second = np.cross(axis, first)
        across = ((x * of[0] + y * of[1]) / d for of, d in zip((first, second), BEAM_MM, strict=True))
        amplitude = np.exp(-4 * sum(np.square(of) for of in across))
        periods = np.fft.fftfreq(STEPS, STEP_MM)
        passes = np.hypot(periods, periods[:, None]) < PUPIL_MM / (2 * WAVELENGTH_MM * LENS_MM)
        light = np.zeros(x.shape)
        for _polarisation in range(2):
            field = np.fft.fft2(amplitude * np.exp(2j * np.pi * rng.random(x.shape)))
            light += np.square(np.abs(np.fft.ifft2(passes * field)))
        raster_at = (
            (of - mm) / STEP_MM + STEPS / 2 for of, mm in zip((self.x_mm, self.y_mm), at_mm, strict=True)
        )
        raster_x, raster_y = (of.astype(np.float32) for of in raster_at)
        return _pixels(
            cv2.remap(light.astype(np.float32), raster_x, raster_y, cv2.INTER_LINEAR) * self._paper
        )

    def picture(
        self, rgb: Sequence[Array | float], rng: np.random.Generator, gamma: float, jpeg: int
    ) -> Array:
        """The grey values of the camera's JPEG."""
        red, green, blue = np.tensordot(
            FILTERS.T, np.array([of + np.zeros(self._pixels.shape) for of in rgb]), 1
        )
        light = green
        light[::2, 1::2], light[1::2, ::2] = red[::2, 1::2], blue[1::2, ::2]
        electrons = rng.poisson((light + 0.01) * self._pixels * FULL_WELL_E) + rng.normal(
            0, READ_E, light.shape
        )
        raw = np.clip(np.rint(electrons / FULL_WELL_E * 1023), 0, 1023).astype(np.uint16)
        colours = np.power(cv2.demosaicing(raw, cv2.COLOR_BayerGRBG2BGR) / 1023, 1 / gamma)
        coded = cv2.imencode(
            ".jpg", np.rint(255 * colours).astype(np.uint8), [cv2.IMWRITE_JPEG_QUALITY, jpeg]
        )[1]
        return cv2.imdecode(coded, cv2.IMREAD_GRAYSCALE)


def _cloudy(rng: np.random.Generator, sigma: float) -> Array:
    blurred = cv2.GaussianBlur(rng.standard_normal((1400, 1400), dtype=np.float32), (0, 0), sigma)
    return blurred / blurred.std()


def _pixels(parts: Array) -> Array:
    """Means over pixels behind a lens that blurs a little."""
    means = parts.reshape(HEIGHT, PARTS, WIDTH, PARTS).mean(axis=(1, 3), dtype=np.float32)
    return cv2.GaussianBlur(means, (0, 0), 0.6)


class Desk:
    """The unit; ``plate`` and ``beams`` write its recordings."""

    def __init__(self, seed: int, gamma: float = 2.2, jpeg: int = 90) -> None:
        self._rng, self._look = np.random.default_rng([seed, 5]), (gamma, jpeg)
        self.cameras = [Webcam(name, seed) for name in ("front", "rear")]

    def plate(self, path: Path, camera: Webcam, exposures: int = 4) -> Path:
        """The screen before one camera, dark and then lit."""
        lights = [[0.0] * 3] * exposures + [camera.screen] * exposures
        rows = (
            (n, n / FPS, camera.name, n >= exposures, camera.picture(light, self._rng, *self._look))
            for n, light in enumerate(lights)
        )
        origin_mm = [-(count - 1) / 2 * PITCH_MM for count in (COLUMNS, ROWS)]
        grid = {
            "columns": COLUMNS,
            "rows": ROWS,
            "pitch_mm": PITCH_MM,
            "origin_mm": origin_mm,
            "beam_mm": 5.5,
        }
        return _written(path, "plate", [camera.name], rows, plate=grid)

    def beams(self, path: Path, count: int, exposures: int = 5, ghost: Ghost | None = None) -> Array:
        """Beams at rest, a second each; returns x, y and both slopes of each, (count, 4)."""
        rows, truth = [], []
        while len(truth) < count:
            at, slopes = self._rng.uniform(-1, 1, 2) * REACH_MM, self._rng.uniform(-1, 1, 2) * MAX_SLOPES
            if np.any(np.abs(at + DISTANCE_MM * slopes) > REACH_MM):
                continue
            for camera, z_mm, lag_s in zip(self.cameras, (0.0, DISTANCE_MM), (0.0, LAG_S), strict=True):
                place = at + z_mm * slopes
                light = camera.spot(place, slopes, self._rng)
                light *= 0.75 / np.percentile(light, 99.97)
                if ghost is not None and z_mm:
                    aside = camera.spot(np.add(place, (ghost.aside_mm, 0.0)), slopes, self._rng)
                    light += ghost.share * 0.75 / np.percentile(aside, 99.97) * aside
                for n in range(exposures):
                    picture = camera.picture((light, 0.0, 0.0), self._rng, *self._look)
                    t_s = len(truth) + n / FPS + lag_s
                    rows.append((len(truth) * exposures + n, t_s, camera.name, False, picture))
            truth.append((*at, *slopes))
        _written(path, "measurement", ["front", "rear"], sorted(rows, key=lambda row: row[1]))
        return np.array(truth)


def _written(
    path: Path, kind: str, cameras: Sequence[str], rows: Iterable[tuple[Any, ...]], **more: object
) -> Path:
    lines = ["sequence,t_s,camera,file,leds,x_mm,y_mm"]
    for name in cameras:
        (path / name).mkdir(parents=True)
    for sequence, t_s, name, is_lit, picture in rows:
        file = f"{name}/{sequence:06d}.png"
        cv2.imwrite(str(path / file), picture, [cv2.IMWRITE_PNG_COMPRESSION, 1])
        lines.append(f"{sequence},{t_s:.6f},{name},{file},{'on' if is_lit else 'off'},,")
    (path / "frames.csv").write_text("\n".join(lines) + "\n")
    header = {
        "format": "altd-recording/1",
        "kind": kind,
        "fps": FPS,
        "cameras": {name: {"width": WIDTH, "height": HEIGHT, "bits": 8} for name in cameras},
        "unit": {"serial": "OPTICS-DESK", "target_distance_mm": DISTANCE_MM},
        "targets": [{"name": of, "z_mm": DISTANCE_MM * (of == "rear"), "camera": of} for of in cameras],
    }
    (path / "recording.json").write_text(json.dumps(header | more))
    return path
